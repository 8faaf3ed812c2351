# SPDX-License-Identifier: Apache-2.0
"""The recorder writes all messages of its mission, and ends well when it cannot."""

from array import array
from collections import defaultdict
import os
import shutil
import signal

from disk import mounted
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.log.read import is_finished, read_log
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp, to_stamp
from kbnitp_ros.nodes.runtime import qos
from mcap.reader import make_reader
from nav_msgs.msg import Path
import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from samples import after_loss, key, lost, path, prior
from std_msgs.msg import Int32, String, UInt8MultiArray
import yaml

BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=100)
KEPT_BEST_EFFORT = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
LAST_OF_FIVE = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def record(field, namespace='/m', **parameters):
    log = field.folder / 'record' / 'mission.mcap'
    log.parent.mkdir(exist_ok=True)
    field.start('recorder', {'file': str(log), **parameters}, namespace)
    name = f'{namespace.rstrip("/")}/recorder'
    field.until(lambda: field.told(name, 'log'), f'log of {name}')
    return log


def state_mission(field):
    """Publish the prior of the mission without a time, to which these paths belong."""
    field.node.create_publisher(BeliefMaps, '/m/belief', qos.LATCHED).publish(prior())


def record_path(field):
    """Record a path; return the log, the recorder's confirmations, and the publisher."""
    log = record(field)
    state_mission(field)
    told = field.listen(Recorded, '/m/scout_1/recorded')
    paths = field.talk(Path, '/m/scout_1/path')
    paths.publish(path(1))
    field.until(lambda: told, 'word of path 1')
    return log, told, paths


def channels(log):
    with log.open('rb') as file:
        return make_reader(file).get_summary().channels.values()


def recorded(log):
    messages = defaultdict(list)
    for logged in read_log(log):
        messages[logged.topic].append(logged.message)
    return messages


def values(log, topic):
    return [message.data for message in recorded(log)[topic]]


def deployment_stamps(messages):
    return [
        read_report(message)[0].stamp
        if hasattr(message, 'deployment')
        else from_stamp(message.header.stamp)
        for message in messages
    ]


def test_no_message_is_lost_under_any_qos_of_the_publisher(field):
    log = record(field)
    latched = field.node.create_publisher(String, '/m/latched', LAST_OF_FIVE)
    for number in range(9):
        latched.publish(String(data=str(number)))
    burst = field.talk(Int32, '/m/burst', QoSProfile(depth=2000))
    unreliable = field.talk(Int32, '/m/unreliable', BEST_EFFORT)
    # Best effort: messages behind a burst may be lost for any subscriber.
    unreliable.publish(Int32(data=7))
    for number in range(2000):
        burst.publish(Int32(data=number))
    field.until(lambda: len(values(log, '/m/burst')) >= 2000, 'last message')
    field.processes.stop()
    messages = recorded(log)
    assert [message.data for message in messages['/m/burst']] == list(range(2000))
    assert [message.data for message in messages['/m/unreliable']] == [7]
    assert [message.data for message in messages['/m/latched']] == list('45678')


def test_only_the_mission_and_shared_topics_are_recorded(field):
    log = record(field)
    topics = ('/m/deep/er', '/tf', '/tf_static', '/clock', '/mm/other', '/other')
    for topic in topics:
        field.node.create_publisher(String, topic, qos.LATCHED).publish(String())
    field.until(lambda: recorded(log).keys() >= {*topics[:4], '/diagnostics'}, 'messages')
    field.processes.stop()
    assert set(recorded(log)) == {*topics[:4], '/diagnostics'}


def test_topics_of_others_in_the_namespace_are_recorded_as_they_are(field):
    """None has a role in the mission, under any name and type."""
    log = record(field)
    strangers = {
        '/m/battery/status': String(data='full'),
        '/m/sensor/report': Int32(data=1),
        '/m/nav/path': path(1),
        '/m/evil/belief': prior(),
        '/m/x/scout_1/report': lost(1),
        '/m/scout_2/report': lost(2),
        '/m/navigate/_action/status': String(data='driving'),
    }
    for topic, message in strangers.items():
        field.talk(type(message), topic, RELIABLE).publish(message)
    field.until(lambda: recorded(log).keys() >= strangers.keys(), 'messages')
    assert field.count('/m/recorder', 'refused') == 0


