# SPDX-License-Identifier: Apache-2.0
"""Each check before the first departure is red for one reason alone, and names the remedy."""

from dataclasses import replace
from math import nan

from kbnitp_ros.base.preflight import disk_check, Heard, Light, OPTIONAL, robot_checks
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.health import Health
from kbnitp_ros.messages.states import read_state, Readiness, state_message
from laws import for_each

GRID = Grid(5, 5, resolution=0.8)
BASE = read_state(state_message(GRID, '', Readiness.READY, '', False, 1), '')
WELL = Heard(
    read_state(state_message(GRID, 'a', Readiness.READY, '', True, 1, 'journal'), 'a'),
    Health(1, '2.0.0', battery=0.9, x=0.4, y=0.4, pose_age=0.1, deviation=0.2),
)


def lights(heard, light, needed=0.3):
    checks = robot_checks('a', heard, BASE, '2.0.0', needed)
    return {each.name: each for each in checks if each.light is light}


def changed(state=(), health=(), **changes):
    return WELL._replace(
        state=replace(WELL.state, **dict(state)),
        health=replace(WELL.health, **dict(health)),
        **changes,
    )


def test_a_robot_that_is_well_is_green():
    assert [*lights(WELL, Light.GREEN)] == [
        'heard', 'version', 'field', 'at its base', 'journal', 'clock', 'pose', 'action server',
        'battery',
    ]  # fmt: skip
    # The others are mandatory: without these no report of the robot would count.
    optional = {'clock', 'pose', 'action server', 'battery', 'disk', 'parameters'}
    assert {*OPTIONAL} == optional


NO_JOURNAL = {'readiness': Readiness.NO_JOURNAL, 'reason': 'bring the robot to its base'}


@for_each('heard, name, words', [
    (Heard(), 'heard', 'nothing on a/state: start its node'),
    (WELL._replace(health=None), 'version', 'not known: install 2.0.0'),
    (changed(health={'version': '1.9.0'}), 'version', '1.9.0: install 2.0.0'),
    (changed(state={'field_id': '0' * 16}), 'field', f'that of the base is {GRID.id}'),
    (changed(state={'is_at_base': False}), 'at its base', 'bring it to its base'),
    (changed(health={'journal': False}), 'journal', 'make room on its disk'),
    (changed(state=NO_JOURNAL), 'journal', 'bring the robot to its base'),
    (changed(offset=-1.1), 'clock', '-1.1 s against the base'),
    (changed(health={'pose_age': nan}), 'pose', 'start its localization'),
    (changed(health={'pose_age': 2.5}), 'pose', '2.5 s old: at most 2.0 s'),
    (changed(health={'deviation': 0.21}), 'pose', 'deviation 0.21 m: at most 0.20 m'),
    (changed(health={'server': False}), 'action server', 'takes no goals: start Nav2'),
    (changed(health={'battery': 0.18}), 'battery', '18 %: 30 % needed'),
    (changed(health={'battery': nan}), 'battery', 'not known: 30 % needed'),
])  # fmt: skip
def test_a_robot_is_red_for_one_reason_with_the_remedy(heard, name, words):
    red = lights(heard, Light.RED)
    assert [*red] == [name]
    assert words in red[name].text


@for_each('heard, needed, name', [
    (changed(health={'battery': nan}), 0.0, 'battery'),
    (changed(state={'journal': ''}, health={'pose_age': nan}), 0.3, 'pose'),
])  # fmt: skip
def test_what_need_not_be_known_is_for_information(heard, needed, name):
    assert {*lights(heard, Light.INFO, needed)} == {'round trip', name}
    assert not lights(heard, Light.RED, needed)


@for_each('seconds, text', [(nan, 'not known'), (0.0123, '12 ms'), (1.5, '1500 ms')])
def test_a_round_trip_is_for_information(seconds, text):
    info = lights(WELL._replace(round_trip=seconds), Light.INFO)
    assert info['round trip'].text == f'{text} for a service call'


@for_each('deviation, offset', [(nan, 0.0), (0.2, 1.0), (0.1, -1.0)])
def test_a_robot_within_the_limits_is_green(deviation, offset):
    heard = changed(health={'deviation': deviation}, offset=offset)
    assert not lights(heard, Light.RED)


@for_each('free, light', [
    (None, Light.INFO), (10**9, Light.GREEN), (10**9 - 1, Light.RED),
])  # fmt: skip
def test_a_log_needs_room(free, light):
    assert disk_check('/x/mission.mcap', free).light is light
