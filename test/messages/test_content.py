# SPDX-License-Identifier: Apache-2.0
"""The hash of a message is one of what it says: the same by every decoder, of any padding."""

from copy import deepcopy

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, TargetReading
from kbnitp_ros.core import Grid
from kbnitp_ros.log.schema import describe, ENCODING
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.headers import content_hash
from laws import for_each
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import MapMetaData, Path
from rclpy.serialization import deserialize_message, serialize_message

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