def test_without_a_namespace_everything_but_the_logs_of_ros_is_recorded(field):
    log = record(field, '/')
    field.node.create_publisher(String, '/a/topic', qos.LATCHED).publish(String())
    field.node.get_logger().info('for /rosout')
    field.until(lambda: recorded(log).keys() >= {'/a/topic', '/diagnostics'}, 'messages')
    field.processes.stop()
    assert set(recorded(log)) == {'/a/topic', '/diagnostics'}


def test_the_log_has_the_qos_of_a_publisher_that_returns(field):
    log = record(field)
    # The reader receives latched messages from before as well.
    for profile, readers in ((RELIABLE, 1), (LAST_OF_FIVE, 2), (BEST_EFFORT, 1)):
        publisher = field.node.create_publisher(Int32, '/m/number', profile)
        field.until(lambda p=publisher, n=readers: p.get_subscription_count() == n, 'readers')
        field.node.destroy_publisher(publisher)
    field.processes.stop()
    offered = [
        (profile['reliability'], profile['durability'])
        for channel in channels(log)
        if channel.topic == '/m/number'
        for profile in yaml.safe_load(channel.metadata['offered_qos_profiles'])
    ]
    assert offered == [
        ('reliable', 'volatile'),
        ('reliable', 'transient_local'),
        ('best_effort', 'volatile'),
    ]


def test_a_path_is_on_disk_before_it_is_confirmed(field):
    log = record(field, agents=['one', 'two'])
    state_mission(field)
    told = {agent: field.listen(Recorded, f'/m/{agent}/recorded') for agent in ('one', 'two')}
    paths = {agent: field.talk(Path, f'/m/{agent}/path') for agent in told}
    for agent, numbers in (('one', (3, 1, 4)), ('two', (2,))):
        for number in numbers:
            paths[agent].publish(path(number))
            stamp = to_stamp(key(number).stamp)
            field.until(
                lambda a=agent, s=stamp: s in [each.stamp for each in told[a]],
                f'word of path {number}',
            )
            assert key(number).stamp in deployment_stamps(recorded(log)[f'/m/{agent}/path'])
    assert [from_stamp(each.stamp) for each in told['one']] == [key(n).stamp for n in (3, 1, 4)]
    assert [from_stamp(each.stamp) for each in told['two']] == [key(2).stamp]


@pytest.mark.parametrize('profile', [RELIABLE, KEPT_BEST_EFFORT], ids=['volatile', 'best effort'])
def test_evidence_that_no_other_node_receives_is_refused_and_its_node_named(field, profile):
    log = record(field)
    reports = field.node.create_publisher(DeploymentReport, '/m/scout_1/report', profile)
    told = field.until_refused('/m/recorder', 1)
    lacking = 'volatile' if profile is RELIABLE else 'with best effort'
    assert told.startswith(f'/m/scout_1/report refused: node /test/test publishes it {lacking}')
    assert 'its QoS must be reliable and transient local' in told
    reports.publish(lost(1))
    field.talk(DeploymentReport, '/m/scout_1/report').publish(lost(2))
    field.until(lambda: recorded(log)['/m/scout_1/report'], 'report')
    assert deployment_stamps(recorded(log)['/m/scout_1/report']) == [key(2).stamp]
    assert reports.get_subscription_count() == 0


def test_a_resumed_log_holds_everything(field):
    log, told, paths = record_path(field)
    recorder = field.processes.started['/m/recorder']
    recorder.kill()
    recorder.wait()
    paths.publish(path(2))
    assert not is_finished(log)
    record(field, resume=str(log.parent))
    field.until(lambda: from_stamp(told[-1].stamp) == key(2).stamp, 'word of path 2')
    field.processes.stop()
    assert is_finished(log)
    part = log.with_name('mission_1.mcap')
    assert is_finished(part)
    assert deployment_stamps(recorded(part)['/m/scout_1/path']) == [key(1).stamp, key(2).stamp]
    assert len(recorded(log)['/m/scout_1/path']) == 3


