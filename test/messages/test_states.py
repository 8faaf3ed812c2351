# SPDX-License-Identifier: Apache-2.0
"""The state of an agent names the parameter in which its field differs, with both values."""

from dataclasses import replace

from kbnitp_ros.base.agent_states import AgentStates
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.states import read_state, Readiness, state_message
from laws import for_each

GRID = Grid(12, 8, blocked=[5])
VALUES = {'presume_departure': False}


def state(grid=GRID, reason='', readiness=Readiness.READY, is_at_base=True, stamp=5, journal='a'):
    message = state_message(grid, 'scout_1', readiness, reason, is_at_base, stamp, journal)
    return read_state(message, 'scout_1')


@for_each(
    'change, difference',
    [
        ({}, ''),
        ({'width': 13}, 'parameter grid.width is 13 there and 12 here'),
        ({'height': 9}, 'parameter grid.height is 9 there and 8 here'),
        ({'resolution': 0.1}, 'parameter grid.resolution is 0.1 there and 1.0 here'),
        ({'origin': (1, 2)}, 'parameter grid.origin is (1.0, 2.0) there and (0.0, 0.0) here'),
        ({'yaw': 0.1}, 'parameter grid.origin (yaw) is 0.1 there and 0.0 here'),
        ({'connectivity': 4}, 'parameter grid.connectivity is 4 there and 8 here'),
        ({'through_corners': False}, 'parameter grid.corners is avoid there and cut here'),
        ({'base': 4}, 'parameter grid.base is 4 there and 0 here'),
        ({'blocked': ()}, 'parameter grid.blocked is 0 cells there and 1 cells here'),
        ({'blocked': [6]}, 'parameter grid.blocked is other 1 cells there and 1 cells here'),
    ],
)
def test_the_parameter_that_differs_is_named(change, difference):
    assert state(replace(GRID, **change)).difference(GRID) == difference


def test_agents_may_have_bases_of_their_own():
    base = read_state(state_message(GRID, '', Readiness.READY, '', False, 5), '')
    assert base.difference(replace(GRID, base=4)) == ''


def team():
    return AgentStates(dict.fromkeys(['scout_1', 'scout_2'], GRID), VALUES)


def test_a_field_must_be_stated_unless_departures_are_presumed():
    states = team()
    assert states.unstated == ['scout_1', 'scout_2']
    states.take('scout_1', state(replace(GRID, width=13)))
    assert states.unstated == ['scout_2']
    assert states.foreign == {'scout_1': 'parameter grid.width is 13 there and 12 here'}
    states.take('scout_1', state())
    assert not states.foreign
    assert AgentStates({'scout_1': GRID}, {'presume_departure': True}).unstated == []


def test_a_reason_is_withdrawn_only_by_a_ready_agent():
    states = team()
    assert not states.take('scout_1', state())
    assert not states.take('scout_1', state(reason='the goal was rejected'))
    assert states.reasons() == 'scout_1 says: the goal was rejected'
    assert not states.take('scout_1', state(reason='a pose', readiness=Readiness.WAITING))
    assert states.reasons() == 'scout_1 waits for a pose'
    assert not states.take('scout_1', state(readiness=Readiness.OUT))
    assert not states.take('scout_1', state(reason='the goal was rejected'))
    assert states.take('scout_1', state())
    assert states.reasons() == ''


# Of a robot that is away from its base without its journal.
LOST = {'readiness': Readiness.NO_JOURNAL, 'reason': 'the journal is gone'}


@for_each(
    'said, departed, why',
    [
        ({'readiness': Readiness.OUT}, 5, 'its robot stands at its base'),
        ({'reason': 'no TF'}, 4, 'its robot stands at its base (no TF)'),
        ({'is_at_base': False}, 4, ''),
        ({}, 6, ''),
        (
            {'grid': Grid(13, 8), 'is_at_base': False},
            9,
            'a loss in another field is no evidence: parameter grid.width is 13 there and 12 here',
        ),
        ({**LOST, 'is_at_base': False}, 5, 'the journal is gone'),
        ({**LOST, 'is_at_base': False}, 6, ''),
    ],
)
def test_only_a_state_after_the_departure_says_that_a_robot_is_not_lost(said, departed, why):
    states = team()
    assert states.why_not_lost('scout_1', departed) == ''
    states.take('scout_1', state(**said))
    assert states.why_not_lost('scout_1', departed) == why


def test_only_the_operator_gives_up_a_robot_without_a_journal_or_in_another_field():
    states = team()
    assert not states.is_left_to_operator('scout_1')
    for said, is_left in (
        ({**LOST, 'is_at_base': False}, True),
        ({}, False),
        ({'grid': Grid(13, 8)}, True),
    ):
        states.take('scout_1', state(**said))
        assert states.is_left_to_operator('scout_1') == is_left
    assert not states.is_left_to_operator('scout_2')


def test_another_journal_than_at_the_departure_is_named():
    states = team()
    departed = 10
    states.take('scout_1', state(journal='a', stamp=5))
    # The journal of the last mission was set aside before the departure.
    states.take('scout_1', state(journal='b', stamp=7))
    states.take('scout_1', state(journal='b', stamp=12, readiness=Readiness.OUT))
    assert states.why_not_lost('scout_1', departed) == 'its robot stands at its base'
    states.take('scout_1', state(journal='c', stamp=15, is_at_base=False))
    assert states.why_not_lost('scout_1', departed) == ''
    states.take('scout_1', state(journal='c', stamp=20))
    assert states.why_not_lost('scout_1', departed) == (
        'its robot stands at its base, with another journal than at the departure: give it up if '
        'it was replaced'
    )
