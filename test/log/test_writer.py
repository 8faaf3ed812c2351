# SPDX-License-Identifier: Apache-2.0
"""What the writer promises of the file, as far as its own project can tell."""

import os
from pathlib import Path
import signal
import subprocess
import sys

from kbnitp_ros.log.reader import is_finished, read_log
from kbnitp_ros.log.writer import LogWriter
from mcap.reader import make_reader
from mission_log import QOS, record, record_to
from nav_msgs.msg import OccupancyGrid
import pytest
import rclpy.serialization

TOPIC = '/belief/hazard'
TYPE = 'nav_msgs/msg/OccupancyGrid'

EMPTY_MAP = rclpy.serialization.serialize_message(OccupancyGrid())


def test_an_existing_file_is_refused_and_kept(tmp_path, whole_mission):
    path = record(tmp_path / 'mission.mcap', whole_mission.sent)
    content = path.read_bytes()
    with pytest.raises(FileExistsError, match='mission.mcap'):
        LogWriter(path)
    assert path.read_bytes() == content


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match='nowhere'):
        LogWriter(tmp_path / 'nowhere' / 'mission.mcap')


def test_a_topic_of_unknown_type_leaves_the_log_as_it_was(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        with pytest.raises(LookupError, match='no_such_msgs'):
            log.add_topic('/other', 'no_such_msgs/msg/Path', '[]')
        log.add_topic(TOPIC, TYPE, '[]')
        log.write(TOPIC, EMPTY_MAP, 2, 1)
    assert [each.topic for each in read_log(log.path)] == [TOPIC]


def test_what_is_synced_can_be_read_by_others(tmp_path, whole_mission):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        for count in (0, 1, 5, 0):
            before = len(list(read_log(log.path)))
            record_to(log, whole_mission.sent[:count])
            log.sync()
            assert len(list(read_log(log.path))) == before + count
            assert not is_finished(log.path)
    assert is_finished(log.path)
    assert len(list(read_log(log.path))) == 6


def test_a_sync_reaches_the_disk(tmp_path, whole_mission, monkeypatch):
    """Everything is in the file when the system is asked to put it onto the disk."""
    synced = []

    def fsync(descriptor):
        target = Path(f'/proc/self/fd/{descriptor}').readlink()
        synced.append((target, target.stat().st_size))

    monkeypatch.setattr(os, 'fsync', fsync)
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        assert [target for target, _ in synced] == [path, tmp_path]
        record_to(log, whole_mission.sent[:3])
        assert len(synced) == 2
        log.sync()
        assert synced[-1] == (path, path.stat().st_size)
        assert synced[-1][1] > synced[0][1]
    assert synced[-1] == (path, path.stat().st_size)


WRITE_UNTIL_KILLED = """
import sys
from mission_log import mission, record_to
from kbnitp_ros.log.writer import LogWriter

sent = mission(robots=3).sent
log = LogWriter(sys.argv[1])
written = 0
while True:
    for each in sent:
        if written < len(sent):
            record_to(log, [each])
        else:
            log.write(each.topic, each.data, each.time, each.time)
        log.sync()
        written += 1
        print(written, flush=True)
"""


@pytest.mark.parametrize('count', [1, 17, 200])
def test_a_kill_loses_nothing_that_was_synced(tmp_path, count):
    path = tmp_path / 'mission.mcap'
    writer = subprocess.Popen(
        [sys.executable, '-c', WRITE_UNTIL_KILLED, path],
        cwd=Path(__file__).parent,
        stdout=subprocess.PIPE,
        text=True,
    )
    for line in writer.stdout:
        if int(line) >= count:
            break
    writer.send_signal(signal.SIGKILL)
    told = count + sum(1 for _ in writer.stdout)
    assert writer.wait() == -signal.SIGKILL
    assert not is_finished(path)
    assert len(list(read_log(path))) in (told, told + 1)


def test_the_file_is_finished_after_an_error(tmp_path):
    log = LogWriter(tmp_path / 'mission.mcap')

    def node():
        with log:
            log.add_topic(TOPIC, TYPE, '[]')
            log.write(TOPIC, EMPTY_MAP, 2, 1)
            raise RuntimeError('of the node')

    with pytest.raises(RuntimeError, match='of the node'):
        node()
    assert is_finished(log.path)
    assert len(list(read_log(log.path))) == 1


def test_a_log_without_messages_is_one(tmp_path):
    path = record(tmp_path / 'mission.mcap', [])
    assert is_finished(path)
    assert list(read_log(path)) == []


def test_a_message_larger_than_a_chunk_is_written(tmp_path):
    message = OccupancyGrid(data=[7] * 3_000_000)
    with LogWriter(tmp_path / 'mission.mcap') as log:
        log.add_topic(TOPIC, TYPE, '[]')
        log.write(TOPIC, EMPTY_MAP, 1, 1)
        log.write(TOPIC, rclpy.serialization.serialize_message(message), 2, 2)
        log.write(TOPIC, EMPTY_MAP, 3, 3)
    assert [len(each.message.data) for each in read_log(log.path)] == [0, 3_000_000, 0]


def test_a_topic_may_be_added_again_with_other_qos(tmp_path):
    """A publisher was restarted."""
    with LogWriter(tmp_path / 'mission.mcap') as log:
        for time in (1, 2):
            log.add_topic(TOPIC, TYPE, f'[{{depth: {time}}}]')
            log.write(TOPIC, EMPTY_MAP, time, time)
    with log.path.open('rb') as file:
        channels = make_reader(file).get_summary().channels.values()
    assert [channel.metadata['offered_qos_profiles'] for channel in channels] == [
        '[{depth: 1}]',
        '[{depth: 2}]',
    ]
    assert [each.log_time for each in read_log(log.path)] == [1, 2]


def test_how_the_run_was_configured_is_kept(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        log.add_metadata('configuration', {'seed': '7', 'planner': 'beam'})
    with log.path.open('rb') as file:
        records = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert records['configuration'] == {'seed': '7', 'planner': 'beam'}


def test_the_header_says_what_wrote_it(tmp_path, whole_mission):
    path = record(tmp_path / 'mission.mcap', whole_mission.sent, QOS)
    with path.open('rb') as file:
        header = make_reader(file).get_header()
    assert header.profile == 'ros2'
    assert header.library.startswith('kbnitp_ros')