def test_a_log_has_one_recorder_at_a_time(field):
    log, told, paths = record_path(field)
    field.set_aside('/m/recorder')
    other = field.start('recorder', {'resume': str(log)}, '/m', {'__node': 'other'})
    # Its last diagnostics reach the other recorder or the test, whichever it knows first.
    assert other.wait(60) == 2
    field.processes.started.pop('/m/recorder')
    assert f'{log} is being written by another recorder' in field.said('/m/recorder')
    paths.publish(path(2))
    field.until(lambda: from_stamp(told[-1].stamp) == key(2).stamp, 'word of path 2')
    field.processes.stop()
    assert is_finished(log)
    assert deployment_stamps(recorded(log)['/m/scout_1/path']) == [key(1).stamp, key(2).stamp]
    assert list(log.parent.glob('*.mcap')) == [log]


def test_a_message_too_large_to_be_read_again_is_refused_and_the_rest_goes_on(field):
    log = record(field)
    points = field.talk(UInt8MultiArray, '/m/points', RELIABLE)
    points.publish(UInt8MultiArray(data=array('B', bytes(70_000_000))))
    told = field.until_refused('/m/recorder', 1)
    assert told.startswith('/m/points refused: it has 700000')
    assert 'at most 66060288 are recorded' in told
    points.publish(UInt8MultiArray(data=array('B', bytes(1000))))
    field.until(lambda: '/m/points' in recorded(log), 'points')
    field.processes.stop()
    assert [len(each.data) for each in recorded(log)['/m/points']] == [1000]


def test_publishers_of_one_topic_may_differ_and_each_message_is_recorded_once(field):
    log = record(field)
    kept = field.node.create_publisher(Int32, '/m/number', qos.EVIDENCE)
    for number in range(3):
        kept.publish(Int32(data=number))
    publishers = [kept, field.talk(Int32, '/m/number', RELIABLE)]
    field.until(lambda: len(recorded(log)['/m/number']) == 3, 'history')
    publishers.append(field.talk(Int32, '/m/number', BEST_EFFORT))
    for number in range(3, 300):
        publishers[number % 3].publish(Int32(data=number))
        field.executor.spin_once(timeout_sec=0.001)
    # Best effort: some messages may be lost for any subscriber.
    promised = {number for number in range(300) if number < 3 or number % 3 < 2}
    field.until(lambda: promised <= set(values(log, '/m/number')), 'last message')
    field.processes.stop()
    numbers = values(log, '/m/number')
    assert len(numbers) == len(set(numbers)) > 200


def test_messages_for_a_stopped_recorder_are_recorded_once_and_in_order(field):
    log = record(field)
    kept = field.node.create_publisher(Int32, '/m/number', qos.EVIDENCE)
    field.talk(Int32, '/m/number', RELIABLE)
    field.until(lambda: kept.get_subscription_count() == 2, 'both readers')
    reports = field.talk(DeploymentReport, '/m/scout_1/report')
    recorder = field.processes.started['/m/recorder']
    recorder.send_signal(signal.SIGSTOP)
    for number in range(4000):
        kept.publish(Int32(data=number))
    recorder.send_signal(signal.SIGCONT)
    assert kept.wait_for_all_acked(Duration(seconds=20))
    # Most of it is still pending, and is taken together with this.
    reports.publish(lost(1))
    field.until(lambda: recorded(log)['/m/scout_1/report'], 'report')
    field.processes.stop()
    assert values(log, '/m/number') == list(range(4000))


def test_a_topic_that_comes_back_with_another_type_is_refused_and_the_rest_goes_on(field):
    log = record(field)
    expected = []
    for kind, value in ((String, 'first'), (Int32, 1), (String, 'second')):
        publisher = field.node.create_publisher(kind, '/m/topic', qos.LATCHED)
        publisher.publish(kind(data=value))
        if kind is Int32:
            refusal = field.until_refused('/m/recorder', 1)
            assert 'type is std_msgs/msg/Int32: it is on record as std_msgs/msg/' in refusal
        else:
            expected.append(value)
            field.until(lambda: values(log, '/m/topic') == expected, f'the {value} message')
        field.node.destroy_publisher(publisher)


def test_a_signal_under_load_loses_no_received_message(field):
    log = record(field)
    reports = field.talk(DeploymentReport, '/m/scout_1/report')
    chatter = field.talk(Int32, '/m/chatter', QoSProfile(depth=5000))
    sent = [
        (serialize_message(lost(number)), serialize_message(Int32(data=number)))
        for number in range(2000)
    ]
    for report, number in sent:
        reports.publish(report)
        chatter.publish(number)
    for publisher in (reports, chatter):
        assert publisher.wait_for_all_acked(Duration(seconds=20))
    recorder = field.processes.started['/m/recorder']
    recorder.send_signal(signal.SIGTERM)
    assert recorder.wait(timeout=60) == 0
    assert is_finished(log)
    messages = recorded(log)
    assert [message.data for message in messages['/m/chatter']] == list(range(2000))
    assert deployment_stamps(messages['/m/scout_1/report']) == [key(n).stamp for n in range(2000)]


