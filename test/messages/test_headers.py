# SPDX-License-Identifier: Apache-2.0
"""Stamps, frames, names, hashes and grids of messages."""

from array import array
from copy import deepcopy
from math import nan, pi

from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, TargetReading
from kbnitp_ros.core import Grid
from kbnitp_ros.log.schema import describe
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.grids import (
    occupancy_grid,
    read_map_metadata,
    read_occupancy_grid,
    rounded_yaw,
)
from kbnitp_ros.messages.headers import (
    check_frame,
    content_hash,
    from_stamp,
    header,
    LAST_COUNTED_ON,
    next_name,
    read_name,
    read_stamp,
    shown,
    to_stamp,
)
from laws import for_each
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import MapMetaData, Path
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from samples import over_the_wire

LAST = 2**31 * 10**9 - 1


def test_a_stamp_is_seconds_and_the_rest():
    assert to_stamp(12_000_000_345) == Time(sec=12, nanosec=345)
    assert from_stamp(Time(sec=12, nanosec=345)) == 12_000_000_345


@given(st.integers(-(2**31) * 10**9, LAST))
def test_every_nanosecond_comes_back(nanoseconds):
    assert from_stamp(to_stamp(nanoseconds)) == nanoseconds


@for_each('nanoseconds', [LAST + 1, -(2**31) * 10**9 - 1])
def test_a_time_beyond_int32_seconds_is_refused(nanoseconds):
    with pytest.raises(ValueError, match=rf'stamp is {nanoseconds} ns.*int32'):
        to_stamp(nanoseconds)


def test_a_header_names_the_map_without_a_slash():
    assert header(7).frame_id == 'map'
    assert header(7).stamp == Time(nanosec=7)
    check_frame('header.frame_id', header(7).frame_id)


@for_each('frame_id', ['', '/map', 'odom', 'Map'])
def test_another_frame_is_refused(frame_id):
    with pytest.raises(ValueError, match=f"poses.* is '{frame_id}': it must be 'map'"):
        check_frame('poses[2].header.frame_id', frame_id)


@for_each('stamp, told', [
    (Time(sec=2**31 - 1, nanosec=999_999_999), '2147483647.999999999 s: it must be from 0'),
    (Time(sec=-5), 'stamp is -5.000000000 s'),
    (Time(nanosec=10**9), 'nanosec is 1000000000: it must be below'),
])  # fmt: skip
def test_times_that_no_later_time_can_follow_are_refused(stamp, told):
    for read in (read_stamp, read_name):
        with pytest.raises(ValueError, match=told):
            read('stamp', stamp)


# One message is limited so that there is always room for names.
@given(st.integers(0, LAST), st.lists(st.integers(0, LAST), max_size=3))
def test_names_always_have_room(time, names):
    def read(function, nanoseconds):
        try:
            return function('stamp', to_stamp(nanoseconds))
        except ValueError:
            return 0

    time, names = read(read_stamp, time), [read(read_name, name) for name in names]
    first = next_name(time, *names)
    assert first >= time
    assert all(first > name for name in names if name <= LAST_COUNTED_ON)
    for number in range(first, first + 10**12, 10**11):
        assert next_name(time, *names, number) == number + 1
        assert read_name('stamp', to_stamp(number + 1)) == number + 1


def test_a_long_text_is_cut():
    assert shown('odom') == "'odom'"
    assert len(shown('x' * 50_000_000)) < 150


PATH = path_message(Grid(3, 1), [0, 1, 0], stamp=2_000_000_001, mission=1_500_000_000)
REPORT = DeploymentReport(
    agent='scout',
    survived=True,
    readings=[TargetReading(cell=1, detected=True), TargetReading(cell=0, not_looked=True)],
)
BELIEF = BeliefMaps(
    info=MapMetaData(resolution=0.5), blocked=[3, 1], joint=[0.25, -0.0], seed=2**64 - 1
)
MESSAGES = [PATH, REPORT, BELIEF]


