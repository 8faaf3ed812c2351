# SPDX-License-Identifier: Apache-2.0
"""The file is read by the tools that its users have: all of it, field by field."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose
from kbnitp_ros.log.schema import describe
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mission_log import mission, QOS, record, same, START
import pytest
from rclpy.qos import QoSProfile
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker
import yaml


@pytest.fixture(scope='module')
def sent():
    """Return a mission's messages, with those that are only for people."""
    whole = mission(robots=5)
    whole.publish(
        'scout_1/readings',
        Marker(
            ns='readings',
            type=Marker.SPHERE_LIST,
            pose=Pose(position=Point(x=0.5)),
            points=[Point(x=1.5, y=2.5), Point(z=-0.1)],
            colors=[ColorRGBA(r=0.25, a=1.0), ColorRGBA(g=0.125)],
            text='ünïcode',
        ),
    )
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN, name='estimator', values=[KeyValue(key='held', value='5')]
    )
    whole.publish('diagnostics', DiagnosticArray(status=[status, DiagnosticStatus()]))
    return whole.sent


@pytest.fixture(scope='module')
def path(sent, tmp_path_factory):
    """Return a finished log of them."""
    return record(tmp_path_factory.mktemp('log') / 'mission.mcap', sent)


def test_same_can_tell(sent):
    """The comparison that these tests rest on finds a difference."""
    reports = [each.message for each in sent if each.topic.endswith('report')]
    assert same(reports[0], reports[0])
    assert not same(reports[0], reports[1])


def test_mcap_ros2_support_reads_everything(path, sent):
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        read = list(reader.iter_decoded_messages())
    assert len(read) == len(sent)
    for one, original in zip(read, sent):
        assert one.channel.topic == original.topic
        assert one.schema.name == original.type_name
        assert (one.message.publish_time, one.message.log_time) == (
            original.time,
            original.time + 500,
        )
        assert one.message.data == original.data
        assert same(one.decoded_message, original.message)


def read_by_rosbags(path):
    """Yield (topic, type, time, message) of all messages, decoded by what is in the file alone."""
    with Reader(path) as reader:
        store = get_typestore(Stores.EMPTY)
        for connection in reader.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, time, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            yield connection.topic, connection.msgtype, time, message


def test_rosbags_reads_everything(path, sent):
    read = list(read_by_rosbags(path))
    assert len(read) == len(sent)
    for (topic, type_name, time, message), original in zip(read, sent):
        assert (topic, type_name, time) == (
            original.topic,
            original.type_name,
            original.time + 500,
        )
        assert same(message, original.message)


def test_rosbags_reads_it_as_a_bag_too(path, sent, tmp_path):
    """What the file says of itself makes a folder with it a bag."""
    with path.open('rb') as file:
        records = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    description = yaml.safe_load(records['rosbag2']['serialized_metadata'])
    (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / 'metadata.yaml').write_text(
        yaml.safe_dump({'rosbag2_bagfile_information': description})
    )
    read = list(read_by_rosbags(tmp_path))
    assert len(read) == len(sent)
    assert all(same(message, original.message) for (*_, message), original in zip(read, sent))
    with Reader(tmp_path) as reader:
        assert reader.message_count == len(sent)
        assert reader.start_time == sent[0].time + 500
        assert reader.end_time == sent[-1].time + 500 + 1
        assert reader.ros_distro == 'jazzy'
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    assert counts == {
        topic: sum(each.topic == topic for each in sent) for topic in {each.topic for each in sent}
    }


def test_rosbags_reads_the_qos_back(path):
    expected = Qos(
        QosHistory.KEEP_LAST,
        7,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        QosTime(0, 0),
        QosTime(0, 0),
        QosLiveliness.SYSTEM_DEFAULT,
        QosTime(0, 0),
        False,
    )
    with Reader(path) as reader:
        for connection in reader.connections:
            assert connection.ext.offered_qos_profiles == [expected]
            assert connection.ext.serialization_format == 'cdr'


def test_each_topic_keeps_its_own_qos(tmp_path, sent):
    path = record(tmp_path / 'mission.mcap', sent[:1], QoSProfile(depth=3))
    with Reader(path) as reader:
        (qos,) = reader.connections[0].ext.offered_qos_profiles
    assert (qos.depth, qos.durability) == (3, QosDurability.VOLATILE)
    assert QOS.depth != 3


def test_the_type_hash_is_read_back(path, sent):
    with path.open('rb') as file:
        summary = make_reader(file).get_summary()
    assert {channel.topic for channel in summary.channels.values()} == {
        each.topic for each in sent
    }
    for channel in summary.channels.values():
        type_name = summary.schemas[channel.schema_id].name
        assert channel.metadata['topic_type_hash'] == describe(type_name).type_hash
        assert channel.metadata['topic_type_hash'].startswith('RIHS01_')


def test_the_file_is_indexed(path, sent):
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


def test_one_schema_for_all_topics_of_a_type(path):
    with path.open('rb') as file:
        names = [schema.name for schema in make_reader(file).get_summary().schemas.values()]
    assert len(set(names)) == len(names)


def test_messages_are_numbered_by_topic(path, sent):
    with path.open('rb') as file:
        numbers = [
            message.sequence
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic == '/belief'
        ]
    assert numbers == list(range(1, sum(each.topic == '/belief' for each in sent) + 1))
