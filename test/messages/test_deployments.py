# SPDX-License-Identifier: Apache-2.0
"""Paths, reports and actions are read from their messages, and bad ones are refused."""

from functools import partial
from math import nan

from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    Report,
    SensorModel,
)
from kbnitp_ros.messages.beliefs import belief_maps, read_belief_maps
from kbnitp_ros.messages.deployments import (
    OrderState,
    path_message,
    read_path,
    read_report,
    read_status,
    report_message,
    status_message,
)
from kbnitp_ros.messages.headers import LAST_NAME
from kbnitp_ros.messages.operator_actions import (
    Action,
    operator_action_message,
    OperatorAction,
    read_operator_action,
)
from laws import for_each, spoilt
import numpy as np
import pytest
from rclpy._rclpy_pybind11 import RMWError
from rclpy.serialization import deserialize_message, serialize_message
from samples import changed, over_the_wire

GRID = Grid(4, 3, base=1, resolution=0.5, origin=(-1.0, 2.0))
PATH = [1, 6, 11, 6, 6, 1]
STAMP = 12_000_000_034
KEY = DeploymentKey('scout_2', 77)


def test_poses_are_the_centres_of_cells():
    message = path_message(GRID, PATH[:3], STAMP)
    positions = [pose.pose.position for pose in message.poses]
    assert [(p.x, p.y, p.z) for p in positions] == [
        (-0.25, 2.25, 0.0),
        (0.25, 2.75, 0.0),
        (0.75, 3.25, 0.0),
    ]
    for header in (message.header, *(pose.header for pose in message.poses)):
        assert header.frame_id == 'map'
        assert (header.stamp.sec, header.stamp.nanosec) == (12, 34)
    assert all(pose.pose.orientation.w == 1.0 for pose in message.poses)


@given(
    st.lists(st.integers(0, 11), min_size=1, max_size=40),
    st.integers(0, LAST_NAME),
    st.sampled_from([0.05, 0.1, 1 / 3, 1.0, 12.3]),
    st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)),
)
def test_a_path_comes_back(cells, stamp, resolution, origin):
    grid = Grid(4, 3, resolution=resolution, origin=origin)
    key, same = read_path(grid, 'scout_1', over_the_wire(path_message(grid, cells, stamp)))
    assert key == DeploymentKey('scout_1', stamp)
    assert same.tolist() == cells


def test_a_pose_stands_for_the_cell_it_lies_in():
    message = path_message(GRID, PATH, STAMP)
    for pose, (x, y) in zip(message.poses, np.random.default_rng(0).uniform(-0.24, 0.24, (6, 2))):
        pose.pose.position.x += x
        pose.pose.position.y += y
    assert read_path(GRID, 'scout_1', message)[1].tolist() == PATH


def set_position(x, y):
    def spoil(message):
        message.poses[3].pose.position.x = x
        message.poses[3].pose.position.y = y

    return spoil


def set_frame(of, frame_id):
    return lambda message: setattr(of(message).header, 'frame_id', frame_id)


@for_each('spoil, error', [
    (set_frame(lambda message: message, 'odom'), "^header.frame_id is 'odom'.*'map'"),
    (set_frame(lambda message: message, ''), "^header.frame_id is ''.*'map'"),
    (set_position(nan, 2.1), r'poses\[3\].pose.position is \(nan, 2.1\): it must be finite'),
    (set_position(1.01, 2.1), r'\(1.01, 2.1\) is outside the grid'),
    (set_position(1e300, 2.1), r'\(1e\+300, 2.1\) is outside the grid'),
    (lambda message: message.poses.clear(), 'poses is empty'),
    (set_frame(lambda path: path.poses[5], 'x'), r"poses\[5\].header.frame_id is 'x'.*'map'"),
])  # fmt: skip
def test_a_bad_path_is_refused(spoil, error):
    message = over_the_wire(path_message(GRID, PATH, STAMP))
    spoil(message)
    with pytest.raises(ValueError, match=error):
        read_path(GRID, 'scout_1', message)


def test_a_report_names_the_cell_of_every_step():
    readings = [True, False, False, True, True]
    message = report_message(KEY, Observation(PATH, True, readings), STAMP)
    assert message.survived
    assert [(r.cell, r.detected) for r in message.readings] == list(zip(PATH[1:], readings))
    assert (message.agent, message.deployment.sec, message.deployment.nanosec) == (
        'scout_2',
        0,
        77,
    )
    assert (message.header.stamp.sec, message.header.frame_id) == (12, 'map')
    lost = report_message(KEY, Observation(PATH, False), STAMP)
    assert not lost.survived
    assert list(lost.readings) == []
    assert read_report(lost)[1].stamp == STAMP