def from_log(message: object, data: bytes) -> object:
    """Return a message decoded by the log's reader, without packages of ROS."""
    package = type(message).__module__.partition('.')[0]
    type_name = f'{package}/msg/{type(message).__name__}'
    definition = describe(type_name)[0].encode()
    schema = Schema(id=1, name=type_name, encoding='ros2msg', data=definition)
    decode = DecoderFactory().decoder_for('cdr', schema)
    assert decode is not None
    return decode(data)


@for_each('message', MESSAGES)
def test_all_decoders_agree(message):
    data = serialize_message(message)
    received = deserialize_message(data, type(message))
    assert content_hash(message) == content_hash(received) == content_hash(from_log(message, data))


def test_padding_does_not_count():
    data = bytearray(serialize_message(REPORT))
    # A byte of padding after each reading but the last aligns the next cell.
    cell, detected = (1).to_bytes(4, 'little'), b'\1\0\0'
    start = data.index(cell + detected, len(data) - 60) + len(cell + detected)
    data[start] = 0xAA
    assert bytes(data) != serialize_message(REPORT)
    other = deserialize_message(bytes(data), DeploymentReport)
    assert content_hash(other) == content_hash(REPORT)
    assert content_hash(from_log(REPORT, bytes(data))) == content_hash(REPORT)


def test_every_pose_and_time_counts():
    others = [deepcopy(PATH) for _ in range(4)]
    others[0].poses[1].pose.position.x += 1e-9
    others[1].poses[2].header.stamp.nanosec += 1
    others[2].header.frame_id = 'mep'
    del others[3].poses[1]
    assert len({content_hash(each) for each in (PATH, *others)}) == 5


def test_the_same_values_in_other_fields_have_another_hash():
    assert content_hash(Path()) != content_hash(BeliefMaps())
    late = DeploymentReport(survived=False, steps_survived=1)
    soon = DeploymentReport(survived=True, steps_survived=0)
    assert content_hash(late) != content_hash(soon)


def test_the_hash_never_changes():
    """Logs contain these hashes."""
    assert content_hash(PATH) == 16047722710692970341
    assert content_hash(REPORT.readings[0]) == 9739610897843229253


@st.composite
def grids(draw):
    width, height = draw(st.integers(1, 12)), draw(st.integers(1, 12))
    base = draw(st.integers(0, width * height - 1))
    blocked = draw(st.sets(st.integers(0, width * height - 1), max_size=5)) - {base}
    return Grid(
        width,
        height,
        base,
        resolution=draw(st.sampled_from([0.05, 0.1, 0.3, 0.7, 1.0, 2.5, 1 / 3, 12.3])),
        origin=(draw(st.floats(-1e6, 1e6)), draw(st.floats(-1e6, 1e6))),
        blocked=blocked,
        yaw=rounded_yaw(draw(st.floats(-10.0, 10.0) | st.sampled_from([pi, -pi, pi / 2, 0.0]))),
    )


def test_rows_go_up_from_the_origin():
    grid = Grid(3, 2, resolution=0.5, origin=(10.0, 20.0), blocked=(4,))
    message = occupancy_grid(grid, [0.0, 0.1, 0.2, 0.3, 0.4, 1.0], stamp=5_000_000_006)

    assert list(message.data) == [0, 10, 20, 30, -1, 100]
    assert (message.info.width, message.info.height, message.info.resolution) == (3, 2, 0.5)
    origin = message.info.origin
    assert (origin.position.x, origin.position.y, origin.position.z) == (10.0, 20.0, 0.0)
    orientation = origin.orientation
    assert (orientation.x, orientation.y, orientation.z, orientation.w) == (0.0, 0.0, 0.0, 1.0)
    assert message.header.frame_id == 'map'
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 6)


def map_metadata(grid):
    return occupancy_grid(grid, np.zeros(grid.cells), 0).info


