# SPDX-License-Identifier: Apache-2.0
"""
The write-ahead protocol of a deployment: who has to have said what before a robot leaves.

1. The planner publishes a path, once nothing blocks a deployment (`PlannerState.obstacle`).
2. The recorder acknowledges it when it is on disk; the first path with a stamp counts.
3. The agent accepts the path, and publishes its departure; or it refuses the path, as also if the
   operator has taken it back, and the order is void.
4. The recorder acknowledges the departure when it is on disk, and the robot moves.
5. The agent publishes its report, or the planner gives the robot up.
6. The recorder acknowledges the report when it is on disk.
7. The estimator judges it, and publishes the standing and then the belief with that evidence.
8. The planner follows the standing. The next robot leaves when all that was reported is judged,
   and the belief names the same evidence as the standings.

Each step can be repeated: what is published again is the same message, which changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from kbnitp_ros.base.agent_states import AgentStates
from kbnitp_ros.base.readiness import Waiting
from kbnitp_ros.base.state import BaseState, EvidenceName
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.core.inference.record import deployment_order
from kbnitp_ros.files import some
from kbnitp_ros.messages.progress import Helper, MissionState, Obstacle

# Version whose messages this base exchanges with agents.
VERSION = '2.0'

# Who can end a condition, where that is always the same.
ENDED_BY = {
    Obstacle.ACTION_UNRECORDED: Helper.RECORDER,
    # Who starts the estimator with the log of the mission.
    Obstacle.UNFOLLOWED: Helper.OPERATOR,
    Obstacle.NO_BELIEF: Helper.ESTIMATOR,
    Obstacle.BELIEF_BEHIND: Helper.ESTIMATOR,
    Obstacle.DECIDING: Helper.ESTIMATOR,
    Obstacle.NO_SUBSCRIBER: Helper.ROBOT,
    Obstacle.PAUSED: Helper.OPERATOR,
    Obstacle.GOAL_LOST: Helper.OPERATOR,
    Obstacle.WORTHLESS: Helper.OPERATOR,
    Obstacle.UNAPPROVED: Helper.OPERATOR,
}


@dataclass(frozen=True)
class PlannerState:
    """The state that decides whether robots leave."""

    agents: Sequence[str]
    # The evidence, the robots in flight, what the operator ordered, and the planner's parameters.
    base: BaseState
    # What the agents say of themselves.
    states: AgentStates
    # Description of the pending operator action; None if none is pending.
    unrecorded_action: str | None
    # Name of the evidence in the newest belief; None before the first belief.
    newest: EvidenceName | None
    # Why the standings of an estimator are not followed; None if they are.
    why_unfollowed: str | None
    # Number of nodes that publish beliefs.
    estimators: int
    # Whether the decision on the newest belief has arrived, so that robots can be planned.
    is_decided: bool
    # Return why the goal or the stops end the mission; None if they do not.
    why_over: Callable[[], str | None]
    # Describe the missing subscribers before the first departure; None if none is missing.
    missing_listeners: Callable[[], str | None]
    # Return the full name of a topic and of a service.
    topic: Callable[[str], str]
    service: Callable[[str], str]
    # Agents of the running search.
    searched: Sequence[str] = ()
    # Reason why no path found is worth a robot; empty if any path is.
    why_worthless: str = ''
    # The plans that wait for the operator's approval.
    proposed: Sequence[DeploymentKey] = ()
    # Agents without a node, agents whose nodes do not report departures, agents whose nodes have
    # messages of another version, and agents that get no order for a while after they refused an
    # order.
    absent: Collection[str] = ()
    silent: Collection[str] = ()
    outdated: Collection[str] = ()
    left_alone: Collection[str] = ()
    # Agents whose robots are kept at their base, by the condition.
    waiting: Mapping[str, Waiting] = field(default_factory=dict)

    @property
    def sent(self) -> int:
        """Return the number of robots sent, without refused orders."""
        return self.base.robots_left

    @property
    def robots(self) -> int:
        """Return the number of robots to deploy, or to await after `end_mission`."""
        if self.base.operator.is_ended:
            return self.base.ended + len(self.unreported)
        # Robots that came back without a step are sent again.
        robots: int = self.base.values['robots'] + len(self.base.unmoved)
        return robots

    @property
    def unreported(self) -> list[DeploymentKey]:
        """Return the deployments in flight that the next round waits for."""
        # Agents that left the graph do not delay other agents, nor do held deployments. After
        # end_mission, robots at their base do not depart any more.
        at_base = self.base.undeparted if self.base.operator.is_ended else ()
        left_out = {*self.base.held, *self.base.unjudged, *at_base}
        return [
            key
            for key in self.base.in_flight
            if key.agent not in self.absent and key not in left_out
        ]

    @property
    def mute(self) -> list[str]:
        """Return the agents that do not report departures; empty if reports are not required."""
        if self.base.values['presume_departure'] or not self.base.values['silent_loss']:
            return []
        return [agent for agent in self.silent if agent not in self.absent]

    @property
    def free_agents(self) -> list[str]:
        """Return the agents that are present and have no robot in flight."""
        out = {key.agent for key in self.base.in_flight}
        taken = {*out, *self.absent, *self.mute, *self.outdated, *self.left_alone, *self.waiting}
        taken |= {*self.states.foreign, *self.states.unstated, *self.base.still_agents}
        return [agent for agent in self.agents if agent not in taken]

    @property
    def obstacle(self) -> Obstacle:
        """Return the condition that blocks the next deployment; NONE if there is none."""
        base = self.base
        if self.unrecorded_action is not None:
            return Obstacle.ACTION_UNRECORDED
        if base.operator.is_goal_lost:
            return Obstacle.GOAL_LOST
        # Without an estimator the operator can still end the mission.
        awaits_estimator = not base.operator.is_ended or bool(self.estimators)
        if self.why_unfollowed is not None and awaits_estimator:
            return Obstacle.UNFOLLOWED
        if self.newest is None and not base.operator.is_ended:
            return Obstacle.NO_BELIEF
        unreported = self.unreported
        if unreported and not base.values['rolling']:
            return Obstacle.UNREPORTED
        if awaits_estimator:
            # After `end_mission` a loss does not wait for the departure of its robot.
            if not all(base.operator.is_ended and base.is_at_base(key) for key in base.unjudged):
                return Obstacle.UNJUDGED
            if self.newest != base.evidence:
                return Obstacle.BELIEF_BEHIND
        # A goal that was reached may be lost by the report of the last robot.
        if base.ended >= self.robots and (self.is_decided or not base.operator.reached):
            return Obstacle.ALL_DEPLOYED
        if not self.is_decided:
            return Obstacle.DECIDING
        if self.why_over() is not None:
            return Obstacle.UNREPORTED if unreported else Obstacle.OVER
        if self.missing_listeners() is not None:
            return Obstacle.NO_SUBSCRIBER
        if self.sent >= self.robots:
            return Obstacle.ALL_LEFT
        if base.operator.is_paused:
            return Obstacle.PAUSED
        return Obstacle.NONE if self.free_agents else Obstacle.NO_FREE_AGENT

    def ends_by(self, obstacle: Obstacle) -> Helper:
        """Return who can end a condition."""
        base = self.base
        if obstacle is Obstacle.UNJUDGED:
            if not all(map(base.is_on_record, base.unjudged)):
                return Helper.RECORDER
            # A loss waits for its departure without a time limit, unless it is given up.
            waits = any(base.is_at_base(key) for key in base.unjudged)
            return Helper.OPERATOR if waits else Helper.ESTIMATOR
        if obstacle is Obstacle.UNREPORTED:
            key = min(self.unreported, key=deployment_order)
            is_recorded = base.in_flight[key].is_recorded or not base.values['recorded']
            return Helper.ROBOT if is_recorded else Helper.RECORDER
        if obstacle in (Obstacle.ALL_LEFT, Obstacle.NO_FREE_AGENT):
            return Helper.OPERATOR if base.held or base.still_agents else Helper.ROBOT
        return ENDED_BY.get(obstacle, Helper.NOBODY)

    def is_plain(self, obstacle: Obstacle) -> bool:
        """Return whether a condition is normal, so that progress gives no reason for it."""
        helper = self.ends_by(obstacle)
        if helper in (Helper.OPERATOR, Helper.RECORDER):
            return False
        if helper is Helper.ESTIMATOR and not self.estimators:
            return False
        return obstacle in (
            Obstacle.UNREPORTED,
            Obstacle.UNJUDGED,
            Obstacle.BELIEF_BEHIND,
            Obstacle.DECIDING,
            Obstacle.ALL_LEFT,
            Obstacle.SEARCHING,
        )

    def topics(self, agents: Iterable[str], name: str) -> str:
        """Return the full topic names of agents, joined in words."""
        return some(self.topic(f'{agent}/{name}') for agent in agents)

    def mission_state(self, obstacle: Obstacle) -> MissionState:
        """Return the state of the mission while a condition blocks deployments."""
        if self.base.operator.is_ended:
            return MissionState.ENDED
        if obstacle.is_end:
            return MissionState.DONE
        is_holding = self.base.operator.is_holding
        return MissionState.PAUSED if is_holding else MissionState.RUNNING
