# SPDX-License-Identifier: Apache-2.0
"""The planner's subscriptions to standings and beliefs, and the checks of each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kbnitp_msgs.msg import BeliefMaps
from kbnitp_msgs.msg import Standings as StandingsMessage
from kbnitp_ros.base.mission_tracker import MissionTracker
from kbnitp_ros.base.state import BaseState, EvidenceName, LackingError, MissingError
from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.agents import own_base
from kbnitp_ros.configuration.mission import check_search
from kbnitp_ros.core import ORDINARY
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.standings import read_standings
from kbnitp_ros.messages.topics import BELIEF
from kbnitp_ros.nodes.presence import check_author
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from rclpy.subscription import Subscription

# Maximum number of estimators of which the last belief is kept.
MAX_ESTIMATORS = 4


class NewestBelief:
    """The standings that the planner follows, and the belief with the same evidence."""

    def __init__(
        self,
        node: FieldNode,
        agents: Sequence[str],
        state: BaseState,
        take: Callable[[Snapshot], None],
        act: Callable[[], None],
    ) -> None:
        self._node = node
        self._agents = agents
        self._state = state
        self._take = take
        self._act = act
        # The mission, and the rules of its estimator.
        self.tracker = MissionTracker()
        # The newest belief with the evidence of the standings; None before the first.
        self.newest: Snapshot | None = None
        # The last belief of each estimator, by its start: it may be ahead of the standings.
        self._last: dict[int, Snapshot] = {}
        # Hash of the rules of the estimator that is followed.
        self._rules = 0
        # Why the last standings were not followed; None if they were.
        self.why_unfollowed: str | None = None
        self._beliefs: Subscription | None = None
        self._standings: Subscription | None = None

    @property
    def evidence(self) -> EvidenceName | None:
        """Return the name of the evidence in the newest belief; None before the first."""
        return None if self.newest is None else EvidenceName(*self.newest.evidence)

    def subscribe(self) -> None:
        """Subscribe to both; called again after one of several estimators has left."""
        for known in (self._beliefs, self._standings):
            if known:
                self._node.destroy_subscription(known)
        self._subscribe_to_standings()
        self._beliefs = self._node.subscribe(BeliefMaps, 'belief', self._on_belief, qos.LATCHED)

    def _subscribe_to_standings(self) -> None:
        """Subscribe to standings, upon which the estimator publishes all of them."""
        self._standings = self._node.subscribe(
            StandingsMessage, 'standings', self._on_standings, qos.STANDINGS
        )

    def _on_standings(self, message: StandingsMessage) -> None:
        why: str | None = None
        try:
            said = read_standings(message)
            epoch = self._state.evidence.epoch
            check_author(self._node, said, epoch, self._rules)
            if said.epoch >= epoch:
                self._rules = said.rules
            if self._state.follow(said):
                self._node.diagnostics.accepted += 1
        except MissingError:
            assert self._standings is not None
            self._node.destroy_subscription(self._standings)
            self._subscribe_to_standings()
            return
        except LackingError as error:
            why = f'{message.author}: {error}'
            if why != self.why_unfollowed:
                self._node.diagnostics.refuse('standings', why)
        except ValueError as error:
            self._node.diagnostics.refuse('standings', error)
            return
        self.why_unfollowed = why
        self._match()
        self._act()

    def _on_belief(self, message: BeliefMaps) -> None:
        try:
            snapshot = read_belief_maps(message)
            self._check_rules(snapshot)
            self.tracker.check_belief(snapshot, self._node.count_authors('belief', BELIEF))
        except ValueError as error:
            self._node.diagnostics.refuse('belief', error)
            return
        self._node.diagnostics.accepted += 1
        self.tracker.accept_belief(snapshot)
        epoch, _ = snapshot.evidence
        last = self._last.pop(epoch, snapshot)
        self._last[epoch] = max(last, snapshot, key=lambda each: each.evidence)
        if len(self._last) > MAX_ESTIMATORS:
            followed = self._state.evidence.epoch
            del self._last[next(each for each in self._last if each != followed)]
        self._match()

    def _match(self) -> None:
        """Take the last belief once its evidence is that of the standings."""
        last = self._last.get(self._state.evidence.epoch)
        if last and last is not self.newest and last.evidence == self._state.evidence:
            self.newest = last
            self._take(last)

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
