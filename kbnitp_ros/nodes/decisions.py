# SPDX-License-Identifier: Apache-2.0
"""The planner's decisions on its goal, which may end the mission."""

from __future__ import annotations

from collections.abc import Callable
from concurrent import futures
from functools import partial

from kbnitp_msgs.msg import Decision as DecisionMessage
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.configuration.mission import goal_cells, make_stop
from kbnitp_ros.core import Decision, safest_path
from kbnitp_ros.files import counted
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.headers import check_frame
from kbnitp_ros.messages.progress import decision_message
from kbnitp_ros.nodes.mission_evidence import MissionEvidence
from kbnitp_ros.nodes.rounds import computed
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import MissionNode
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from rclpy.task import Future

# Reason why a call of safest_path has no answer.
UNKNOWN = 'the newest belief, or some of its evidence, has not been received yet'


class Decisions:
    """The decisions of the planner on its goal."""

    def __init__(self, node: MissionNode, state: BaseState, act: Callable[[], object]) -> None:
        self.knowledge = MissionEvidence(node.values, state)
        self._node = node
        self._state = state
        self._grid = state.grid
        self._act = act
        self._newest: Snapshot | None = None
        self._decision: Decision | None = None
        self._is_decided = False
        # Number of belief and parameter changes so far. At the start of the last decision: that
        # number, and the number of changes of the evidence.
        self._news = 0
        self._begun_with = 0, 0
        self._deciding: futures.Future[Decision | None] | None = None
        self._finding: futures.Future[Decision] | None = None
        # Reason why the plans for the newest belief end the mission, empty if they do not; and the
        # reason logged last.
        self.not_worth = ''
        self._said = ''
        self._publisher = node.create_publisher(DecisionMessage, 'decision', qos.LATCHED)
        self._lane = node.create_publisher(Path, 'decision/lane', qos.LATCHED)
        node.create_service(GetPlan, 'safest_path', self._on_safest_path)
        node.create_poll(self._decide)

    def take(self, newest: Snapshot) -> None:
        """Store the newest belief, start the decision on it, and call `act`."""
        if not newest.deployments:
            self.knowledge.begin(newest)
        self._newest = newest
        self.review()
        self._decide()
        self._act()

    def review(self) -> None:
        """Request a new decision at the next poll."""
        self._is_decided, self.not_worth = False, ''
        self._news += 1

    @property
    def is_ready(self) -> bool:
        """Return whether the decision on the newest belief is ready, or not needed."""
        return self.knowledge.goal is None or self._is_decided

    @property
    def is_deciding(self) -> bool:
        """Return whether a decision is being computed, or will be at the next poll."""
        # If a belief did not match the evidence, more evidence starts the decision again.
        now = self._news, self._state.changes
        return self._deciding is not None or now != self._begun_with

    def _decide(self) -> None:
        """Publish the decision once it is computed, and start the next if it is due."""
        if self._deciding is not None and self._deciding.done():
            decision, self._deciding = self._deciding.result(), None
            if decision is not None and self._begun_with[0] == self._news:
                self._is_decided, self._decision = True, decision
                self._publish(decision)
                self._act()
        if self._newest is None or self.is_ready or self._deciding is not None:
            return
        if self.is_deciding:
            self._begun_with = self._news, self._state.changes
            self._deciding = computed(
                partial(self.knowledge.decision, self._newest),
                partial(self._node.call_next, self._decide),
            )

    def why_over(self) -> str:
        """Return the reason why no more robots leave; empty if robots may leave."""
        decision = self._decision if self.knowledge.goal is not None else None
        why = make_stop(self._node.values).why(decision, self._state.lost) or self.not_worth
        if why != self._said:
            self._said = why
            if why:
                self._node.get_logger().info(f'no more robots leave: {why}')
        return why

    def _publish(self, decision: Decision) -> None:
        newest = self._newest
        assert newest is not None
        message = decision_message(
            self._grid,
            decision,
            newest.deployments,
            newest.stamp,
            newest.mission,
            goal_cells(self._node.values, self._grid),
        )
        self._publisher.publish(message)
        self._lane.publish(message.path)
        taken = '' if self.knowledge.are_joint else ' (cells assumed independent)'
        self._node.get_logger().info(
            f'{decision.goal} free of hazards with probability {decision.p_free:.3f}, '
            f'{decision.hazards_mean:.2f} hazards expected, after '
            f'{counted(newest.deployments, "deployment")}{taken}'
        )

    def _on_safest_path(
        self, request: GetPlan.Request, response: GetPlan.Response
    ) -> GetPlan.Response | Future:
        """Answer with the safest path between two places; with an empty path if none is found."""
        newest = self._newest
        try:
            if newest is None:
                raise ValueError(UNKNOWN)
            if self._finding is not None:
                raise ValueError('another call is being answered: call again later')
            for name in ('start', 'goal'):
                check_frame(f'{name}.header.frame_id', getattr(request, name).header.frame_id)
            start, to = (
                int(self._grid.cells_at([[at.pose.position.x, at.pose.position.y]])[0])
                for at in (request.start, request.goal)
            )
        except ValueError as error:
            self._node.diagnostics.refuse('safest_path', error)
            return response
        answer = Future()

        def find() -> Decision:
            if (draws := self.knowledge.draws(newest)) is None:
                raise ValueError(UNKNOWN)
            most = self._node.values['max_steps']
            return safest_path(self._grid, draws, newest.model, start, to, most)

        def reply() -> None:
            assert self._finding is not None
            finding, self._finding = self._finding, None
            try:
                found = finding.result()
            except ValueError as error:
                self._node.diagnostics.refuse('safest_path', error)
            else:
                response.plan = path_message(self._grid, found.path, newest.stamp, newest.mission)
                self._node.get_logger().info(
                    f'safest path of {found.path.size - 1} steps: free of hazards with '
                    f'probability {found.p_free:.3f}, survival probability {found.survival:.3f}'
                )
            answer.set_result(response)

        self._finding = computed(find, partial(self._node.call_next, reply))
        return answer
