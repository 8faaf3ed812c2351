# SPDX-License-Identifier: Apache-2.0
"""The estimator's decisions on the goal of the mission, and its answers about the hazards."""

from __future__ import annotations

from collections.abc import Callable
from concurrent import futures
from functools import partial
from threading import Lock
from typing import Any, NamedTuple, TypeVar

from kbnitp_msgs.msg import Decision as DecisionMessage
from kbnitp_msgs.srv import Draws
from kbnitp_ros.base.no_go import open_grid
from kbnitp_ros.base.state import EvidenceName
from kbnitp_ros.configuration import make_goal
from kbnitp_ros.configuration.mission import checked_goal
from kbnitp_ros.core import Decision, Estimator, Goal, Grid, HazardDraws, Ledger, safest_path
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.core.decision.told import with_told
from kbnitp_ros.files import counted
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.headers import check_frame, from_stamp
from kbnitp_ros.messages.progress import decision_fields, decision_message, fill_draws
from kbnitp_ros.nodes.presence import Repeated
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.task import Future

# Maximum seconds that a node that ends waits for its last decision.
LAST = 1.0

# Reason why a call has no answer: calls are answered one after another.
BUSY = 'another call is being answered: call again later'

T = TypeVar('T')


class PublishedBelief(NamedTuple):
    """A published belief: its estimator, number of deployments, stamp, mission and evidence."""

    estimator: Estimator
    deployments: int
    stamp: int
    mission: int
    evidence: EvidenceName


