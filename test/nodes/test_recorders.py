# SPDX-License-Identifier: Apache-2.0
"""A mission has one recorder: a second one is refused, gives way or holds the mission."""

from __future__ import annotations

from signal import SIGCONT, SIGSTOP
import time
from types import SimpleNamespace

from base import Base
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from kbnitp_msgs.msg import Recorded
from kbnitp_ros.bag import is_finished, read_log
from kbnitp_ros.log.evidence import BELIEF, PATH, REPORT
from kbnitp_ros.log.replay import replay
from kbnitp_ros.nodes import recorder, recorders
from kbnitp_ros.nodes.instances import SILENT
from kbnitp_ros.nodes.runtime import qos
import numpy as np
import pytest
import rclpy

pytestmark = pytest.mark.processes


def start(field, log, **parameters):
    """Start a recorder, and return its process once it has opened its log."""
    process = field.start('recorder', {'file': str(log), **parameters}, '/m')
    field.until(lambda: field.told('/m/recorder', recorders.LOG), f'recorder of {log}')
    return process


def until_ended(field, process):
    """Wait for the end of a process, and return its exit code."""
    field.until(lambda: process.poll() is not None, 'end of a recorder', may_end=True)
    return process.returncode


def test_a_second_recorder_is_refused_and_the_first_goes_on(field):
    log, other = field.folder / 'first.mcap', field.folder / 'second.mcap'
    start(field, log)
    field.set_aside('/m/recorder')
    second = field.start('recorder', {'file': str(other)}, '/m', {'__node': 'another'})
    assert until_ended(field, second) == 2
    assert (
        f'recorder: another recorder is alive: node /m/recorder records to {log}. A mission has '
        'one recorder: end that one before, or start this one in another namespace'
    ) in field.said('/m/recorder')
    assert not other.exists()
    assert set(field.processes.stop().values()) == {0, 2}
    assert is_finished(log)


def test_recorders_of_other_namespaces_do_not_matter(field):
    start(field, field.folder / 'first.mcap')
    for number, namespace in enumerate(('/', '/m/deeper', '/mm')):
        log = field.folder / f'{number}.mcap'
        field.start('recorder', {'file': str(log)}, namespace)
    for name in ('/recorder', '/m/deeper/recorder', '/mm/recorder'):
        field.until(lambda name=name: field.told(name, recorders.LOG), name)


def test_a_publisher_that_says_nothing_is_waited_for_and_named(field):
    field.node.create_publisher(Recorded, f'/m/{recorders.TOPIC}', qos.EVIDENCE)
    start(field, field.folder / 'first.mcap')
    assert (
        'nothing was heard for 3 s from node /test/test, which publishes operator/recorded as '
        'well: it is taken for a recorder that was killed'
    ) in field.said('/m/recorder')


def test_of_two_that_start_at_once_one_goes_on(field):
    logs = [field.folder / 'first.mcap', field.folder / 'second.mcap']
    processes = []
    for log in logs:
        processes.append(field.start('recorder', {'file': str(log)}, '/m'))
        field.set_aside('/m/recorder')
    field.until(
        lambda: any(each.poll() is not None for each in processes), 'end of one', may_end=True
    )
    (ended,) = (each for each in processes if each.poll() is not None)
    (going_on,) = (each for each in processes if each is not ended)
    # It depends on the machine whether one has opened its log before the other looks.
    assert ended.returncode in (1, 2)
    kept = logs[processes.index(going_on)]
    assert f'records to {kept}' in field.said('/m/recorder') or (
        f'has recorded for longer, to {kept}' in field.said('/m/recorder')
    )
    field.until(lambda: field.told('/m/recorder', recorders.LOG), 'recorder', may_end=True)
    assert going_on.poll() is None


