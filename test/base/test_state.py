# SPDX-License-Identifier: Apache-2.0
"""The state of a base is a fold: a base that crashes at any message goes on as if it had not."""

from contextlib import suppress

from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.base.state import BaseState, MissingError
from kbnitp_ros.core import Observation
from kbnitp_ros.log.read import LoggedMessage
from kbnitp_ros.log.record import RecordedMission
from kbnitp_ros.log.roles import read_content, Role
from kbnitp_ros.messages.deployments import (
    OrderState,
    path_message,
    read_path,
    read_report,
    read_status,
    report_message,
    status_message,
)
from kbnitp_ros.messages.headers import content_hash, from_stamp
from kbnitp_ros.messages.operator_actions import (
    Action,
    operator_action_message,
    OperatorAction,
    read_operator_action,
)
import pytest
from samples import GRID, HOME, key

VALUES = {'recorded': True, 'presume_departure': False}
TYPES = {
    'path': 'nav_msgs/msg/Path',
    'report': 'kbnitp_msgs/msg/DeploymentReport',
    'status': 'kbnitp_msgs/msg/AgentStatus',
    'operator': 'kbnitp_msgs/msg/OperatorAction',
}
# How a deployment ends; a return to another field, and one with a jump, are refused.
ENDINGS = ('back', 'unmoved', 'lost', 'late', 'refused', 'out', 'foreign', 'jump', 'waiting')


def ending(order, how):
    """Return the messages of a robot after its path was sent."""

    def status(state, reason=''):
        return 'status', status_message(order, state, order.stamp + state, reason)

    def report(cells, survived, field_id=''):
        readings = [True] * (len(cells) - 1) if survived else None
        seen = Observation(cells, survived, readings)
        return 'report', report_message(order, seen, order.stamp + 9, field_id=field_id)

    left = [status(OrderState.ACCEPTED), status(OrderState.DEPARTED)]
    back, loss = report(HOME, True), report(HOME, False)
    return {
        'back': [*left, back],
        'unmoved': [*left, report([0, 0], True)],
        'lost': [*left, loss],
        'late': [*left, loss, back],
        'refused': [status(OrderState.REFUSED, 'no battery')],
        'out': left,
        'foreign': [*left, report(HOME, False, 'f' * 16)],
        'jump': [*left, report([0, 10, 0], True)],
        'waiting': left[:1],
    }[how]


@st.composite
def missions(draw):
    """Return messages of a mission, as (role, agent, message), in the order of the log."""
    told, number, sent = [], 0, 0
    for _ in range(draw(st.integers(1, 6))):
        team = []
        for agent in ['scout_1', 'scout_2'][: draw(st.integers(1, 2))]:
            number += 1
            order = key(number, agent)
            way = [('path', path_message(GRID, HOME, order.stamp))]
            way += ending(order, draw(st.sampled_from(ENDINGS)))
            team.append([(role, agent, message) for role, message in way])
        sent += len(team)
        while team:
            one = draw(st.integers(0, len(team) - 1))
            told.append(team[one].pop(0))
            team = [each for each in team if each]
        what = draw(st.sampled_from([None, Action.PAUSE, Action.RESUME, Action.END]))
        if what is not None:
            action = OperatorAction(number * 10**9 + 5, what, sent)
            told.append(('operator', '', operator_action_message(GRID, action)))
    return told


def hear(state, role, agent, message):
    """Take a message as the planner does, with the acknowledgement of the recorder."""
    try:
        match role:
            case 'path':
                order, cells = read_path(GRID, agent, message)
                state.take_path(order, cells, content_hash(message))
                state.take_recorded(order, content_hash(message))
            case 'status':
                order, status = read_status(message, agent)
                with suppress(MissingError):
                    state.take_status(order, status)
                state.take_recorded(order, status.content)
            case 'report':
                order, report = read_report(message, agent)
                if not report.survived:
                    state.departures.check_loss(order)
                state.record_report(order, report)
            case 'operator':
                state.take_action(read_operator_action(GRID, message))
    except ValueError:
        # The planner shows it.
        return


