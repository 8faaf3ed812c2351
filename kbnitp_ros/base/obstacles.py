# SPDX-License-Identifier: Apache-2.0
"""Conditions that block the next deployment, and their descriptions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import auto, Enum

from kbnitp_ros.base.agent_states import AgentStates
from kbnitp_ros.base.state import BaseState, MAX_STILL
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.core.inference.record import deployment_order
from kbnitp_ros.files import counted, some
from kbnitp_ros.messages.progress import MissionState

# Version whose messages this base exchanges with agents.
VERSION = '1.9'


class Obstacle(Enum):
    """A condition that blocks the next deployment."""

    ACTION_UNRECORDED = auto()
    NO_BELIEF = auto()
    UNREPORTED = auto()
    BELIEF_BEHIND = auto()
    ALL_DEPLOYED = auto()
    DECIDING = auto()
    OVER = auto()
    NO_SUBSCRIBER = auto()
    ALL_LEFT = auto()
    PAUSED = auto()
    NO_FREE_AGENT = auto()
    SEARCHING = auto()
    WORTHLESS = auto()
    UNAPPROVED = auto()

    @property
    def is_end(self) -> bool:
        """Return whether the condition ends the mission."""
        return self in (Obstacle.ALL_DEPLOYED, Obstacle.OVER)


@dataclass(frozen=True)
class PlannerState:
    """The state that decides whether robots leave."""

    agents: Sequence[str]
    # The evidence, the robots in flight, what the operator ordered, and the planner's parameters.
    base: BaseState
    # What the agents say of themselves.
    states: AgentStates
    # Description of the pending operator action; empty if none is pending.
    unrecorded_action: str
    # Number of robots sent, including those known only from the belief.
    sent: int
    # Number of deployments in the newest belief; None before the first belief.
    newest: int | None
    # Number of deployments in the last belief received; lower after the estimator restarted.
    last_received: int
    # Last refusal of evidence by the estimator since the last belief; empty if none.
    refusal: str
    # Number of paths and reports of each agent that publishers keep.
    kept: int
    # Number of nodes that publish beliefs.
    estimators: int
    # Whether the decision on the newest belief has arrived, so that robots can be planned.
    is_decided: bool
    # Return why the goal or the stops end the mission; empty if they do not.
    why_over: Callable[[], str]
    # Describe the missing subscribers before the first departure; empty if none is missing.
    missing_listeners: Callable[[], str]
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

    @property
    def reported(self) -> int:
        """Return the number of deployments reported, which the next belief must hold."""
        return self.sent - len(self.base.in_flight)

    @property
    def robots(self) -> int:
        """Return the number of robots to deploy, or after end_mission the number that departed."""
        if self.base.operator.is_ended:
            return self.sent - len({*self.base.undeparted, *self.base.held})
        # Robots that came back without a step are sent again.
        robots: int = self.base.values['robots'] + len(self.base.unmoved)
        return robots

    @property
    def unreported(self) -> list[DeploymentKey]:
        """Return the deployments in flight that the next round waits for."""
        # Agents that left the graph do not delay other agents, nor do held deployments. After
        # end_mission, robots at their base do not depart any more.
        at_base = self.base.undeparted if self.base.operator.is_ended else ()
        left_out = {*self.base.held, *at_base}
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
        taken = {*out, *self.absent, *self.mute, *self.outdated, *self.left_alone}
        taken |= {*self.states.foreign, *self.states.unstated, *self.base.still_agents}
        return [agent for agent in self.agents if agent not in taken]

    @property
    def obstacle(self) -> Obstacle | None:
        """Return the condition that blocks the next deployment; None if there is none."""
        if self.unrecorded_action:
            return Obstacle.ACTION_UNRECORDED
        if self.newest is None and (self.sent or not self.base.operator.is_ended):
            return Obstacle.NO_BELIEF
        held = self.newest or 0
        unreported = self.unreported
        if unreported and not self.base.values['rolling']:
            return Obstacle.UNREPORTED
        if held < self.reported:
            return Obstacle.BELIEF_BEHIND
        if held >= self.robots:
            return Obstacle.ALL_DEPLOYED
        if not self.is_decided:
            return Obstacle.DECIDING
        if self.why_over():
            return Obstacle.UNREPORTED if unreported else Obstacle.OVER
        if self.missing_listeners():
            return Obstacle.NO_SUBSCRIBER
        if self.sent >= self.robots:
            return Obstacle.ALL_LEFT
        if self.base.operator.is_paused:
            return Obstacle.PAUSED
        return None if self.free_agents else Obstacle.NO_FREE_AGENT

    def is_plain(self, obstacle: Obstacle) -> bool:
        """Return whether a condition is normal, so that progress gives no reason for it."""
        if obstacle is Obstacle.BELIEF_BEHIND:
            return not self.refusal
        return obstacle in (
            Obstacle.UNREPORTED,
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
        return MissionState.PAUSED if self.base.operator.is_paused else MissionState.RUNNING


def describe_obstacle(now: PlannerState, obstacle: Obstacle) -> str:
    """Describe the planner's wait, or the end of the mission."""
    match obstacle:
        case Obstacle.ACTION_UNRECORDED:
            return now.unrecorded_action
        case Obstacle.NO_BELIEF:
            start = 'its estimator waits for the nodes in its parameter await_nodes'
            return f'the belief on {belief_topic(now)}: ' + (
                start if now.estimators else 'start an estimator'
            )
        case Obstacle.UNREPORTED:
            return report(now)
        case Obstacle.BELIEF_BEHIND:
            return next_belief(now)
        case Obstacle.DECIDING:
            if now.is_decided:
                return f'draws of the hazards from the estimator by {now.service("draws")}'
            return (
                f'the decision on {now.topic("decision")}, which an estimator with the same '
                'parameters goal.* computes'
            )
        case Obstacle.NO_SUBSCRIBER:
            return now.missing_listeners()
        case Obstacle.ALL_LEFT:
            out = [key for key in now.base.in_flight if key not in now.base.held]
            last = f'the last robots in flight: {some(out)} (parameter robots)' if out else ''
            return '; '.join(filter(None, [last, held_robots(now)]))
        case Obstacle.PAUSED:
            return f'the operator to end the pause by the service {now.service("pause")}'
        case Obstacle.NO_FREE_AGENT:
            return free_agent(now)
        case Obstacle.SEARCHING:
            return f'the search for the paths of {some(now.searched)} to end'
        case Obstacle.WORTHLESS:
            return (
                f'the operator, since nothing is worth a robot: {now.why_worthless}; change '
                f'parameters, or call {now.service("end_mission")}'
            )
        case Obstacle.UNAPPROVED:
            proposals = now.topics((key.agent for key in now.proposed), 'proposal')
            return (
                f'the operator to approve {proposals} by the service '
                f'{now.service("approve")} (parameter approval)'
            )
        case Obstacle.ALL_DEPLOYED:
            return deployed(now)
        case Obstacle.OVER:
            return f'{deployed(now)}: {now.why_over()}'


