# SPDX-License-Identifier: Apache-2.0
"""Guarantees of the log writer, as far as this project's reader can check them."""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import shutil

from ament_index_python import packages
from ament_index_python.packages import get_package_share_directory
from disk import room_for
from kbnitp_ros.log.files import new_log
from kbnitp_ros.log.read import (
    is_finished,
    LogError,
    read_log,
    read_metadata,
    read_recorded,
    RecordedMessage,
)
from kbnitp_ros.log.schema import describe, qos_profiles_yaml
from kbnitp_ros.log.write import LogWriter, MAX_MESSAGE
from laws import for_each
from mcap.reader import make_reader
from mission_log import QOS, record, record_to
from nav_msgs.msg import OccupancyGrid
import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
import rclpy.serialization
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml

TOPIC = '/belief/hazard'
TYPE = 'nav_msgs/msg/OccupancyGrid'

EMPTY_MAP = rclpy.serialization.serialize_message(OccupancyGrid())


@for_each('name, options, error, told', [
    ('run_2.mcap', {}, FileExistsError, 'run_2.mcap'),
    ('nowhere/mission.mcap', {}, FileNotFoundError, 'nowhere'),
    *((name, {}, LogError, f"{name}' cannot name a log: it must end in .mcap")
      for name in ('mission', 'mission.db3', 'mission.mcap.1')),
    ('run_2_1.mcap', {}, FileExistsError, 'run_2_1.mcap is named like a later part'),
    ('run.mcap', {}, FileExistsError, 'run_2.mcap is named like a later part'),
    ('folder', {'resume': True}, LogError, 'holds no log'),
    ('mission.mcap', {'resume': True}, LogError, 'cannot be resumed: No such file'),
])  # fmt: skip
def test_bad_messages_are_refused(tmp_path, whole_mission, name, options, error, told):
    (tmp_path / 'folder').mkdir()
    path = record(tmp_path / 'run_2.mcap', whole_mission.sent)
    content, there = path.read_bytes(), sorted(tmp_path.iterdir())
    with pytest.raises(error, match=told):
        LogWriter(tmp_path / name, **options)
    assert (path.read_bytes(), sorted(tmp_path.iterdir())) == (content, there)


def test_missions_that_begin_in_one_second_have_folders_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with ThreadPoolExecutor() as pool:
        logs = [*pool.map(lambda _: new_log(), range(3))]
    assert len({log.parent for log in logs}) == 3
    assert {log.parent.parent for log in logs} == {Path('runs')}
    # A folder that is named is taken as it is.
    assert new_log(tmp_path / 'out') == new_log(tmp_path / 'out') == tmp_path / 'out/mission.mcap'