@given(grids())
def test_a_value_is_shown_where_its_cell_lies(grid):
    """A viewer draws value i of the data at (column, row) times the resolution from the origin."""
    info = over_the_wire(map_metadata(grid))
    row, column = np.divmod(np.arange(grid.cells), info.width)
    turn = info.origin.orientation
    along = complex(turn.w, turn.z) ** 2 * (column + 0.5 + 1j * (row + 0.5)) * info.resolution
    at = complex(info.origin.position.x, info.origin.position.y) + along
    assert grid.cells_at(np.stack([at.real, at.imag], axis=1)).tolist() == list(range(grid.cells))


@given(grids(), st.integers(0, 2**32 - 1))
def test_probabilities_come_back_to_half_a_percent(grid, seed):
    probabilities = np.random.default_rng(seed).random(grid.cells)
    shown = read_occupancy_grid(over_the_wire(occupancy_grid(grid, probabilities, stamp=0)))
    assert (np.isnan(shown) == ~grid.free).all()
    assert np.abs(shown - probabilities)[grid.free].max() <= 0.005 + 1e-12


@given(grids())
def test_a_grid_comes_back(grid):
    told = over_the_wire(map_metadata(grid))
    same = read_map_metadata(told, base=grid.base, blocked=grid.blocked)
    assert (same.width, same.height, same.base, same.blocked, same.origin, same.yaw) == (
        grid.width,
        grid.height,
        grid.base,
        grid.blocked,
        grid.origin,
        grid.yaw,
    )
    assert same.resolution == pytest.approx(grid.resolution, rel=1e-7)


@given(st.floats(-1e3, 1e3))
def test_an_angle_is_kept_to_a_relative_1e_12(yaw):
    told = rounded_yaw(yaw)
    assert -pi < told < pi + 1e-11
    assert abs(np.exp(1j * told) - np.exp(1j * yaw)) < 1e-11
    assert rounded_yaw(told) == told


def test_an_unset_orientation_is_no_turn():
    info = MapMetaData(resolution=1.0, width=1, height=1)
    info.origin.orientation.w = 0.0
    assert read_map_metadata(info) == Grid(1, 1)


@for_each('resolution', [0.05, 0.1, 0.3, 1.0, 2.5, 0.0254])
def test_a_decimal_resolution_comes_back_exactly(resolution):
    info = over_the_wire(map_metadata(Grid(2, 2, resolution=resolution)))
    assert info.resolution != resolution or resolution in (1.0, 2.5)
    assert read_map_metadata(info).resolution == resolution


def readable():
    """Return a readable map of 2 x 2 cells."""
    return occupancy_grid(Grid(2, 2), [0.0, 0.2, 0.4, 0.6], stamp=0)


def spoil(message, field, value):
    """Set a field that is named with dots."""
    *parents, last = field.split('.')
    for name in parents:
        message = getattr(message, name)
    setattr(message, last, value)


@for_each('field, value, error', [
    ('header.frame_id', '', "header.frame_id is '': it must name the frame"),
    ('info.resolution', nan, 'info.resolution is nan: it must be finite'),
    ('info.resolution', 0.0, 'resolution is 0.0: it must be positive'),
    ('info.origin.position.x', nan, 'info.origin.position.x is nan: it must be finite'),
    ('info.origin.orientation.z', 0.7, 'info.origin.orientation has x, y, z, w = .* 0.7, 1.0'),
    ('info.origin.orientation.y', 0.1, 'info.origin.orientation.*a turn about the z axis'),
    ('info.width', 0, 'grid width is 0: it must be a whole number at least 1'),
    ('info.width', 3, r'data has 4 values: it must have width \* height = 3 \* 2 = 6'),
    ('data', array('b', [0, 0, 101, 0]), 'data of cell 2 is 101: it must be -1 or 0 to 100'),
    ('data', array('b'), 'data has 0 values'),
])  # fmt: skip
def test_a_bad_map_is_refused(field, value, error):
    message = readable()
    spoil(message, field, value)
    with pytest.raises(ValueError, match=error):
        read_occupancy_grid(message)