def complaints(field, name):
    """Return a node's error lines, without those of rcl about the environment."""
    lines = field.said(name).splitlines()
    return [line for line in lines if not line.startswith('[INFO]') and '[rcl]' not in line]


def until_failed(field, name, exit_code):
    """Wait until a node has failed; return its only complaint."""
    code, told = field.until_failed(name)
    assert code == exit_code
    assert complaints(field, name) == [told]
    return told


def report_until_it_fails(field, log):
    """Send reports until the recorder fails; return its error, and check the readable rest."""
    reports = field.talk(DeploymentReport, '/m/scout_1/report')
    talker = field.talk(UInt8MultiArray, '/m/bytes', RELIABLE)
    recorder = field.processes.started['/m/recorder']
    readable = 0
    for number in range(2000):
        reports.publish(lost(number))
        talker.publish(UInt8MultiArray(data=array('B', bytes(3000))))
        field.executor.spin_once(timeout_sec=0.002)
        if recorder.poll() is not None:
            break
        if number == 0:
            field.until(lambda: recorded(log)['/m/scout_1/report'], 'first report on record')
        if number < 20:
            readable = len(recorded(log)['/m/scout_1/report'])
    told = until_failed(field, '/m/recorder', 1)
    stamps = deployment_stamps(recorded(log)['/m/scout_1/report'])
    assert len(stamps) >= readable > 0
    assert stamps == [key(number).stamp for number in range(len(stamps))]
    return told


def test_a_full_disk_ends_the_recorder_and_keeps_its_log(field, tmp_path):
    with mounted(tmp_path / 'disk', 'size=1m') as disk:
        log = disk / 'mission.mcap'
        field.start('recorder', {'file': str(log)}, '/m')
        told = report_until_it_fails(field, log)
    assert told == f'recorder: {log}: No space left on device (free some space on that disk)'


@pytest.mark.parametrize('what', ['folder', 'replaced', 'cut'])
def test_a_recorder_whose_file_is_gone_ends_and_says_so(field, what):
    log, told, paths = record_path(field)
    recorder = field.processes.started['/m/recorder']
    # Between two checks no message may be confirmed either.
    recorder.send_signal(signal.SIGSTOP)
    if what == 'folder':
        shutil.rmtree(log.parent)
    elif what == 'cut':
        os.truncate(log, 100)
    else:
        log.with_suffix('.new').write_bytes(log.read_bytes())
        log.with_suffix('.new').replace(log)
    paths.publish(path(2))
    recorder.send_signal(signal.SIGCONT)
    why = f'{log} was cut to 100 of' if what == 'cut' else f'{log} is gone'
    assert why in until_failed(field, '/m/recorder', 1)
    assert log.exists() == (what in ('replaced', 'cut'))
    assert [from_stamp(each.stamp) for each in told] == [key(1).stamp]


def test_a_belief_that_comes_before_its_path_is_recorded_after_it(field):
    """DDS keeps the order of one publisher, not of two."""
    log = record(field)
    beliefs = field.talk(BeliefMaps, '/m/belief', qos.LATCHED)
    paths = field.talk(Path, '/m/scout_1/path')
    beliefs.publish(prior())
    field.until(lambda: field.count('/m/recorder', 'accepted') > 0, 'prior')
    beliefs.publish(after_loss())
    told = field.diagnosed_at('/m/recorder')
    field.until(lambda: field.diagnosed_at('/m/recorder') > told, 'newer diagnostics')
    paths.publish(path(1))
    field.until(lambda: len(held_by(log)) == 2, 'belief on record')
    assert held_by(log) == [0, 1]
    assert field.count('/m/recorder', 'refused') == 0


def held_by(log):
    """Return the numbers of deployments in the recorded beliefs."""
    return [logged.message.deployments for logged in read_log(log, ['kbnitp_msgs/msg/BeliefMaps'])]