def test_a_topic_of_unknown_type_leaves_the_log_as_it_was(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        with pytest.raises(LookupError, match='no_such_msgs'):
            log.add_topic('/other', 'no_such_msgs/msg/Path', '[]')
        log.add_topic(TOPIC, TYPE, '[]')
        log.write(TOPIC, EMPTY_MAP, 2, 1)
    assert [message.topic for message in read_log(log.path)] == [TOPIC]


def test_synced_messages_can_be_read_by_others(tmp_path, whole_mission):
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
    """All bytes are in the file when the system is asked to sync it."""
    synced = []

    def keep(descriptor):
        target = Path(f'/proc/self/fd/{descriptor}').readlink()
        synced.append((target, target.stat().st_size))

    for name in ('fsync', 'fdatasync'):
        monkeypatch.setattr(os, name, keep)
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        assert [target for target, _ in synced] == [path, tmp_path]
        record_to(log, whole_mission.sent[:3])
        assert len(synced) == 2
        log.sync()
        assert synced[-1] == (path, path.stat().st_size)
        assert synced[-1][1] > synced[0][1]
    assert (path, path.stat().st_size) in synced


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


def test_a_topic_added_again_as_it_was_is_one_channel(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        for time in (1, 2):
            log.add_topic(TOPIC, TYPE, '[]')
            log.write(TOPIC, EMPTY_MAP, time, time)
    with log.path.open('rb') as file:
        reader = make_reader(file)
        assert len(reader.get_summary().channels) == 1
        assert [message.sequence for _, _, message in reader.iter_messages()] == [1, 2]


def test_a_time_that_a_file_cannot_hold_loses_no_message(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        log.add_topic(TOPIC, TYPE, '[]')
        log.write(TOPIC, EMPTY_MAP, 5, -1)
    assert [(message.log_time, message.publish_time) for message in read_log(log.path)] == [(5, 0)]


def test_the_header_names_the_writer(tmp_path, whole_mission):
    path = record(tmp_path / 'mission.mcap', whole_mission.sent, QOS)
    with path.open('rb') as file:
        header = make_reader(file).get_header()
    assert header.profile == 'ros2'
    assert header.library.startswith('kbnitp_ros')


def test_a_message_too_large_to_be_read_again_is_refused(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        log.add_topic(TOPIC, TYPE, '[]')
        with pytest.raises(ValueError, match=f'at most {MAX_MESSAGE} are recorded'):
            log.write(TOPIC, bytes(MAX_MESSAGE + 1), 1, 1)
        log.write(TOPIC, EMPTY_MAP, 2, 2)
    assert [message.log_time for message in read_log(log.path)] == [2]


@pytest.mark.slow
def test_the_largest_message_is_read_again(tmp_path):
    noise = np.random.default_rng(1).bytes(MAX_MESSAGE)
    with LogWriter(tmp_path / 'mission.mcap') as log:
        log.add_topic(TOPIC, TYPE, '[]')
        log.write(TOPIC, bytes(2**20 - 100), 1, 1)
        log.write(TOPIC, noise, 2, 2)
    assert [each.data for each in read_recorded(log.path) if isinstance(each, RecordedMessage)][
        1
    ] == noise


@for_each('share', [0.0, 0.3, 0.8, 1.0])
def test_a_log_is_resumed(tmp_path, whole_mission, share):
    """Earlier messages are unchanged, wherever the writer was killed."""
    path = tmp_path / 'mission.mcap'
    half = len(whole_mission.sent) // 2
    with LogWriter(path) as log:
        log.add_metadata('run', {'seed': '7'})
        record_to(log, whole_mission.sent[:half], synced=True)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    before = [each for each in read_recorded(path) if isinstance(each, RecordedMessage)]
    with LogWriter(tmp_path if share else path, resume=True) as log:
        assert log.path == path
        assert log.current_path == tmp_path / 'mission_1.mcap'
        with pytest.raises(LogError, match=r'mission_1\.mcap is a later part of a log'):
            LogWriter(log.current_path, resume=True)
        record_to(log, whole_mission.sent[half:])
    assert is_finished(path)
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        'metadata.yaml',
        'mission.mcap',
        'mission_1.mcap',
    ]
    after = [each for each in read_recorded(path) if isinstance(each, RecordedMessage)]
    told = [(each.channel.topic, each.sequence, each.log_time, each.data) for each in after]
    assert told[: len(before)] == [
        (each.channel.topic, each.sequence, each.log_time, each.data) for each in before
    ]
    gone_on_with = [each.data for each in after]
    del gone_on_with[: len(before)]
    assert gone_on_with == [message.data for message in whole_mission.sent[half:]]
    if share == 1.0:
        assert read_metadata(path)['run'] == {'seed': '7'}


def test_another_bag_in_the_folder_keeps_its_metadata(tmp_path, whole_mission):
    record(tmp_path / 'first.mcap', whole_mission.sent[:3])
    described = (tmp_path / 'metadata.yaml').read_text()
    with LogWriter(tmp_path / 'second.mcap') as log:
        assert log.shares_folder
    assert (tmp_path / 'metadata.yaml').read_text() == described
    with LogWriter(tmp_path / 'first.mcap', resume=True) as log:
        assert not log.shares_folder
    assert (tmp_path / 'metadata.yaml').read_text() != described


def test_a_renamed_log_is_read_and_resumed_beside_its_old_metadata(tmp_path, whole_mission):
    record(tmp_path / 'mission.mcap', whole_mission.sent[:3])
    (tmp_path / 'mission.mcap').rename(tmp_path / 'good.mcap')
    with LogWriter(tmp_path, resume=True) as log:
        assert not log.shares_folder
        record_to(log, whole_mission.sent[3:5])
    assert len([*read_log(tmp_path)]) == 5
    assert 'good_1.mcap' in (tmp_path / 'metadata.yaml').read_text()


@for_each('batch', [1, 7])
def test_a_full_disk_keeps_synced_messages(tmp_path, whole_mission, batch):
    path = tmp_path / 'mission.mcap'
    log = LogWriter(path)
    synced = 0

    def fill_the_disk():
        nonlocal synced
        for start in range(0, len(whole_mission.sent), batch):
            end = start + batch
            record_to(log, whole_mission.sent[start:end])
            log.sync()
            synced = end

    with room_for(30_000):
        with pytest.raises(OSError, match=f'File too large: {str(path)!r}'):
            fill_the_disk()
        left = path.read_bytes()
        log.close()
    assert path.read_bytes() == left
    with pytest.raises(ValueError, match=r'mission.mcap is closed'):
        log.sync()
    read = [message.data for message in read_log(path)]
    assert read == [each.data for each in whole_mission.sent[:synced]]
    assert synced
    assert not is_finished(path)
    with LogWriter(path, resume=True) as log:
        record_to(log, whole_mission.sent[synced:])
    assert [each.data for each in read_log(path)] == [each.data for each in whole_mission.sent]


def test_a_full_disk_leaves_no_started_file(tmp_path):
    log = tmp_path / 'mission.mcap'
    with room_for(10), pytest.raises(OSError, match=f'File too large: {str(log)!r}'):
        LogWriter(log)
    assert list(tmp_path.iterdir()) == []


def test_a_corrupt_later_part_is_not_resumed(whole_mission, tmp_path):
    path = tmp_path / 'mission.mcap'
    record(path, whole_mission.sent[:6])
    with LogWriter(path, resume=True) as log:
        record_to(log, whole_mission.sent[6:9])
    part = tmp_path / 'mission_1.mcap'
    content = bytearray(part.read_bytes())
    content[len(content) // 3] ^= 1
    part.write_bytes(content)
    with pytest.raises(LogError, match=r'mission_1\.mcap is corrupt after byte'):
        LogWriter(path, resume=True)


TYPES = [
    'builtin_interfaces/msg/Time',
    'diagnostic_msgs/msg/DiagnosticArray',
    'kbnitp_msgs/msg/BeliefMaps',
    'kbnitp_msgs/msg/DeploymentReport',
    'nav_msgs/msg/OccupancyGrid',
    'nav_msgs/msg/Path',
    'rosgraph_msgs/msg/Clock',
    'visualization_msgs/msg/Marker',
]


def referenced(field):
    """Yield the message types in a field's description by rosbags."""
    kind, content = field
    if kind is Nodetype.NAME:
        yield content
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from referenced(content[0])


@for_each('type_name', TYPES)
def test_a_definition_is_complete(type_name):
    types = get_types_from_msg(describe(type_name)[0], type_name)
    fields = [field for _, definition in types.values() for _, field in definition]
    assert types.keys() == {type_name, *(name for field in fields for name in referenced(field))}


@for_each('type_name', TYPES)
def test_the_hash_is_that_of_the_definition(type_name):
    """Computed by another implementation of REP-2011 from the recorded text."""
    store = get_typestore(Stores.EMPTY)
    definition, type_hash = describe(type_name)
    store.register(get_types_from_msg(definition, type_name))
    assert type_hash == store.hash_rihs01(type_name)


def test_a_topic_of_a_type_in_idl_only_is_refused(tmp_path, monkeypatch):
    described = Path(get_package_share_directory('std_msgs'), 'msg', 'String.json')
    (tmp_path / 'msg').mkdir()
    shutil.copy(described, tmp_path / 'msg')
    monkeypatch.setattr(packages, 'get_package_share_directory', lambda _: tmp_path)
    with pytest.raises(LookupError, match=r'type std_msgs/msg/String is not inst.*String\.msg'):
        describe('std_msgs/msg/String')


def test_all_nine_policies_are_listed_for_every_publisher():
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=42,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        deadline=Duration(seconds=1, nanoseconds=2),
        lifespan=Duration(seconds=3, nanoseconds=4),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=5, nanoseconds=6),
        avoid_ros_namespace_conventions=True,
    )
    other = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    first, second = yaml.safe_load(qos_profiles_yaml([profile, other]))
    assert first == {
        'history': 'keep_last',
        'depth': 42,
        'reliability': 'reliable',
        'durability': 'transient_local',
        'deadline': {'sec': 1, 'nsec': 2},
        'lifespan': {'sec': 3, 'nsec': 4},
        'liveliness': 'manual_by_topic',
        'liveliness_lease_duration': {'sec': 5, 'nsec': 6},
        'avoid_ros_namespace_conventions': True,
    }
    assert (second.keys(), second['history']) == (first.keys(), 'keep_all')
