# SPDX-License-Identifier: Apache-2.0
"""A mission has one recorder, which loses no deployment and records parameters of nodes."""

from array import array
from signal import SIGSTOP
import time
from types import SimpleNamespace

from base import Base
from extent import FULL
from kbnitp_msgs.msg import BeliefMaps, DeploymentReport, Recorded
from kbnitp_ros.configuration import node_parameters
from kbnitp_ros.log.files import log_parts
from kbnitp_ros.log.read import is_finished, read_log, read_metadata, read_parameters, RUN
from kbnitp_ros.messages.deployments import read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes import presence, recorder
from kbnitp_ros.nodes.presence import SILENT
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import numpy as np
import pytest
import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from samples import key, lost, path, prior
from std_msgs.msg import String, UInt8MultiArray


def start(field, log, **parameters):
    process = field.start('recorder', {'file': str(log), **parameters}, '/m')
    field.until(lambda: field.told('/m/recorder', presence.LOG), f'recorder of {log}')
    return process


@pytest.mark.processes
def test_a_second_recorder_counts_when_the_first_has_ended(field):
    base = Base(field)
    base.until_sent(1)
    field.until(lambda: base.recorded(1), 'first path on disk')
    second = field.folder / 'second.mcap'
    field.set_aside('/recorder')
    field.start(
        'recorder', {'file': str(second), 'agents': ['scout_1']}, remaps={'__node': 'other'}
    )
    waits = (
        f'an earlier recorder, whose acknowledgements count: node /recorder records to {base.log}'
    )
    field.until(lambda: waits in field.state('/other'), 'the second recorder')
    # Without the prior its log could not be replayed.
    field.until_recorded(second, {'/belief': base.beliefs})
    base.come_back()
    base.until_sent(2)
    base.come_back()
    base.until_sent(3)
    first = field.processes.started.pop('/recorder 1')
    first.send_signal(SIGSTOP)
    # Its confirmations expire with its diagnostics.
    field.until(
        lambda: 'whose acknowledgements count' not in field.state('/other'), 'the second recorder'
    )
    base.come_back()
    base.until_sent(4)
    first.kill()
    base.log = second
    assert len(base.replayed().evidence.standings) == 3


@pytest.mark.processes
def test_recorders_of_other_namespaces_do_not_matter(field):
    start(field, field.folder / 'first.mcap')
    for number, namespace in enumerate(('/', '/m/deeper', '/mm')):
        log = field.folder / f'{number}.mcap'
        field.start('recorder', {'file': str(log)}, namespace)
    for name in ('/recorder', '/m/deeper/recorder', '/mm/recorder'):
        field.until(lambda name=name: field.told(name, presence.LOG), name)


@pytest.mark.processes
def test_a_recorder_with_a_backlog_publishes_diagnostics(monkeypatch):
    """Messages that take half a second each, on their own clock."""
    written, heard = [], []
    monkeypatch.setattr(recorder.time, 'monotonic', lambda: 0.5 * len(written))
    arrived = [(None, b'', {'received_timestamp': number}) for number in range(100)]
    node = SimpleNamespace(
        _write=lambda *message: written.append(message),
        _shown_at=0.0,
        diagnostics=SimpleNamespace(publish=lambda: heard.append(0.5 * len(written))),
    )
    waiting = SimpleNamespace(arrived=lambda: [iter(arrived)])
    recorder.RecorderNode._write_arrived_on(node, [waiting])
    assert len(written) == 100
    assert max(np.diff([0.0, *heard, 50.0])) < SILENT


KILLS = 50 if FULL else 1
# Depth that a publisher keeps for a restarted recorder.
DEPLOYMENTS = qos.DEPTH

PATH = 'nav_msgs/msg/Path'
REPORT = 'kbnitp_msgs/msg/DeploymentReport'


class Load:
    """Publishes deployments and many other messages."""

    def __init__(self, field):
        self._field = field
        self._paths = field.node.create_publisher(Path, '/m/scout_1/path', qos.EVIDENCE)
        self._reports = field.node.create_publisher(
            DeploymentReport, '/m/scout_1/report', qos.EVIDENCE
        )
        self._bulk = field.node.create_publisher(UInt8MultiArray, '/m/bulk', QoSProfile(depth=100))
        self._filling = serialize_message(UInt8MultiArray(data=array('B', bytes(10_000))))
        self.sent = 0

    def send(self, deployments, seconds):
        """Publish `count` deployments over some time, and other messages as fast as possible."""
        begun, before = time.monotonic(), self.sent
        while (passed := (time.monotonic() - begun) / seconds) < 1:
            while self.sent < before + deployments * passed:
                self.sent += 1
                self._paths.publish(path(self.sent))
                self._reports.publish(lost(self.sent))
            self._bulk.publish(self._filling)
            self._field.executor.spin_once(timeout_sec=0.001)


def stamps(log, kind):
    messages = [logged.message for logged in read_log(log, {kind})]
    if kind == REPORT:
        return {read_report(message)[0].stamp for message in messages}
    return {from_stamp(message.header.stamp) for message in messages}


