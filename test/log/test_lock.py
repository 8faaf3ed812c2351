# SPDX-License-Identifier: Apache-2.0
"""No two processes write a log, and none writes one that has been taken away from it."""

import errno
import fcntl
from itertools import product
from pathlib import Path
import subprocess
import sys

from kbnitp_ros.cli.replay import main
from kbnitp_ros.log.files import LogError, parts_of
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.write import LogWriter
from laws import for_each
from mission_log import record, record_to
import pytest

HELD = 'mission.mcap is being written by another recorder: end that one before'

WRITE_UNTIL_KILLED = """
import sys
from mission_log import mission, record_to
from kbnitp_ros.log.write import LogWriter

log = LogWriter(sys.argv[1], resume=len(sys.argv) > 2, max_file_size=1)
record_to(log, mission(robots=1).sent[:3], synced=True)
print('written', flush=True)
sys.stdin.read()
"""


@pytest.fixture
def elsewhere():
    """Return a function that has another process write three parts of a log and hold it."""
    processes = []

    def write(*arguments):
        process = subprocess.Popen(
            [sys.executable, '-c', WRITE_UNTIL_KILLED, *map(str, arguments)],
            cwd=Path(__file__).parent,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        processes.append(process)
        assert process.stdout.readline() == b'written\n'
        return process

    yield write
    for process in processes:
        process.kill()
        process.communicate()


def content(folder):
    """Return what is in the files of a folder."""
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.processes
@pytest.mark.parametrize('resumed, was_finished', [(False, False), (True, False), (True, True)])
def test_a_log_that_is_being_written_is_not_gone_on_with(
    tmp_path, whole_mission, elsewhere, resumed, was_finished
):
    path = tmp_path / 'mission.mcap'
    if resumed:
        record(path, whole_mission.sent)
        if not was_finished:
            path.write_bytes(path.read_bytes()[:-1])
    writer = elsewhere(path, *['resume'] * resumed)
    before = content(tmp_path)
    for name in (path, tmp_path):
        with pytest.raises(LogError, match=HELD):
            LogWriter(name, resume=True)
    assert content(tmp_path) == before
    messages = [each.data for each in read_log(path)]
    writer.kill()
    writer.wait()
    # The lock is gone with its holder, and so it is with a writer that was closed.
    for count in (1, 2):
        with LogWriter(path, resume=True) as log:
            record_to(log, whole_mission.sent[:1])
        assert [each.data for each in read_log(path)][:-count] == messages


def test_of_a_name_and_a_link_to_it_one_can_be_written(tmp_path, whole_mission):
    with LogWriter(tmp_path / 'mission.mcap'):
        (tmp_path / 'other').mkdir()
        link = tmp_path / 'other' / 'mission.mcap'
        link.hardlink_to(tmp_path / 'mission.mcap')
        with pytest.raises(LogError, match=HELD):
            LogWriter(link, resume=True)


@for_each('which, how', product(['first', 'current'], ['removed', 'replaced', 'renamed']))
def test_what_is_written_to_a_log_that_is_gone_is_not_said_to_be_safe(
    tmp_path, whole_mission, which, how
):
    log = LogWriter(tmp_path / 'mission.mcap', max_file_size=1)
    record_to(log, whole_mission.sent[:3], synced=True)
    file = log.path if which == 'first' else log.current_path
    if how == 'renamed':
        file.rename(tmp_path / 'old.mcap')
    else:
        before = file.read_bytes()
        file.unlink()
        if how == 'replaced':
            file.write_bytes(before)
    with pytest.raises(FileNotFoundError, match=f'{file.name} is gone: it was removed or rep'):
        log.check_in_place()
    with pytest.raises(FileNotFoundError, match=f'{file.name} is gone: it was removed or rep'):
        log.sync()


@for_each('resume', [False, True])
def test_a_file_system_without_locks_is_refused(tmp_path, monkeypatch, resume):
    path = tmp_path / 'mission.mcap'
    if resume:
        record(path, [])

    def flock(*_):
        raise OSError(errno.ENOLCK, 'No locks available')

    monkeypatch.setattr(fcntl, 'flock', flock)
    with pytest.raises(LogError, match=r'mission.mcap cannot be locked .* No locks available'):
        LogWriter(path, resume=resume)
    monkeypatch.undo()
    LogWriter(path, resume=True).close()


def test_nothing_is_repaired_into_a_log_that_is_being_written(tmp_path, whole_mission, capsys):
    (tmp_path / 'log').mkdir()
    source = record(tmp_path / 'old.mcap', whole_mission.sent)
    with LogWriter(tmp_path / 'log' / 'mission.mcap', max_file_size=1) as log:
        record_to(log, whole_mission.sent[:3], synced=True)
        before = content(tmp_path / 'log')
        for part in (*parts_of(log.path), log.path.with_name('mission_7.mcap')):
            assert main([str(source), '--repair', str(part)]) == 2
            assert part.name in capsys.readouterr().err
        assert content(tmp_path / 'log') == before
