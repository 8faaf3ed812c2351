# SPDX-License-Identifier: Apache-2.0
"""What keeps the next robots from leaving, and how it is said."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import auto, Enum
from typing import Any, NamedTuple

from kbnitp_ros.base.deployments_in_flight import DeploymentsInFlight
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.core.inference.record import deployment_order
from kbnitp_ros.files import counted, some
from kbnitp_ros.messages.operator_actions import OperatorState
from kbnitp_ros.messages.progress import MissionState


class Obstacle(Enum):
    """What keeps robots from leaving."""

    ACTION_UNRECORDED = auto()
    NO_BELIEF = auto()
    UNREPORTED = auto()
    BELIEF_BEHIND = auto()
    ALL_DEPLOYED = auto()
    DECIDING = auto()
    UNDECIDED = auto()
    OVER = auto()
    NOT_HEARD = auto()
    ALL_LEFT = auto()
    PAUSED = auto()
    NO_FREE_AGENT = auto()
    SEARCHING = auto()
    WORTHLESS = auto()
    UNAPPROVED = auto()

    @property
    def is_end(self) -> bool:
        """Whether the mission is over by it."""
        return self in (Obstacle.ALL_DEPLOYED, Obstacle.OVER)


class AgentPresence(NamedTuple):
    """What is known of an agent."""

    # Whether somebody answers for it.
    is_present: bool
    # Whether it tells when its robots depart.
    says_status: bool
    # Whether it refused its last order, and is sent no other yet.
    is_left_alone: bool


@dataclass(frozen=True)
class Circumstances:
    """All that decides whether robots leave."""

    # The planner's parameters by name.
    values: Mapping[str, Any]
    agents: Mapping[str, AgentPresence]
    # The robots that were sent and not reported.
    in_flight: DeploymentsInFlight
    # What holds by the operator's actions.
    operator: OperatorState
    # What an action of the operator waits for; empty if none does.
    unrecorded_action: str
    # How many robots were sent, those that only the belief knows of included.
    sent: int
    # How many deployments the newest belief holds; None if there is none.
    newest: int | None
    # How many the belief heard last holds: less than the newest if an estimator starts anew.
    last_heard: int
    # What the estimator has refused of the evidence since that; empty if nothing.
    refusal: str
    # How many nodes publish beliefs.
    estimators: int
    # Whether robots can be planned for the goal on the newest belief.
    is_decided: bool
    # Whether it is being computed what may be relied on by that.
    is_deciding: bool
    # Returns why no more robots leave by the goal and the stops; empty if they do.
    why_over: Callable[[], str]
    # Returns who does not listen yet before the first robot leaves; empty if all do.
    missing_listeners: Callable[[], str]
    # For whose robots paths are searched for.
    searched: Sequence[str] = ()
    # Why nothing that was found is worth a robot.
    why_worthless: str = ''
    # What waits for the operator's approval.
    proposed: Sequence[DeploymentKey] = ()

    @property
    def reported(self) -> int:
        """How many deployments were reported, so that a belief must hold them."""
        return self.sent - len(self.in_flight)

    @property
    def robots(self) -> int:
        """How many robots are to be deployed; after the end those that have departed."""
        if self.operator.is_ended:
            return self.sent - len(self.in_flight.undeparted)
        robots: int = self.values['robots']
        return robots

    @property
    def unreported(self) -> list[DeploymentKey]:
        """Return the deployments in flight that the next round waits for."""
        # An agent that has left the graph does not keep the others from their next round, nor do
        # robots that do not depart any more keep a mission from its end.
        left_out = self.in_flight.undeparted if self.operator.is_ended else ()
        return [
            key
            for key in self.in_flight
            if self.agents[key.agent].is_present and key not in left_out
        ]

    @property
    def absent(self) -> list[str]:
        """Return the agents that nobody answers for."""
        return [name for name, agent in self.agents.items() if not agent.is_present]

    @property
    def mute(self) -> list[str]:
        """Return the agents that do not say when they depart, where their silence would count."""
        if self.values['presume_departure'] or not self.values['silent_loss']:
            return []
        return [
            name
            for name, agent in self.agents.items()
            if agent.is_present and not agent.says_status
        ]

    @property
    def left_alone(self) -> list[str]:
        """Return the agents that refused their last order, and are sent no other yet."""
        return [name for name, agent in self.agents.items() if agent.is_left_alone]

    @property
    def free_agents(self) -> list[str]:
        """Return the agents that somebody answers for and whose robots are home."""
        taken = {*self.in_flight.agents, *self.absent, *self.mute, *self.left_alone}
        return [name for name in self.agents if name not in taken]

    @property
    def obstacle(self) -> Obstacle | None:
        """Return what keeps the next robots from being planned; None when nothing."""
        if self.unrecorded_action:
            return Obstacle.ACTION_UNRECORDED
        if self.newest is None and (self.sent or not self.operator.is_ended):
            return Obstacle.NO_BELIEF
        held = self.newest or 0
        unreported = self.unreported
        if unreported and not self.values['rolling']:
            return Obstacle.UNREPORTED
        if held < self.reported:
            return Obstacle.BELIEF_BEHIND
        if held >= self.robots:
            return Obstacle.ALL_DEPLOYED
        if not self.is_decided:
            return Obstacle.DECIDING if self.is_deciding else Obstacle.UNDECIDED
        if self.why_over():
            return Obstacle.UNREPORTED if unreported else Obstacle.OVER
        if self.missing_listeners():
            return Obstacle.NOT_HEARD
        if self.sent >= self.robots:
            return Obstacle.ALL_LEFT
        if self.operator.is_paused:
            return Obstacle.PAUSED
        return None if self.free_agents else Obstacle.NO_FREE_AGENT

    def is_plain(self, obstacle: Obstacle) -> bool:
        """Return whether an obstacle keeps robots from leaving for a while in every mission."""
        if obstacle is Obstacle.BELIEF_BEHIND:
            return not self.refusal
        return obstacle in (
            Obstacle.UNREPORTED,
            Obstacle.DECIDING,
            Obstacle.ALL_LEFT,
            Obstacle.SEARCHING,
        )

    def mission_state(self, obstacle: Obstacle) -> MissionState:
        """Return how far the mission is while an obstacle keeps robots from leaving."""
        if self.operator.is_ended:
            return MissionState.ENDED
        if obstacle.is_end:
            return MissionState.DONE
        return MissionState.PAUSED if self.operator.is_paused else MissionState.RUNNING


class FullNames(NamedTuple):
    """How names are resolved."""

    # Return the full name, as those that publish or answer there have it.
    of_topic: Callable[[str], str]
    of_service: Callable[[str], str]

    def of_topics(self, agents: Iterable[str], name: str) -> str:
        """Return the topics of agents that have a name, in words."""
        return some(self.of_topic(f'{agent}/{name}') for agent in agents)


def describe_obstacle(now: Circumstances, obstacle: Obstacle, names: FullNames) -> str:
    """Return what the planner waits for, or how the mission ended."""
    match obstacle:
        case Obstacle.ACTION_UNRECORDED:
            return now.unrecorded_action
        case Obstacle.NO_BELIEF:
            return first_belief(now, names)
        case Obstacle.UNREPORTED:
            return report(now, names)
        case Obstacle.BELIEF_BEHIND:
            return next_belief(now, names)
        case Obstacle.DECIDING:
            return 'the decision for the goal to be made'
        case Obstacle.UNDECIDED:
            return (
                'all evidence of the belief, for the goal: restart the planner with the '
                'parameter resume, which names the log'
            )
        case Obstacle.NOT_HEARD:
            return now.missing_listeners()
        case Obstacle.ALL_LEFT:
            return f'robots that were sent: {some(now.in_flight)}; no more are (parameter robots)'
        case Obstacle.PAUSED:
            return f'the operator to end the pause by the service {names.of_service("pause")}'
        case Obstacle.NO_FREE_AGENT:
            return free_agent(now, names)
        case Obstacle.SEARCHING:
            return f'the search for the paths of {some(now.searched)} to end'
        case Obstacle.WORTHLESS:
            return (
                f'the operator, since nothing is worth a robot: {now.why_worthless}; other '
                f'parameters, or the service {names.of_service("end_mission")}, go on'
            )
        case Obstacle.UNAPPROVED:
            proposals = names.of_topics((key.agent for key in now.proposed), 'proposal')
            return (
                f'the operator to approve of {proposals} by the service '
                f'{names.of_service("approve")} (parameter approval)'
            )
        case Obstacle.ALL_DEPLOYED:
            return deployed(now)
        case Obstacle.OVER:
            return f'{deployed(now)}: {now.why_over()}'


def deployed(now: Circumstances) -> str:
    """Return how many robots were deployed in a mission that is over."""
    by_operator = ', ended by the operator' * now.operator.is_ended
    return f'{now.newest or 0} of {now.values["robots"]} robots deployed{by_operator}'


def not_heard_again(kept: int) -> str:
    """Return why an estimator may never hold all deployments, of which so many are kept."""
    return (
        f', and only the last {kept} of each agent are heard again: restart the '
        'estimator with the parameter resume, which names the log'
    )


def first_belief(now: Circumstances, names: FullNames) -> str:
    """Return that no belief was heard, and of whom one is awaited."""
    wait = f'the belief on {belief_topic(now, names)}'
    if not now.estimators:
        return f'{wait}: start an estimator'
    return f'{wait}: its estimator waits for those that its parameter await_nodes names'


def next_belief(now: Circumstances, names: FullNames) -> str:
    """Return which belief is awaited."""
    wait = f'a belief that holds {counted(now.reported, "deployment")}'
    if now.last_heard < now.reported and now.in_flight.forgotten:
        again = not_heard_again(now.in_flight.kept)
        return f'{wait}; the last one holds {now.last_heard}{again}'
    refusal = f'; {now.refusal}' if now.refusal else ''
    return f'{wait} on {belief_topic(now, names)}{refusal}'


def belief_topic(now: Circumstances, names: FullNames) -> str:
    """Return on which topic beliefs are heard, and whether anybody publishes them."""
    name = names.of_topic('belief')
    return name if now.estimators else f'{name}, which nobody publishes'


def report(now: Circumstances, names: FullNames) -> str:
    """Return which report is awaited first, and what ends the wait."""
    key = min(now.unreported, key=deployment_order)
    agent = names.of_topic(key.agent)
    wait = f'{key} to be reported on {agent}/report'
    if now.values['recorded'] and not now.in_flight[key].is_recorded:
        return (
            f'{wait}: it may leave when the recorder tells on {agent}/recorded that its '
            'path is on disk (parameter recorded)'
        )
    if not now.in_flight.has_departed(key) and now.agents[key.agent].says_status:
        return f'{key} to depart, as its agent tells on {agent}/status; it is not given up before'
    if now.values['silent_loss']:
        deadline = now.values['return_deadline']
        return f'{wait}, at most until {deadline} s after it is due (parameter return_deadline)'
    return f'{wait}, however long that takes (parameter silent_loss is false)'


def free_agent(now: Circumstances, names: FullNames) -> str:
    """Return that an agent is awaited, and why each of the team is not free."""
    absent, mute, left_alone = now.absent, now.mute, now.left_alone
    reasons = [
        f'nobody publishes {names.of_topics(absent, "report")}' if absent else '',
        f'{some(now.in_flight)} are out' if now.in_flight else '',
        f'{some(left_alone)} refused the last order' if left_alone else '',
        f'nobody publishes {names.of_topics(mute, "status")}, so that the silence of a robot '
        'that has not left would count as its loss (parameter presume_departure)'
        if mute
        else '',
    ]
    return f'an agent whose robot is home: {"; ".join(filter(None, reasons))} (parameter agents)'
