# SPDX-License-Identifier: Apache-2.0
"""Tools of users read the whole log, field by field."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose
from kbnitp_ros.log.files import log_parts
from kbnitp_ros.log.read import read_log, read_recorded
from kbnitp_ros.log.schema import qos_profiles_yaml
from kbnitp_ros.log.write import LogWriter
from laws import for_each
from mcap.reader import make_reader
from mission_log import mission, record, record_to, START
from other_readers import check_all_read, check_same, with_mcap, with_node, with_rosbags
import pytest
from rclpy.qos import QoSProfile
from rosbags.rosbag2 import Reader
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker
import yaml


@pytest.fixture(scope='module')
def sent():
    """Return a mission's messages, including views for people."""
    whole = mission(robots=5)
    whole.publish(
        'scout_1/readings',
        Marker(
            ns='readings',
            type=Marker.SPHERE_LIST,
            pose=Pose(position=Point(x=0.5, y=-0.0, z=float('nan'))),
            points=[Point(x=1.5, y=2.5), Point(z=float('inf'))],
            colors=[ColorRGBA(r=0.25, a=1.0), ColorRGBA(g=0.1)],
            text='ünïcode',
        ),
    )
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN, name='estimator', values=[KeyValue(key='held', value='5')]
    )
    whole.publish('diagnostics', DiagnosticArray(status=[status, DiagnosticStatus()]))
    return whole.sent


def check(log, sent):
    assert [message.data for message in read_log(log)] == [each.data for each in sent]
    check_all_read(log)


@pytest.mark.processes
@for_each('library', [with_mcap, with_node, with_rosbags])
def test_the_comparison_can_fail(sent, library, tmp_path):
    """A missing or changed message or QoS is found."""
    path = tmp_path / 'mission.mcap'
    record(path, sent)
    read = list(library(path))
    written = list(read_recorded(path))
    check_same(read, written)
    changed = read[0]._replace(message=read[1].message)
    for wrong in (read[1:], [changed, *read[1:]], [read[0]._replace(qos=[]), *read[1:]]):
        with pytest.raises((AssertionError, AttributeError)):
            check_same(wrong, written)


def finished(path, sent, *, synced=False):
    with LogWriter(path) as log:
        record_to(log, sent, synced=synced)
    return sent


def gone_on_with(path, sent):
    finished(path, sent[:20])
    with LogWriter(path, resume=True) as log:
        record_to(log, sent[20:])
    return sent


def with_other_qos(path, sent):
    """Write a topic with several QoS, within one file and across files."""
    with LogWriter(path) as log:
        for depth, each in enumerate(sent[:1] * 3, 1):
            log.add_topic(
                each.topic, each.type_name, qos_profiles_yaml([QoSProfile(depth=depth % 2 + 1)])
            )
            log.write(each.topic, each.data, each.time + depth, each.time)
    with LogWriter(path, resume=True) as log:
        record_to(log, sent)
    return [*sent[:1] * 3, *sent]


@pytest.mark.processes
@for_each('write', [
    finished, partial(finished, synced=True), lambda path, _: finished(path, []), gone_on_with,
    with_other_qos,
], every=3)  # fmt: skip
def test_all_libraries_read_a_log(sent, tmp_path, write):
    path = tmp_path / 'mission.mcap'
    check(path, write(path, sent))


def test_the_metadata_describes_the_bag(sent, tmp_path):
    path = tmp_path / 'mission.mcap'
    gone_on_with(path, sent)
    with Reader(path.parent) as reader:
        assert reader.message_count == len(sent)
        assert reader.start_time == sent[0].time + 500
        assert reader.end_time == sent[-1].time + 500 + 1
        assert reader.ros_distro == 'jazzy'
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
        files = [(file['path'], file['message_count']) for file in reader.storage.files]
    assert counts == {
        topic: sum(each.topic == topic for each in sent) for topic in {each.topic for each in sent}
    }
    assert [name for name, _ in files] == [part.name for part in log_parts(path)]
    assert sum(messages for _, messages in files) == len(sent)


def test_each_file_describes_its_content(sent, tmp_path):
    """The record that ros2 bag info reads from a single file."""
    path = tmp_path / 'mission.mcap'
    gone_on_with(path, sent)
    for part in log_parts(path):
        with part.open('rb') as file:
            reader = make_reader(file)
            count = reader.get_summary().statistics.message_count
            records = {record.name: record.metadata for record in reader.iter_metadata()}
        described = yaml.safe_load(records['rosbag2']['serialized_metadata'])
        assert described['relative_file_paths'] == [part.name]
        assert described['message_count'] == count
        assert described['version'] == 9


def test_the_file_is_indexed(sent, tmp_path):
    path = tmp_path / 'mission.mcap'
    record(path, sent)
    with path.open('rb') as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        last = list(reader.iter_messages(starting_at=sent[-1].time + 500))
    assert summary.statistics.message_count == len(sent)
    assert summary.statistics.message_start_time == sent[0].time + 500 > START
    assert summary.statistics.message_end_time == sent[-1].time + 500
    assert summary.chunk_indexes
    assert all(index.message_index_length for index in summary.chunk_indexes)
    assert [index.name for index in summary.metadata_indexes] == ['rosbag2']
    assert len(last) == 1


def test_one_schema_for_all_topics_of_a_type(sent, tmp_path):
    path = tmp_path / 'mission.mcap'
    record(path, sent)
    with path.open('rb') as file:
        names = [schema.name for schema in make_reader(file).get_summary().schemas.values()]
    assert len(set(names)) == len(names)


def test_messages_are_numbered_by_topic(sent, tmp_path):
    path = tmp_path / 'mission.mcap'
    record(path, sent)
    numbers = [message.sequence for message in with_mcap(path) if message.topic == '/belief']
    assert numbers == list(range(1, sum(each.topic == '/belief' for each in sent) + 1))