@pytest.mark.full
def test_a_recorder_that_stood_still_gives_way_and_no_deployment_is_lost(field):
    base = Base(field)
    base.until_sent(1)
    field.until(lambda: base.recorded(1), 'first path on disk')
    first = field.processes.started['/recorder']
    first.send_signal(SIGSTOP)
    stopped = time.monotonic()
    field.set_aside('/recorder')
    second = field.folder / 'second.mcap'
    field.start('recorder', {'file': str(second)})
    # A log that lacks the prior cannot be replayed.
    field.until(second.exists, 'log of the second recorder')
    field.until(lambda: list(read_log(second, (BELIEF,))), 'prior on record')
    for number in (1, 2):
        base.come_back()
        base.until_held(number)
        base.until_sent(number + 1)
    field.until(lambda: base.recorded(3), 'third path on disk')
    base.come_back()
    # One that stood still for less goes on, and the second one ends.
    field.until(lambda: time.monotonic() > stopped + SILENT + 1.0, 'silence of the first recorder')
    first.send_signal(SIGCONT)
    assert until_ended(field, first) == 1
    assert f'node /recorder has recorded for longer, to {second}' in field.said('/recorder')
    told = 'operator/recorded refused: more than one recorder is alive: node /recorder records to'
    assert told in field.said('/planner')
    for name in list(field.processes.ended()):
        field.processes.started.pop(name)
    base.until_held(3)
    base.until_sent(4)
    base.log = second
    base.crash()
    base.until_held(3)
    base.until_state('to be reported on /scout_1/report')
    base.come_back()
    base.until_held(4)
    assert len(base.replayed().evidence.reports) == base.parameters['robots']


def test_a_recorder_with_much_to_write_is_heard(monkeypatch):
    """Of messages that take half a second each, on a clock of their own."""
    written, heard = [], []
    monkeypatch.setattr(recorder.time, 'monotonic', lambda: 0.5 * len(written))
    arrived = [(None, b'', {'received_timestamp': number}) for number in range(100)]
    node = SimpleNamespace(
        _write=lambda *message: written.append(message),
        _shown_at=0.0,
        _precedence=SimpleNamespace(check=lambda: None),
        diagnostics=SimpleNamespace(publish=lambda: heard.append(0.5 * len(written))),
    )
    node._show_life = lambda: recorder.RecorderNode._show_life(node)
    waiting = SimpleNamespace(arrived=lambda: [iter(arrived)])
    recorder.RecorderNode._write_arrived_on(node, [waiting])
    assert len(written) == 100
    assert max(np.diff([0.0, *heard, 50.0])) < SILENT


class Forger:
    """A node that publishes what only recorders do, and nothing else."""

    def __init__(self, field):
        self._field = field
        self.node = rclpy.create_node('forger', context=field.node.context)
        self.diagnostics = field.talk(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)

    def publish(self):
        """Be found in the graph."""
        self.node.create_publisher(Recorded, f'/{recorders.TOPIC}', qos.EVIDENCE)

    def say_it_records(self):
        """Be heard on diagnostics as a recorder that began before all others."""
        values = {'instance': 'forged', recorders.LOG: 'forged.mcap', recorders.BEGUN: '1'}
        told = [KeyValue(key=key, value=value) for key, value in values.items()]
        status = DiagnosticStatus(name='/forger', values=[*told, *STATE])
        self.diagnostics.publish(DiagnosticArray(status=[status]))


STATE = [KeyValue(key='state', value='forged')]


def test_what_is_forged_holds_a_mission_no_longer_than_it_is_told_and_ends_no_recorder(field):
    base = Base(field)
    base.until_sent(1)
    forger = Forger(field)
    forger.publish()
    # A publisher alone is nothing.
    base.come_back()
    base.until_sent(2)
    begun = field.node.get_clock().now().nanoseconds
    field.until(
        lambda: field.node.get_clock().now().nanoseconds > begun + recorders.COMPARE_UNTIL * 1e9,
        'an established recorder',
    )
    holding = 'waiting for all but one recorder to end: node /recorder records to '

    def is_said(name, words):
        forger.say_it_records()
        return words in field.said(name) + field.state(name)

    field.until(lambda: is_said('/planner', 'more than one recorder'), 'notice')
    base.come_back()
    field.until(lambda: is_said('/planner', holding), 'hold')
    assert 'node /forger records to forged.mcap' in field.state('/planner')
    noticed = 'this is not the only recorder: node /forger'
    field.until(lambda: is_said('/recorder', noticed), 'warning')
    assert len(base.sent()) == 2
    # Nobody says so any more.
    base.until_sent(3)
    forger.node.destroy_node()
    assert set(field.processes.stop(60).values()) == {0}
    assert replay(base.log).reproduced
    assert sum(1 for _ in read_log(base.log, (PATH,))) == 3
    assert sum(1 for _ in read_log(base.log, (REPORT,))) == 2