@given(
    st.lists(st.tuples(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, -1])), max_size=30),
    st.booleans(),
    st.integers(0, LAST_NAME),
    st.lists(st.floats(0.0, 1.0, exclude_min=True), min_size=10, max_size=10),
)
def test_a_report_comes_back(steps, survived, stamp, weights):
    key = DeploymentKey('scout_7', stamp)
    readings = [reading for _, reading in steps]
    path = [0, *(cell for cell, _ in steps[:-1]), 0]
    if not steps or not survived:
        lost_at = [0.0] * 29 + weights
        observation = Observation([0] * 40, False, None, len(steps), lost_at)
        where = () if observation.lost_at is None else tuple(observation.lost_at.tolist())
        said = Report(False, steps_survived=observation.steps_survived, lost_at=where)
    else:
        observation = Observation(path, True, readings)
        said = Report(True, tuple(zip(path[1:], readings)))
    assert read_report(over_the_wire(report_message(key, observation, 5))) == (key, said)


def whole_belief():
    estimator = Estimator(Belief.prior(GRID, 0.3, 0.4, 0.8), SensorModel(0.5))
    return belief_maps(Ledger(GRID, 6, estimator), 1)


READERS = [
    (whole_belief(), read_belief_maps),
    (path_message(GRID, PATH, STAMP), partial(read_path, GRID, 'scout_1')),
    (report_message(KEY, Observation(PATH, True, [True] * 5), STAMP), read_report),
    (status_message(KEY, OrderState.REFUSED, 6, 'why'), partial(read_status, agent='scout_2')),
]


@given(st.data())
def test_a_corrupt_message_is_read_or_refused_in_a_line(data):
    message, read = data.draw(st.sampled_from(READERS))
    try:
        heard = deserialize_message(data.draw(spoilt(serialize_message(message))), type(message))
    except (RMWError, UnicodeDecodeError):
        return
    try:
        read(heard)
        return
    except ValueError as error:
        said = str(error)
    assert '\n' not in said
    assert len(said) < 1000


def test_a_detection_without_a_look_is_refused():
    message = report_message(KEY, Observation(PATH, True, [True, True, -1, False, False]), STAMP)
    assert [each.not_looked for each in message.readings] == [False, False, True, False, False]
    assert read_report(message)[1].readings[2] == (PATH[3], -1)
    message.readings[2].detected = True
    with pytest.raises(ValueError, match=r'readings\[2\] has detected and not_looked'):
        read_report(message)


WITH_BASES = Grid(6, 5, base=0, other_bases=(29,))


def test_paths_from_each_base_are_refused_by_operators():
    paths = {DeploymentKey('near', 4): [0, 1, 0], DeploymentKey('far', 5): [29, 28, 29]}
    action = OperatorAction(7, Action.REFUSE, 3, {k: np.array(p) for k, p in paths.items()}, 0)
    seen = read_operator_action(WITH_BASES, operator_action_message(WITH_BASES, action))
    assert {key: path.tolist() for key, path in seen.paths.items()} == paths
    with pytest.raises(ValueError, match='start at the base 0, not at cell 29'):
        read_operator_action(Grid(6, 5), operator_action_message(WITH_BASES, action))


@for_each('fields, told', [
    ({'action': 0}, 'action is 0: it must be from 1 to 13'),
    ({'action': Action.REFUSE}, "agents is '': REFUSE must have agents"),
    ({'agents': ['scout_1']}, 'agents has 1 names for 0 paths'),
    ({'action': Action.TAKE_BACK}, "agents is '': TAKE_BACK must have agents"),
    ({'settled': [7]}, 'settled names 1 reports, and action is PAUSE: only GIVE_UP settles'),
    ({'parameters': ['robots: 3']}, 'parameters has 1 values, and action is PAUSE'),
    ({'action': Action.SET}, 'parameters has 0 values, and action is SET'),
    ({'cells': [3]}, 'cells has 1 cells, and action is PAUSE'),
    ({'action': Action.NO_GO}, 'cells has 0 cells, and action is NO_GO'),
    ({'action': Action.LIFT, 'cells': [30]}, 'cells has 30, off the map of 30 cells'),
    ({'action': Action.REACHED}, 'parameters has 0 values, and action is REACHED'),
    ({'action': Action.SET, 'parameters': ['robots']}, "'robots': it must be NAME: VALUE"),
    ({'action': Action.SET, 'parameters': ['a: 1', 'a: 2']}, "'a: 2': it must be NAME: VALUE"),
    ({'action': Action.SET, 'parameters': ['[']}, r"'\[': it must be YAML"),
])  # fmt: skip
def test_bad_actions_are_refused(fields, told):
    message = operator_action_message(WITH_BASES, OperatorAction(7, Action.PAUSE, 3, {}, 0))
    assert read_operator_action(WITH_BASES, message).action is Action.PAUSE
    with pytest.raises(ValueError, match=told):
        read_operator_action(WITH_BASES, changed(message, **fields))
