# SPDX-License-Identifier: Apache-2.0
"""A log with a message that is too large to be read is read around it."""

from __future__ import annotations

from contextlib import closing
import sqlite3

from bags import write_bag
from bounded import megabytes_at_start, run_command
from kbnitp_ros.bag import file_writer, is_finished, LogWriter, read_log, repair, writer
from kbnitp_ros.bag.reader import tell_skipped
from kbnitp_ros.cli.report import main as report
from laws import for_each
from mission_log import record_to
import pytest

LARGE = 70_000_000

TOPIC = '/m/points'

# What a log takes that is read around a message of 70 MB, in MB: others may have 64 MiB.
ENOUGH = 200


@pytest.fixture(autouse=True)
def nothing_told_yet():
    """Have what is skipped told in each test."""
    tell_skipped.cache_clear()


def log_with_a_large_message(folder, sent, compression, monkeypatch):
    """Return a log of another writer, which has a large message between others."""
    path = folder / 'mission.mcap'
    # As a writer has them that knows no limit and collects messages before it.
    monkeypatch.setattr(writer, 'LARGEST_MESSAGE', 2**40)
    monkeypatch.setattr(file_writer, 'CHUNK', 2**40)
    with LogWriter(path, compression=compression) as log:
        record_to(log, sent[:20])
        log.add_topic(TOPIC, 'std_msgs/msg/String', '[]')
        log.write(TOPIC, bytes(LARGE), sent[20].time, 1)
        log.sync()
        record_to(log, sent[20:])
    return path


@pytest.mark.parametrize('compression', ['none', 'zstd'])
def test_it_is_read_around(tmp_path, whole_mission, compression, caplog, monkeypatch):
    path = log_with_a_large_message(tmp_path, whole_mission.sent, compression, monkeypatch)
    for _ in range(2):
        assert [each.data for each in read_log(path)] == [each.data for each in whole_mission.sent]
    (told,) = caplog.messages
    assert f'{path}: a message of topic {TOPIC} near byte' in told
    assert 'is skipped: at most 67108864 are read' in told
    target = tmp_path / 'repaired' / 'mission.mcap'
    target.parent.mkdir()
    repaired = repair(path, target)
    assert repaired.messages == len(whole_mission.sent)
    (lost,) = repaired.lost
    assert TOPIC in lost
    with LogWriter(path, resume=True) as log:
        assert log.current_path.name == 'mission_1.mcap'


def test_an_unfinished_log_with_one_is_gone_on_with(tmp_path, whole_mission, caplog, monkeypatch):
    path = log_with_a_large_message(tmp_path, whole_mission.sent, 'none', monkeypatch)
    path.write_bytes(path.read_bytes()[:-100])
    with LogWriter(path, resume=True):
        pass
    assert is_finished(path)
    assert path.stat().st_size < LARGE
    assert [each.data for each in read_log(path)] == [each.data for each in whole_mission.sent]
    assert TOPIC in caplog.text


@pytest.mark.processes
@for_each('compression', ['none', 'zstd'])
def test_replay_names_it_and_goes_on(tmp_path, whole_mission, compression, monkeypatch):
    path = log_with_a_large_message(tmp_path, whole_mission.sent, compression, monkeypatch)
    ended = run_command('replay', path)
    assert ended.code == 0, ended
    assert ended.said.count(f'a message of topic {TOPIC}') == 1
    assert ended.megabytes < megabytes_at_start('replay') + ENOUGH


@pytest.mark.slow
@pytest.mark.parametrize('compression', ['none', 'zstd'])
def test_report_names_it_and_goes_on(tmp_path, whole_mission, compression, caplog, monkeypatch):
    path = log_with_a_large_message(tmp_path, whole_mission.sent, compression, monkeypatch)
    assert report(['--out', str(tmp_path / 'page'), str(path)]) == 0
    assert caplog.text.count(f'a message of topic {TOPIC}') == 1


def test_a_database_with_one_is_read_around_it(tmp_path, whole_mission, caplog):
    bag = write_bag(tmp_path / 'bag', whole_mission.sent, 'sqlite3')
    (path,) = bag.glob('*.db3')
    with closing(sqlite3.connect(path)) as database:
        database.execute(f'UPDATE messages SET data = zeroblob({LARGE}) WHERE id = 1')
        database.commit()
    assert len(list(read_log(bag))) == len(whole_mission.sent) - 1
    assert 'is skipped' in caplog.text