class Decisions:
    """The topics `decision` and `decision/lane`, and the services `safest_path` and `draws`."""

    def __init__(self, node: FieldNode) -> None:
        self._node = node
        self._grid = node.grid
        self._newest: PublishedBelief | None = None
        # The last draws, and their estimator; drawn by one thread at a time.
        self._drawn: tuple[Estimator, HazardDraws] | None = None
        self._drawing = Lock()
        self._deciding: futures.Future[Decision] | None = None
        # Cells that no way may lead through, and the grid without them.
        self._no_go: tuple[int, ...] = ()
        self.open_grid = node.grid
        # The belief, the confidence and the no-go cells of the last decision begun.
        self._begun: tuple[PublishedBelief | None, float, tuple[int, ...]] = None, 0.0, ()
        # Services with a call that is being answered.
        self._answering: set[str] = set()
        self._publisher = Repeated(node, DecisionMessage, 'decision', qos.LATCHED)
        self._lane = node.create_publisher(Path, 'decision/lane', qos.LATCHED)
        node.add_on_set_parameters_callback(self._check)
        # Later, once the values of the node have changed.
        node.add_post_set_parameters_callback(lambda _: node.call_next(self._decide))
        node.create_service(GetPlan, 'safest_path', self._on_safest_path)
        node.create_service(Draws, 'draws', self._on_draws)

    @property
    def _goal(self) -> Goal | None:
        return make_goal(self._node.values, self._grid)

    def publish(self, ledger: Ledger, stamp: int, mission: int, epoch: int) -> None:
        """Decide on a new belief, and publish the decision once it is computed."""
        # A late deployment gives the ledger another estimator, and leaves this one as it is.
        evidence = EvidenceName(epoch, ledger.changes)
        self._newest = PublishedBelief(
            ledger.estimator, len(ledger.deployments), stamp, mission, evidence
        )
        self._decide()

    def close(self, no_go: tuple[int, ...]) -> None:
        """Decide with other no-go cells from now on; raise ValueError if they are impossible."""
        if no_go != self._no_go:
            most = self._node.values['max_steps']
            self.open_grid = open_grid(self._grid, no_go, self._goal, most)
            self._no_go = no_go
            self._decide()

    def finish(self) -> None:
        """Publish the decision on the last belief, if it takes less than `LAST`."""
        try:
            while self._deciding is not None:
                self._deciding.result(LAST)
                self._take(self._deciding)
        except futures.TimeoutError:
            self._node.get_logger().warning(
                f'the decision on the last belief takes more than {LAST:g} s and is left out'
            )

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        """Refuse a confidence that the goal cannot have, or whose error would be too large."""
        values = {**self._node.values, **{each.name: each.value for each in changes}}
        try:
            estimator = self._newest and self._newest.estimator
            checked_goal(values, self._grid, estimator=estimator)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _decide(self) -> None:
        """Start the decision on the newest belief, unless it was started or another one runs."""
        due = self._newest, self._node.values['stop.confidence'], self._no_go
        if self._goal is None or self._newest is None or self._deciding or due == self._begun:
            return
        self._begun = due
        goal, known, most = self._goal, self._newest, self._node.values['max_steps']
        decide = partial(self._decision, goal, self.open_grid, known, most)
        self._deciding = self._node.compute(decide, self._take)

    def _decision(
        self, goal: Goal, grid: Grid, known: PublishedBelief, max_steps: int
    ) -> Decision:
        """Decide, and find the numbers that a reached goal trusts."""
        hazards = joint_hazards(known.estimator, known.deployments)
        decision = goal.decide(grid, hazards, known.estimator.model, max_steps)
        if decision.reached:
            decision = with_told(decision, known.estimator, known.deployments)
        return decision

    def _take(self, deciding: futures.Future[Decision]) -> None:
        """Publish a decision unless there is a newer belief, and start the next one."""
        if deciding is not self._deciding:
            return
        self._deciding, decision = None, deciding.result()
        known = self._newest
        assert known is not None
        if self._begun[0] is known:
            cells = self._node.values['goal.cells']
            of_belief = known.deployments, known.stamp, known.mission
            author = self._node.get_fully_qualified_name()
            fields = decision_fields(
                self._grid, decision, *of_belief, cells, author, *known.evidence, self._begun[2]
            )
            message = decision_message(fields)
            self._publisher.publish(message)
            self._lane.publish(message.path)
            taken = '' if known.estimator.draws_are_exact else ' (cells assumed independent)'
            self._node.get_logger().info(
                f'{decision.goal} free of hazards with probability {decision.p_free:.3f}, '
                f'{decision.hazards_mean:.2f} hazards expected, after '
                f'{counted(known.deployments, "deployment")}{taken}'
            )
            for sentence in decision.trusts:
                self._node.get_logger().warning(f'the decision {sentence}')
        self._decide()

    def _draws(self, known: PublishedBelief) -> HazardDraws:
        """Return draws of the hazards for a belief, as often as it is asked."""
        with self._drawing:
            if self._drawn is None or self._drawn[0] is not known.estimator:
                draws = HazardDraws.of(known.estimator, known.deployments)
                self._drawn = known.estimator, draws
            return self._drawn[1]

    def _on_draws(self, request: Draws.Request, response: Draws.Response) -> Any:
        """Answer with draws for the newest belief."""
        known, asked = self._newest, (from_stamp(request.epoch), request.changes)
        if known is None or known.evidence != asked:
            response.message = 'the newest belief is another one'
            return response
        if 'draws' in self._answering:
            response.message = BUSY
            return response
        draw = partial(self._draws, known)
        return self._answered('draws', response, draw, partial(fill_draws, response))

    def _on_safest_path(self, request: GetPlan.Request, response: GetPlan.Response) -> Any:
        """Answer with the safest path between two places; with an empty path if none is found."""
        try:
            known = self._newest
            if known is None:
                raise ValueError('no belief has been published yet')
            if 'safest_path' in self._answering:
                raise ValueError(BUSY)
            for name in ('start', 'goal'):
                check_frame(f'{name}.header.frame_id', getattr(request, name).header.frame_id)
            start, to = (
                int(self._grid.cells_at([[at.pose.position.x, at.pose.position.y]])[0])
                for at in (request.start, request.goal)
            )
        except ValueError as error:
            self._node.diagnostics.refuse('safest_path', error)
            return response

        def fill(found: Decision) -> None:
            response.plan = path_message(self._grid, found.path, known.stamp, known.mission)
            self._node.get_logger().info(
                f'safest path of {found.path.size - 1} steps: free of hazards with '
                f'probability {found.p_free:.3f}, survival probability {found.survival:.3f}'
            )

        find = partial(self._safest_path, self.open_grid, known, start, to)
        return self._answered('safest_path', response, find, fill)

    def _safest_path(self, grid: Grid, known: PublishedBelief, start: int, to: int) -> Decision:
        model, most = known.estimator.model, self._node.values['max_steps']
        hazards = joint_hazards(known.estimator, known.deployments)
        return safest_path(grid, hazards, model, start, to, most)

    def _answered(
        self, service: str, response: Any, find: Callable[[], T], fill: Callable[[T], None]
    ) -> Future:
        """Return the future of a response that is filled once a thread has found what it says."""
        answer = Future()
        self._answering.add(service)

        def reply(found: futures.Future[T]) -> None:
            self._answering.remove(service)
            try:
                fill(found.result())
            except ValueError as error:
                self._node.diagnostics.refuse(service, error)
            answer.set_result(response)

        self._node.compute(find, reply)
        return answer