def test_a_recorder_killed_under_load_loses_no_deployment(field):
    rng = np.random.default_rng(50)
    log = field.folder / 'mission.mcap'
    field.node.create_publisher(BeliefMaps, '/m/belief', qos.LATCHED).publish(prior())
    told = field.listen(Recorded, '/m/scout_1/recorded', volatile=True)
    load = Load(field)
    recorder = field.start('recorder', {'file': str(log)}, '/m')
    load.send(100, 0.1)
    field.until(lambda: told, 'word of the first path')
    for kills in range(KILLS):
        # A recorder without a file of its own has nothing to lose.
        field.until(lambda kills=kills: len(log_parts(log)) > kills, 'file of the next recorder')
        load.send((DEPLOYMENTS - 100) // (2 * max(KILLS, 10)), rng.uniform(0.5, 2.5))
        recorder.kill()
        recorder.wait()
        if told:
            newest = from_stamp(told[-1].stamp)
            sent = {key(number).stamp for number in range(1, load.sent + 1)}
            # The confirmation may be of an earlier recorder.
            on_disk = set().union(*(stamps(part, PATH) for part in log_parts(log)))
            assert on_disk >= {stamp for stamp in sent if stamp <= newest}
        told.clear()
        recorder = field.start('recorder', {'resume': str(log)}, '/m')
    # A confirmation of the recorder before may still arrive.
    field.until(lambda: len(log_parts(log)) > KILLS, 'file of the last recorder')
    last = key(load.sent).stamp
    field.until(lambda: told and from_stamp(told[-1].stamp) == last, 'word of the last path')
    field.until(lambda: last in stamps(log_parts(log)[-1], REPORT), 'last report')
    field.processes.stop()
    # A killed recorder leaves its file unfinished.
    assert is_finished(log)
    missing = {key(number).stamp for number in range(1, load.sent + 1)} - stamps(log, REPORT)
    print(f'{KILLS} kills, {load.sent} deployments reported, {len(missing)} of them missing')
    assert not missing
    assert load.sent <= DEPLOYMENTS


@pytest.fixture
def log(field):
    log = field.folder / 'mission.mcap'
    field.start('recorder', {'file': str(log)}, '/m')
    field.until(lambda: field.told('/m/recorder', 'log'), 'log')
    return log


def until_known(field, log, node, **values):
    """Wait until a node's recorded parameters have these values; return them all."""

    def known():
        return read_parameters(log).get(node, {}).items() >= values.items()

    field.until(known, f'{values} of {node}')
    return read_parameters(log)[node]


def test_every_node_of_the_mission_is_asked(field, log):
    field.start('agent', {'seed': 2**40, 'grid.blocked': [5, 6], 'sensor.lethality': 1.0}, '/m')
    agent = until_known(field, log, '/m/agent', seed=2**40)
    assert agent['grid.blocked'] == [5, 6]
    assert (agent['sensor.lethality'], type(agent['sensor.lethality'])) == (1.0, float)
    assert agent.keys() >= node_parameters('agent').keys()
    recorder = until_known(field, log, '/m/recorder', file=str(log))
    assert recorder.keys() >= node_parameters('recorder').keys()
    assert read_parameters(log).keys() == {'/m/agent', '/m/recorder'}
    assert read_metadata(log)[RUN]['rmw_implementation'] == 'rmw_fastrtps_cpp'


def test_changes_and_restarts_are_recorded(field, log):
    planner = field.start('planner', {'robots': 5}, '/m')
    until_known(field, log, '/m/planner', robots=5)
    client = AsyncParameterClient(field.node, '/m/planner')
    field.until(client.services_are_ready, 'parameter services')
    client.set_parameters([Parameter('robots', value=6)])
    until_known(field, log, '/m/planner', robots=6, max_visits=3)
    planner.kill()
    planner.wait()
    field.start('planner', {'robots': 7, 'max_visits': 2}, '/m')
    until_known(field, log, '/m/planner', robots=7, max_visits=2)


def test_a_node_without_an_answer_delays_nothing_and_is_left_alone(field, log):
    silent = rclpy.create_node('silent', context=field.node.context, namespace='/m')
    talker = field.talk(String, '/m/chatter')

    def asked():
        services = field.node.get_client_names_and_types_by_node('recorder', '/m')
        return '/m/silent/get_parameters' in dict(services)

    field.until(asked, 'question to the silent node')
    before = None

    def are_recorded_meanwhile():
        # The question may end before the test hears of the messages: then it is asked anew.
        nonlocal before
        accepted = field.count('/m/recorder', 'accepted')
        before = (accepted if before is None else before) if asked() else None
        talker.publish(String(data='words'))
        return before is not None and accepted > before + 20

    field.until(are_recorded_meanwhile, 'messages during the question')
    field.until(lambda: not asked(), 'end of the questions')
    assert '/m/silent' not in read_parameters(log)
    silent.destroy_node()