def deployed(now: PlannerState) -> str:
    """Return the number of deployments of a mission that is over."""
    by_operator = ', ended by the operator' * now.base.operator.is_ended
    deployed = (now.newest or 0) - len(now.base.unmoved)
    return f'{deployed} of {now.base.values["robots"]} robots deployed{by_operator}'


def not_repeated(kept: int) -> str:
    """Explain why an estimator may never hold all deployments."""
    return (
        f', and publishers keep only the last {kept} paths and reports of each agent: restart '
        'the estimator with the parameter resume set to the log'
    )


def next_belief(now: PlannerState) -> str:
    """Describe the wait for the next belief."""
    wait = f'a belief that holds {counted(now.reported, "deployment")}'
    if now.last_received < now.reported and now.base.forgotten(now.kept):
        again = not_repeated(now.kept)
        return f'{wait}; the last belief holds {now.last_received}{again}'
    refusal = f'; {now.refusal}' if now.refusal else ''
    return f'{wait} on {belief_topic(now)}{refusal}'


def belief_topic(now: PlannerState) -> str:
    """Return the topic of beliefs, and whether it has a publisher."""
    name = now.topic('belief')
    return name if now.estimators else f'{name}, which nobody publishes'


def report(now: PlannerState) -> str:
    """Describe the first report awaited, and its deadline."""
    key = min(now.unreported, key=deployment_order)
    agent = now.topic(key.agent)
    wait = f'the report of {key} on {agent}/report'
    if now.base.values['recorded'] and not now.base.in_flight[key].is_recorded:
        return (
            f'{wait}: its robot leaves once the recorder acknowledges its path on '
            f'{agent}/recorded (parameter recorded)'
        )
    if not now.base.is_away(key) and key.agent not in now.silent:
        said = now.states.reason(key.agent)
        says = f'; {key.agent} says: {said}' if said else ''
        return f'the departure of {key}, which its agent reports on {agent}/status{says}'
    if now.base.values['silent_loss']:
        deadline = now.base.values['return_deadline']
        return (
            f'{wait}: without a report the robot is given up {deadline} s after its expected '
            'return (parameter return_deadline)'
        )
    return f'{wait}, without a time limit (parameter silent_loss is false)'


def held_robots(now: PlannerState) -> str:
    """Describe the held deployments, and the operator's choice; empty if there are none."""
    held = [f'{key}: {why}' for key, why in now.base.held.items()]
    if not held:
        return ''
    return (
        f'the operator to decide on {some(held)}; mend the robot, and its report counts when it '
        f'is repeated, or count it as lost by {now.service("give_up")}'
    )


def free_agent(now: PlannerState) -> str:
    """Explain why no agent is free."""
    absent, mute, left_alone = now.absent, now.mute, now.left_alone
    unstated = [agent for agent in now.states.unstated if agent not in absent]
    out = [key for key in now.base.in_flight if key not in now.base.held]
    still = now.base.still_agents
    reasons = [
        f'nobody publishes {now.topics(absent, "report")}' if absent else '',
        f'{some(out)} in flight' if out else '',
        held_robots(now),
        f'{some(now.outdated)} must be of version {VERSION} or later' if now.outdated else '',
        f'the field of {some(unstated)} on {now.topics(unstated, "state")}' if unstated else '',
        f'{some(still)} came back without a step {MAX_STILL} times in a row: mend the robot, or '
        f'call {now.service("pause")} with false to send it again'
        if still
        else '',
        now.states.reasons(),
        f'{some(left_alone)} refused the last order' if left_alone else '',
        f'nobody publishes {now.topics(mute, "status")}, so a robot that never left would '
        'count as lost (parameter presume_departure)'
        if mute
        else '',
    ]
    return f'a free agent: {"; ".join(filter(None, reasons))} (parameter agents)'
