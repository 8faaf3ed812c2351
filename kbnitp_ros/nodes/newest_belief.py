# SPDX-License-Identifier: Apache-2.0
"""The planner's subscription to beliefs, and the checks of each belief."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from kbnitp_msgs.msg import BeliefMaps
from kbnitp_ros.base.mission_tracker import MissionTracker
from kbnitp_ros.base.obstacles import not_repeated
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.agents import own_base
from kbnitp_ros.configuration.mission import check_search
from kbnitp_ros.core import ORDINARY
from kbnitp_ros.files import counted
from kbnitp_ros.log.roles import BELIEF
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import HELD, LAST_REFUSAL
from kbnitp_ros.nodes.runtime.node import FieldNode
from rclpy.subscription import Subscription


class NewestBelief:
    """A subscription to beliefs that passes a belief to `take` if it is the newest."""

    def __init__(
        self,
        node: FieldNode,
        agents: Sequence[str],
        state: BaseState,
        take: Callable[[Snapshot], None],
    ) -> None:
        self._node = node
        self._agents = agents
        self._state = state
        self._take = take
        # The mission, and the newest belief.
        self.tracker = MissionTracker()
        # Number of robots sent that are known only from the belief.
        self.sent_unknown = 0
        # Number of deployments in the last belief received.
        self.last_received = 0
        # Last refusal of evidence by the estimator since the last belief; empty if none.
        self.refusal = ''
        # Whether the planner has warned that the belief will never hold all deployments.
        self._is_incomplete_told = False
        self._subscription: Subscription | None = None
        node.subscribe_to_diagnostics(self._on_diagnostics)

    def _on_diagnostics(self, name: str, values: Mapping[str, str]) -> None:
        evidence = tuple(f'{agent}/' for agent in self._agents)
        said = values.get(LAST_REFUSAL, '')
        refused = {key.removeprefix(HELD): values[key] for key in values if key.startswith(HELD)}
        is_news = said.startswith(evidence) or refused or self._state.held
        if not is_news or name not in self._node.authors('belief', BELIEF):
            return
        if said.startswith(evidence):
            self.refusal = f'{name} says: {said}'
        self._state.follow(refused)

    def subscribe(self) -> None:
        """Subscribe to beliefs; called again after one of several estimators has left."""
        self.tracker.newest = None
        if self._subscription:
            self._node.destroy_subscription(self._subscription)
        self._subscription = self._node.subscribe(
            BeliefMaps, 'belief', self._on_belief, qos.LATCHED
        )

    def _on_belief(self, message: BeliefMaps) -> None:
        try:
            snapshot = read_belief_maps(message)
            self._check_rules(snapshot)
            # Each agent may have had a robot in flight when the former planner died.
            out_before = len(self._agents) if self.sent_unknown else 0
            known = self._state.known(snapshot.mission) + out_before
            self.tracker.check_belief(snapshot, self._node.count_authors('belief', BELIEF), known)
        except ValueError as error:
            self._node.diagnostics.refuse('belief', error)
            return
        self._node.diagnostics.accepted += 1
        self.refusal = ''
        unknown = snapshot.deployments - self._state.robots_left
        if unknown > self.sent_unknown:
            self._node.get_logger().warning(
                f'the belief holds {counted(unknown, "deployment")} that this planner does not '
                'know: a former planner sent them, and their paths are no longer published; '
                'before you restart the estimator, set its parameter resume to the log, or it '
                'loses these deployments, too'
            )
            self.sent_unknown = unknown
        held = self.last_received = snapshot.deployments
        # An estimator that resumes a log publishes its prior first, then a belief with all
        # evidence on record.
        if 0 < held < self._state.forgotten(qos.DEPTH) and not self._is_incomplete_told:
            self._is_incomplete_told = True
            self._node.diagnostics.refuse(
                'belief',
                f'it holds only {counted(held, "deployment")}{not_repeated(qos.DEPTH)}',
            )
        if self.tracker.accept_belief(snapshot, known):
            self._take(snapshot)

    def _check_rules(self, snapshot: Snapshot) -> None:
        grid, values = self._node.grid, self._node.values
        if snapshot.grid != grid:
            raise ValueError(f'its grid is {snapshot.grid}: by the parameters it must be {grid}')
        check_search(values, grid, snapshot.robot_types)
        for agent in self._agents:
            own = value_for(values, 'max_steps', agent)
            theirs = snapshot.robot_types.get(agent, ORDINARY).max_steps or snapshot.max_steps
            if theirs < own:
                raise ValueError(
                    f'max_steps of {agent} is {theirs} for the estimator, which would refuse '
                    f'longer paths, but {own} for this planner: set the same value for both'
                )
            base = grid.at(own_base(values, agent, grid)).base
            if (other := snapshot.agent_base(agent)) != base:
                raise ValueError(
                    f'the base of {agent} is {other} for the estimator, which would refuse paths '
                    f'from another base, but {base} for this planner: set the same base for both'
                )
