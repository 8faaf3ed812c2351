# SPDX-License-Identifier: Apache-2.0
"""Descriptions of the conditions that block the next deployment, for people."""

from __future__ import annotations

from itertools import chain

from kbnitp_ros.base.protocol import PlannerState, VERSION
from kbnitp_ros.base.state import MAX_STILL
from kbnitp_ros.core.inference.record import deployment_order
from kbnitp_ros.files import some
from kbnitp_ros.messages.progress import Obstacle


def describe_obstacle(now: PlannerState, obstacle: Obstacle) -> str:
    """Describe the planner's wait, or the end of the mission."""
    match obstacle:
        case Obstacle.ACTION_UNRECORDED:
            return now.unrecorded_action or ''
        case Obstacle.UNFOLLOWED:
            topic = now.topic('standings')
            return f'standings on {topic}, which are not followed: {now.why_unfollowed}'
        case Obstacle.NO_BELIEF:
            start = 'its estimator waits for the nodes in its parameter await_nodes'
            return f'the belief on {belief_topic(now)}: ' + (
                start if now.estimators else 'start an estimator'
            )
        case Obstacle.UNREPORTED:
            return report(now)
        case Obstacle.UNJUDGED:
            return judgement(now)
        case Obstacle.BELIEF_BEHIND:
            return f'a belief that holds all that counts on {belief_topic(now)}'
        case Obstacle.DECIDING:
            if now.is_decided:
                return f'draws of the hazards from the estimator by {now.service("draws")}'
            return (
                f'the decision on {now.topic("decision")}, which an estimator with the same '
                'parameters goal.* computes'
            )
        case Obstacle.NO_SUBSCRIBER:
            return now.missing_listeners() or ''
        case Obstacle.ALL_LEFT:
            out = [key for key in now.base.in_flight if key not in now.base.held]
            last = f'the last robots in flight: {some(out)} (parameter robots)' if out else ''
            return '; '.join(filter(None, [last, held_robots(now)]))
        case Obstacle.PAUSED:
            return f'the operator to end the pause by the service {now.service("pause")}'
        case Obstacle.GOAL_LOST:
            return (
                'the operator, since the goal was reached and no longer holds: call '
                f'{now.service("pause")} with false to send robots again, or '
                f'{now.service("end_mission")}'
            )
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
        case Obstacle.NONE:
            return ''


def deployed(now: PlannerState) -> str:
    """Return the number of deployments of a mission that is over."""
    by_operator = ', ended by the operator' * now.base.operator.is_ended
    deployed = now.base.ended - len(now.base.unmoved)
    return f'{deployed} of {now.base.values["robots"]} robots deployed{by_operator}'


def judgement(now: PlannerState) -> str:
    """Describe the wait for standings."""
    base, topic = now.base, now.topic('standings')
    unrecorded = [key for key in base.unjudged if not base.is_on_record(key)]
    at_base = filter(base.is_at_base, base.unjudged)
    key = next(chain(unrecorded, at_base, base.unjudged))
    what = 'refusal' if base.is_refused(key) else 'report'
    if unrecorded:
        return (
            f'the recorder to acknowledge the {what} of {key} on '
            f'{now.topic(key.agent)}/recorded (parameter recorded)'
        )
    wait = f'the estimator to judge the {what} of {key} on {topic}'
    if base.is_at_base(key) and not base.is_refused(key):
        return (
            f'{wait}: a loss counts once {key.agent} reports the departure on '
            f'{now.topic(key.agent)}/status, or the operator gives it up by '
            f'{now.service("give_up")}'
        )
    return wait if now.estimators else f'{wait}, which nobody publishes: start an estimator'


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
        departure = f'the departure of {key}, which its agent reports on {agent}/status'
        return '; '.join(filter(None, [departure, now.states.words(key.agent)]))
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
        *(f'{agent} waits: {each.why}' for agent, each in now.waiting.items()),
        f'{some(left_alone)} refused the last order' if left_alone else '',
        f'nobody publishes {now.topics(mute, "status")}, so a robot that never left would '
        'count as lost (parameter presume_departure)'
        if mute
        else '',
    ]
    return f'a free agent: {"; ".join(filter(None, reasons))} (parameter agents)'
