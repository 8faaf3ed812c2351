# SPDX-License-Identifier: Apache-2.0
"""What keeps robots from leaving, in words: who is waited for, and what ends the wait."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from kbnitp_ros.base.obstacles import Circumstances, Obstacle
from kbnitp_ros.core import deployment_order
from kbnitp_ros.files import counted, some


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
