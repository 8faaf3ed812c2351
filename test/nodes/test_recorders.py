# SPDX-License-Identifier: Apache-2.0
"""A mission has one recorder: a second one is refused, gives way or holds the mission."""

from signal import SIGSTOP
from types import SimpleNamespace

from base import Base
from kbnitp_ros.nodes import presence, recorder
from kbnitp_ros.nodes.presence import SILENT
import numpy as np
import pytest

pytestmark = pytest.mark.processes


def start(field, log, **parameters):
    """Start a recorder, and return its process once it has opened its log."""
    process = field.start('recorder', {'file': str(log), **parameters}, '/m')
    field.until(lambda: field.told('/m/recorder', presence.LOG), f'recorder of {log}')
    return process


def until_ended(field, process):
    """Wait for the end of a process, and return its exit code."""
    field.until(lambda: process.poll() is not None, 'end of a recorder', may_end=True)
    return process.returncode


def test_a_second_recorder_counts_when_the_first_has_ended(field):
    base = Base(field)
    base.until_sent(1)
    field.until(lambda: base.recorded(1), 'first path on disk')
    second = field.folder / 'second.mcap'
    field.set_aside('/recorder')
    field.start(
        'recorder', {'file': str(second), 'agents': ['scout_1']}, remaps={'__node': 'other'}
    )
    waits = f'an earlier recorder, whose word counts: node /recorder records to {base.log}'
    field.until(lambda: waits in field.state('/other'), 'the second recorder')
    base.come_back()
    base.until_sent(2)
    base.come_back()
    base.until_sent(3)
    first = field.processes.started.pop('/recorder 1')
    first.send_signal(SIGSTOP)
    # What it said does not count for longer than it is heard.
    field.until(lambda: 'whose word counts' not in field.state('/other'), 'the second recorder')
    base.come_back()
    base.until_sent(4)
    first.kill()
    base.log = second
    assert len(base.replayed().evidence.reports) == 3


def test_recorders_of_other_namespaces_do_not_matter(field):
    start(field, field.folder / 'first.mcap')
    for number, namespace in enumerate(('/', '/m/deeper', '/mm')):
        log = field.folder / f'{number}.mcap'
        field.start('recorder', {'file': str(log)}, namespace)
    for name in ('/recorder', '/m/deeper/recorder', '/mm/recorder'):
        field.until(lambda name=name: field.told(name, presence.LOG), name)


def test_a_recorder_with_much_to_write_is_heard(monkeypatch):
    """Of messages that take half a second each, on a clock of their own."""
    written, heard = [], []
    monkeypatch.setattr(recorder.time, 'monotonic', lambda: 0.5 * len(written))
    arrived = [(None, b'', {'received_timestamp': number}) for number in range(100)]
    node = SimpleNamespace(
        _write=lambda *message: written.append(message),
        _shown_at=0.0,
        diagnostics=SimpleNamespace(publish=lambda: heard.append(0.5 * len(written))),
    )
    node._show_life = lambda: recorder.RecorderNode._show_life(node)
    waiting = SimpleNamespace(arrived=lambda: [iter(arrived)])
    recorder.RecorderNode._write_arrived_on(node, [waiting])
    assert len(written) == 100
    assert max(np.diff([0.0, *heard, 50.0])) < SILENT
