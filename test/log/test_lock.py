# SPDX-License-Identifier: Apache-2.0
"""Only one process writes a log, and none writes a log that is gone."""

import errno
import fcntl
from itertools import product
from pathlib import Path
import subprocess
import sys

from disk import room_for
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import read_log
from kbnitp_ros.log.schema import BagFile, write_metadata
from kbnitp_ros.log.write import LogWriter
from laws import for_each
from mission_log import record, record_to
import pytest


@pytest.fixture
def folder(whole_mission, tmp_path):
    record(tmp_path / 'mission.mcap', whole_mission.sent)
    return tmp_path


def test_a_full_disk_keeps_the_old_metadata(folder):
    before = folder.joinpath('metadata.yaml').read_text()
    names = sorted(folder.iterdir())
    with room_for(100), pytest.raises(OSError, match=r'File too large: .*metadata\.yaml\.new'):
        write_metadata(folder, [BagFile('mission.mcap')])
    assert folder.joinpath('metadata.yaml').read_text() == before
    assert sorted(folder.iterdir()) == names


HELD = 'mission.mcap is being written by another recorder: end it before'

WRITE_UNTIL_KILLED = """
import sys
from mission_log import mission, record_to
from kbnitp_ros.log.write import LogWriter

log = LogWriter(sys.argv[1], resume=len(sys.argv) > 2)
record_to(log, mission(robots=1).sent[:3], synced=True)
print('written', flush=True)
sys.stdin.read()
"""


@pytest.fixture
def elsewhere():
    """Return a function by which another process writes a log and keeps it open."""
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


def file_contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.processes
@pytest.mark.parametrize('resumed, was_finished', [(False, False), (True, False), (True, True)])
def test_a_log_that_is_being_written_is_not_resumed(
    tmp_path, whole_mission, elsewhere, resumed, was_finished
):
    path = tmp_path / 'mission.mcap'
    if resumed:
        record(path, whole_mission.sent)
        if not was_finished:
            path.write_bytes(path.read_bytes()[:-1])
    writer = elsewhere(path, *['resume'] * resumed)
    before = file_contents(tmp_path)
    for name in (path, tmp_path):
        with pytest.raises(LogError, match=HELD):
            LogWriter(name, resume=True)
    assert file_contents(tmp_path) == before
    messages = [message.data for message in read_log(path)]
    writer.kill()
    writer.wait()
    # The lock ends with its process, and with a closed writer.
    for count in (1, 2):
        with LogWriter(path, resume=True) as log:
            record_to(log, whole_mission.sent[:1])
        assert [each.data for each in read_log(path)][:-count] == messages


def test_a_log_and_a_link_to_it_have_one_writer(tmp_path, whole_mission):
    with LogWriter(tmp_path / 'mission.mcap'):
        (tmp_path / 'other').mkdir()
        link = tmp_path / 'other' / 'mission.mcap'
        link.hardlink_to(tmp_path / 'mission.mcap')
        with pytest.raises(LogError, match=HELD):
            LogWriter(link, resume=True)


@for_each('which, how', product(['first', 'current'], ['removed', 'replaced', 'renamed']))
def test_messages_to_a_deleted_log_are_not_acknowledged(tmp_path, whole_mission, which, how):
    record(tmp_path / 'mission.mcap', whole_mission.sent[:3])
    log = LogWriter(tmp_path, resume=True)
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
