# SPDX-License-Identifier: Apache-2.0
"""Stamps, frames, names and hashes of messages."""

from copy import deepcopy

from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, TargetReading
from kbnitp_ros.core import Grid
from kbnitp_ros.log.schema import describe, ENCODING
from kbnitp_ros.messages.deployments import path_message
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
import pytest
from rclpy.serialization import deserialize_message, serialize_message

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
def test_what_is_no_time_that_others_can_follow_is_refused(stamp, told):
    for read in (read_stamp, read_name):
        with pytest.raises(ValueError, match=told):
            read('stamp', stamp)


# What any one message may say leaves room for all names that a mission will ever need.
@given(st.integers(0, LAST), st.lists(st.integers(0, LAST), max_size=3))
def test_names_can_always_be_counted_on(time, names):
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


# The hash of a message is one of what it says: the same by every decoder, of any padding.


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
    """Return a message as a log's reader decodes it, with no ROS package."""
    package = type(message).__module__.partition('.')[0]
    type_name = f'{package}/msg/{type(message).__name__}'
    definition = describe(type_name).definition.encode()
    schema = Schema(id=1, name=type_name, encoding=ENCODING, data=definition)
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
    # Two bytes after each reading but the last one align the cell of the next.
    cell, detected = (1).to_bytes(4, 'little'), b'\1\0'
    start = data.index(cell + detected, len(data) - 40) + len(cell + detected)
    end = start + 2
    data[start:end] = b'\xaa\xbb'
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


def test_it_is_the_same_for_ever():
    """Logs hold these values."""
    assert content_hash(PATH) == 16047722710692970341
    assert content_hash(REPORT.readings[0]) == 9597802225463275365
