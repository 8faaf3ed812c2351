# SPDX-License-Identifier: Apache-2.0
"""Intact messages of a log become a finished file, and only one process writes a log."""

import errno
import fcntl
from itertools import product
from pathlib import Path
import subprocess
import sys

from disk import room_for
from kbnitp_ros.cli.replay import main
from kbnitp_ros.log.files import log_parts, LogError
from kbnitp_ros.log.mcap_file import repair
from kbnitp_ros.log.read import is_finished, read_log, read_metadata, read_part, RecordedMessage
from kbnitp_ros.log.schema import BagFile, write_metadata
from kbnitp_ros.log.write import LogWriter
from laws import for_each
from mission_log import record, record_to
from other_readers import check_all_read
import pytest


@pytest.fixture
def folder(whole_mission, tmp_path):
    """Return a folder with a log in three parts, the second of which is unfinished."""
    folder = tmp_path / 'run'
    folder.mkdir()
    sent = whole_mission.sent
    log = LogWriter(folder / 'mission.mcap', max_file_size=18_000)
    log.add_metadata('run', {'seed': '7'})
    record_to(log, sent[:30], synced=True)
    unfinished = log.current_path.read_bytes()
    log.close()
    assert log.current_path.name == 'mission_1.mcap'
    with LogWriter(folder, resume=True) as resumed:
        resumed.add_metadata('run', {'seed': '8'})
        record_to(resumed, sent[30:], synced=True)
    log.current_path.write_bytes(unfinished)
    return folder


def content(*files):
    """Return the messages of some files with all their fields but offsets."""
    recorded = (each for file in files for each in read_part(file))
    messages = [each for each in recorded if isinstance(each, RecordedMessage)]
    return [
        (each.channel.topic, each.channel.metadata, each.schema.name, each.schema.data, *each[2:6])
        for each in messages
    ]


@pytest.mark.processes
def test_all_parts_become_one_finished_file(folder, whole_mission, tmp_path):
    target = tmp_path / 'repaired' / 'mission.mcap'
    target.parent.mkdir()
    saved, lost = repair(folder, target)
    assert saved == len(whole_mission.sent)
    assert lost == [f'{folder / "mission_1.mcap"} is unfinished']
    assert is_finished(target)
    assert content(target) == content(*log_parts(folder))
    assert read_metadata(target)['run'] == {'seed': '8'}
    check_all_read(target)
    # A log named by its folder may be repaired into it.
    parts = content(*log_parts(folder))
    repair(folder, folder / 'whole.mcap')
    assert content(folder / 'whole.mcap') == parts


@for_each('name, told', [
    ('mission.mcap', 'mission.mcap'),
    ('x.db3', "x.db3' cannot name a log: it must end in .mcap"),
    ('mission_3.mcap', 'is named like a later part of another log'),
])  # fmt: skip
def test_a_bad_target_is_refused_and_left_alone(folder, capsys, name, told):
    before = {file: file.read_bytes() for file in folder.iterdir()}
    assert main([str(folder), '--repair', str(folder / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_a_full_disk_leaves_no_partial_file(folder, tmp_path):
    target = tmp_path / 'repaired' / 'mission.mcap'
    target.parent.mkdir()
    with room_for(10_000), pytest.raises(OSError, match=f'File too large: {str(target)!r}'):
        repair(folder, target)
    assert list(target.parent.iterdir()) == []


def test_a_log_that_cannot_be_described_is_not_left_half_repaired(folder, tmp_path):
    target = tmp_path / 'repaired' / 'mission.mcap'
    # In place of the output.
    target.parent.joinpath('mission.mcap.metadata.yaml.new').mkdir(parents=True)
    with pytest.raises(OSError, match=r'metadata\.yaml\.new'):
        repair(folder, target)
    assert not target.exists()


def test_a_full_disk_keeps_the_old_metadata(folder):
    before = folder.joinpath('metadata.yaml').read_text()
    names = sorted(folder.iterdir())
    with room_for(100), pytest.raises(OSError, match=r'File too large: .*metadata\.yaml\.new'):
        write_metadata(folder, [BagFile('mission.mcap')])
    assert folder.joinpath('metadata.yaml').read_text() == before
    assert sorted(folder.iterdir()) == names


def test_the_command_repairs_and_replays(folder, whole_mission, tmp_path, capsys):
    target = tmp_path / 'repaired.mcap'
    assert main([str(folder), '--repair', str(target)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == [
        f'{len(whole_mission.sent)} messages of {folder} are saved in {target}',
        f'lost: {folder / "mission_1.mcap"} is unfinished',
    ]
    assert '/belief: 9 of 9 messages reproduced' in said
    assert not any('the log is unfinished' in line for line in said)


def test_messages_before_an_error_are_saved_from_each_part(folder, whole_mission, tmp_path):
    path = folder / 'mission.mcap'
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(whole_mission.sent[10].data) + 20] ^= 1
    path.write_bytes(damaged)
    kept = len([each for each in read_part(path, []) if isinstance(each, RecordedMessage)])
    assert kept == 10
    later = len(content(*log_parts(folder)[1:]))
    saved, lost = repair(folder, tmp_path / 'repaired.mcap')
    assert saved == kept + later
    assert lost[0] == f'{folder / "mission_1.mcap"} is unfinished'
    assert lost[1].startswith(f'{path} is corrupt after byte')
    assert is_finished(tmp_path / 'repaired.mcap')


@for_each('cut', [0, 5, 8, 100])
def test_an_empty_log_is_not_repaired(whole_mission, tmp_path, cut, capsys):
    path = record(tmp_path / 'mission.mcap', whole_mission.sent)
    path.write_bytes(path.read_bytes()[:cut])
    assert main([str(path), '--repair', str(tmp_path / 'repaired.mcap')]) == 2
    assert 'mission.mcap has no message that could be saved' in capsys.readouterr().err
    assert not (tmp_path / 'repaired.mcap').exists()


HELD = 'mission.mcap is being written by another recorder: end it before'

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
    """Return a function by which another process writes three parts of a log and keeps it open."""
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
        before = file_contents(tmp_path / 'log')
        for part in (*log_parts(log.path), log.path.with_name('mission_7.mcap')):
            assert main([str(source), '--repair', str(part)]) == 2
            assert part.name in capsys.readouterr().err
        assert file_contents(tmp_path / 'log') == before
