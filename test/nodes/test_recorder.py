# SPDX-License-Identifier: Apache-2.0
"""The recorder writes down everything its mission publishes, and ends well when it cannot."""

from __future__ import annotations

from collections import Counter
import resource
import shutil

from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.log.reader import is_finished, read_log
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.recorder import message_class
from mcap.reader import make_reader
from nav_msgs.msg import Path
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from samples import lost, path
from std_msgs.msg import String, UInt32
import yaml

BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LAST_OF_FIVE = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def record(field, namespace='/m'):
    """Start a recorder, and return the file it writes."""
    log = field.folder / 'record' / 'mission.mcap'
    log.parent.mkdir()
    field.start('recorder', {'file': str(log)}, namespace)
    name = f'{namespace.rstrip("/")}/recorder'
    field.until(lambda: field.diagnosed(name).values, f'diagnostics of {name}')
    return log


def recorded(log):
    """Return the messages of a log by topic."""
    messages = {}
    for logged in read_log(log):
        messages.setdefault(logged.topic, []).append(logged.message)
    return messages


def test_no_message_is_lost_whatever_the_publisher_offers(field):
    log = record(field)
    latched = field.node.create_publisher(String, '/m/latched', LAST_OF_FIVE)
    for number in range(9):
        latched.publish(String(data=str(number)))
    burst = field.talk(UInt32, '/m/burst', QoSProfile(depth=2000))
    unreliable = field.talk(UInt32, '/m/unreliable', BEST_EFFORT)
    for number in range(2000):
        burst.publish(UInt32(data=number))
    unreliable.publish(UInt32(data=7))
    field.until(lambda: field.count('/m/recorder', 'accepted') > 2006, 'last message')
    field.processes.stop()
    messages = recorded(log)
    assert [message.data for message in messages['/m/burst']] == list(range(2000))
    assert [message.data for message in messages['/m/unreliable']] == [7]
    assert [message.data for message in messages['/m/latched']] == list('45678')


def test_only_the_mission_and_what_all_share_is_recorded(field):
    log = record(field)
    topics = ('/m/deep/er', '/tf', '/tf_static', '/clock', '/mm/other', '/other')
    for topic in topics:
        field.node.create_publisher(String, topic, qos.LATCHED).publish(String())
    field.until(lambda: field.count('/m/recorder', 'accepted') > 4, 'messages')
    field.processes.stop()
    assert set(recorded(log)) == {*topics[:4], '/m/diagnostics'}


def test_without_a_namespace_everything_but_the_logs_of_ros_is_recorded(field):
    log = record(field, '/')
    field.node.create_publisher(String, '/a/topic', qos.LATCHED).publish(String())
    field.node.get_logger().info('for /rosout')
    field.until(lambda: field.count('/recorder', 'accepted') > 1, 'messages')
    field.processes.stop()
    assert set(recorded(log)) == {'/a/topic', '/diagnostics'}


def test_a_reported_deployment_is_readable_at_once(field):
    log = record(field)
    paths = field.talk(Path, '/m/scout_1/path')
    reports = field.talk(DeploymentReport, '/m/scout_1/report')
    for number in range(5):
        paths.publish(path(number))
        reports.publish(lost(number))
        field.until(lambda n=number: len(recorded(log).get('/m/scout_1/report', ())) > n, 'report')
        assert not is_finished(log)


def test_the_log_names_the_quality_of_service_offered(field):
    log = record(field)
    publisher = field.talk(String, '/m/latched', LAST_OF_FIVE)
    publisher.publish(String(data='x'))
    field.until(lambda: field.count('/m/recorder', 'accepted') > 1, 'message')
    field.processes.stop()
    with log.open('rb') as file:
        channels = make_reader(file).get_summary().channels.values()
    (metadata,) = [channel.metadata for channel in channels if channel.topic == '/m/latched']
    (offered,) = yaml.safe_load(metadata['offered_qos_profiles'])
    assert offered['reliability'] == 'reliable'
    assert offered['durability'] == 'transient_local'


def test_a_file_that_is_there_is_left_alone(field):
    log = field.folder / 'mission.mcap'
    log.write_text('precious')
    recorder = field.start('recorder', {'file': str(log)})
    assert recorder.wait(timeout=10) == 2
    assert 'File exists' in field.said('/recorder')
    assert log.read_text() == 'precious'


@pytest.mark.parametrize('trouble', ['folder gone', 'disk full'])
def test_a_recorder_that_cannot_write_ends_and_says_why(field, trouble):
    log = record(field)
    reports = field.talk(DeploymentReport, '/m/scout_1/report')
    reports.publish(lost(0))
    field.until(lambda: field.count('/m/recorder', 'accepted') > 1, 'report')
    recorder = field.processes.started['/m/recorder']
    if trouble == 'folder gone':
        shutil.rmtree(log.parent)
        told = f'{log} is gone'
    else:
        size = log.stat().st_size + 2000
        resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (size, size))
        told = 'File too large'
        for number in range(1, 100):
            reports.publish(lost(number))
    assert recorder.wait(timeout=10) == 1
    (complaint,) = field.said('/m/recorder').splitlines()
    assert complaint.startswith('recorder: ')
    assert told in complaint
    if trouble == 'disk full':
        assert Counter(logged.topic for logged in read_log(log))['/m/scout_1/report'] > 1


def test_message_types_are_found_by_name():
    assert message_class('nav_msgs/msg/Path') is Path
    for unknown in ('nav_msgs/msg/Nothing', 'nothing_msgs/msg/Path', 'Path'):
        with pytest.raises(LookupError, match=unknown):
            message_class(unknown)