def fold(told):
    """Return the state of a log."""
    state = RecordedMission(GRID, 6, values=VALUES)
    for number, (role, agent, message) in enumerate(told):
        own = Role(role, agent, TYPES[role])
        topic = f'/{agent}/{role}'
        said = read_content(own, message)
        state.take(
            own, LoggedMessage(topic, number, TYPES[role], number, 0, 0, b'', message, said)
        )
    return state


def answers(state):
    """Return all that a planner asks of its base, in a form to compare."""
    return {
        'in flight': {each: vars(robot) for each, robot in state.in_flight.items()},
        'held': state.held,
        'undeparted': state.undeparted,
        'sent': (state.robots_left, state.known(0), state.forgotten(1)),
        'outcomes': state.outcomes,
        'reports': state.reports,
        'lost': state.lost,
        'unmoved': state.unmoved,
        'still': sorted(state.still_agents),
        'left': [state.has_departed(each) for each in state.orders],
        'refused': state.departures.refused,
        'out': state.departures.out,
        'actions': [*state.operator.actions],
        'operator': (state.operator.is_paused, state.operator.is_ended),
    }


@settings(max_examples=150)
@given(missions(), st.data())
def test_the_state_after_a_crash_at_any_message_is_that_without(told, data):
    whole = BaseState(GRID, 6, values=VALUES)
    for said in told:
        hear(whole, *said)
    crash = data.draw(st.integers(0, len(told)))
    resumed = fold(told[:crash])
    # Publishers repeat what they had published, which changes nothing.
    repeated = [each for each in told if each[0] in ('status', 'report')]
    for said in [*told[crash:], *repeated]:
        hear(resumed, *said)
    assert answers(resumed) == answers(whole)


@settings(max_examples=100)
@given(missions(), st.data())
def test_topics_may_overtake_each_other(told, data):
    """The state in the end does not depend on which topic was read first."""
    topics = {}
    for said in told:
        topics.setdefault(said[:2], []).append(said)
    mixed = []
    left = [[*each] for each in topics.values()]
    while left:
        mixed.append(left[data.draw(st.integers(0, len(left) - 1))].pop(0))
        left = [each for each in left if each]
    states = BaseState(GRID, 6, values=VALUES), BaseState(GRID, 6, values=VALUES)
    for state, order in zip(states, (told, mixed)):
        for said in order:
            hear(state, *said)
        # A loss that arrives before its departure is read again.
        for said in order:
            if said[0] == 'report':
                hear(state, *said)
    one, other = map(answers, states)
    # Where robots came back without a step counts in the order of arrival.
    for known in (one, other):
        known.pop('still')
        known['in flight'] = sorted(known['in flight'])
        known['undeparted'] = sorted(known['undeparted'])
    assert one == other


def test_a_status_before_its_path_is_kept():
    state = BaseState(GRID, 6, values=VALUES)
    message = status_message(key(1), OrderState.DEPARTED, 5)
    order, status = read_status(message, 'scout_1')
    for _ in range(2):
        with pytest.raises(MissingError, match='this planner has not sent it'):
            state.take_status(order, status)
    state.take_recorded(order, status.content)
    state.take_path(order, HOME, 7)
    assert state.is_away(order)
    assert from_stamp(message.deployment) == order.stamp


def test_the_path_that_was_recorded_first_replaces_the_own_one():
    state = BaseState(GRID, 6, values=VALUES)
    state.take_path(key(1), HOME, 7)
    assert state.take_recorded(key(1), 8)
    assert not state.take_other_path(key(1), [0, 1, 0], 9, 0)
    assert state.take_other_path(key(1), [0, 1, 0], 8, 0)
    assert list(state.paths[key(1)]) == [0, 1, 0]
    assert state.in_flight[key(1)].is_recorded
    # The first one stays.
    assert not state.take_recorded(key(1), 9)
