# SPDX-License-Identifier: Apache-2.0
"""Bags by other programs, of either storage, are read and replayed like the mission's own log."""

from pathlib import Path
import re
import sqlite3
import subprocess
import sys

from bags import write_bag
from kbnitp_ros.bag.reader import is_finished, LogError, read_log
from kbnitp_ros.bag.repair import repair
from kbnitp_ros.log.replay import replay
from laws import for_each
from mission_log import record
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode
import yaml

STORAGES = ['mcap', 'sqlite3']

STORAGE_ZSTD = CompressionMode.STORAGE, CompressionFormat.ZSTD


@pytest.fixture(scope='module')
def sent(whole_mission):
    return whole_mission.sent


def check(path, sent):
    """Check that all is read, and that it replays."""
    read = list(read_log(path))
    assert [(each.topic, each.type_name, each.log_time, each.data) for each in read] == [
        (each.topic, each.type_name, each.time + 500, each.data) for each in sent
    ]
    assert is_finished(path)
    report = replay(path)
    assert report.reproduced
    assert report.finished
    assert report.compared['/belief'] == sum(each.topic == '/belief' for each in sent)
    assert len(report.evidence.reports) == 8


@for_each('version', [8, 9])
@for_each('storage', STORAGES)
def test_a_bag_is_read_by_its_folder_and_by_its_file(sent, tmp_path, storage, version):
    folder = write_bag(tmp_path / 'bag', sent, storage, version)
    check(folder, sent)
    (file,) = (each for each in folder.iterdir() if each.name != 'metadata.yaml')
    check(file, sent)


def test_compressed_chunks_are_read(sent, tmp_path):
    check(write_bag(tmp_path / 'bag', sent, 'mcap', compression=STORAGE_ZSTD), sent)


@for_each('storage', STORAGES)
@for_each('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_what_rosbag2_compressed_is_refused(sent, tmp_path, storage, mode):
    folder = write_bag(tmp_path / 'bag', sent, storage, compression=(mode, CompressionFormat.ZSTD))
    with pytest.raises(LogError, match=r'bag is compressed, mode \w+: decompress it with ros2'):
        list(read_log(folder))


@for_each('mode', ['NONE', 'none'])
def test_a_bag_that_says_it_is_not_compressed_is_read(sent, tmp_path, mode):
    folder = write_bag(tmp_path / 'bag', sent, 'mcap')
    described = yaml.safe_load((folder / 'metadata.yaml').read_text())
    described['rosbag2_bagfile_information']['compression_mode'] = mode
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(described))
    check(folder, sent)


@pytest.mark.processes
@for_each('storage', STORAGES)
def test_a_log_converted_by_rosbags_is_read(sent, tmp_path, storage):
    folder = tmp_path / 'recorded'
    folder.mkdir()
    record(folder / 'mission.mcap', sent)
    converted = tmp_path / 'converted'
    convert = ['rosbags-convert', '--src', folder, '--dst', converted, '--dst-storage', storage]
    subprocess.run([Path(sys.executable).with_name(convert[0]), *convert[1:]], check=True)
    check(converted, sent)


def split_bag(tmp_path, sent, storage):
    """Return a bag of two files, as ``ros2 bag record`` names and lists them."""
    folder = tmp_path / 'bag'
    folder.mkdir()
    for number, half in enumerate((sent[:20], sent[20:])):
        made = write_bag(tmp_path / f'half_{number}', half, storage)
        (file,) = (each for each in made.iterdir() if each.name != 'metadata.yaml')
        file.rename(folder / f'bag_{number}{file.suffix}')
    described = yaml.safe_load((made / 'metadata.yaml').read_text())
    listed = described['rosbag2_bagfile_information']['relative_file_paths']
    listed[:] = [f'bag_{number}{file.suffix}' for number in (0, 1)]
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(described))
    return folder


def with_listed(folder, change):
    """Change which files metadata.yaml lists."""
    path = folder / 'metadata.yaml'
    described = yaml.safe_load(path.read_text())
    change(described['rosbag2_bagfile_information']['relative_file_paths'])
    path.write_text(yaml.safe_dump(described))


@for_each('storage', STORAGES)
def test_a_split_bag_is_read_by_its_folder_and_by_its_first_file(sent, storage, tmp_path):
    split = split_bag(tmp_path, sent, storage)
    check(split, sent)
    check(next(split.glob('bag_0.*')), sent)
    later = list(read_log(next(split.glob('bag_1.*'))))
    assert [each.data for each in later] == [each.data for each in sent[20:]]


@for_each('storage', STORAGES)
def test_the_folder_may_be_part_of_a_listed_name(sent, storage, tmp_path):
    """As in bags before Galactic."""
    split = split_bag(tmp_path, sent, storage)
    with_listed(split, lambda names: names.__setitem__(slice(None), [f'bag/{n}' for n in names]))
    check(split, sent)


@for_each('storage', STORAGES)
def test_a_recorder_that_was_killed_left_an_old_list(sent, storage, tmp_path):
    split = split_bag(tmp_path, sent, storage)
    with_listed(split, list.pop)
    check(split, sent)


@pytest.mark.slow
@for_each('left', [None, '', 'rosbag2_bagfile_information:\n  version: 9\n', '[a'])
@for_each('storage', STORAGES)
def test_a_recorder_that_was_killed_left_no_list(sent, left, storage, tmp_path):
    split = split_bag(tmp_path, sent, storage)
    if left is None:
        (split / 'metadata.yaml').unlink()
    else:
        (split / 'metadata.yaml').write_text(left)
    check(split, sent)


@for_each('storage', STORAGES)
def test_a_list_that_says_two_things_is_refused(storage, sent, tmp_path):
    split = split_bag(tmp_path, sent, storage)
    file = split / 'metadata.yaml'
    first, *lines = file.read_text().splitlines()
    file.write_text('\n'.join([first, lines[0], *lines]))
    (key,) = re.findall(r'(\w+):', lines[0])
    told = rf"metadata\.yaml: the key '{key}' stands in line 3 and in line 2"
    for path in (split, next(split.glob('bag_0.*'))):
        with pytest.raises(LogError, match=told):
            list(read_log(path))


@for_each('is_listed', [True, False])
@for_each('storage', STORAGES)
def test_a_missing_file_is_missed(is_listed, storage, sent, tmp_path):
    split = split_bag(tmp_path, sent, storage)
    (gone,) = split.glob('bag_1.*')
    if is_listed:
        gone.unlink()
    else:
        gone.rename(gone.with_stem('bag_2'))
        (split / 'metadata.yaml').unlink()
    with pytest.raises(LogError, match=rf'{gone.name} of the log .*bag_0.* is missing'):
        list(read_log(split))


@for_each('storage', STORAGES)
def test_files_are_put_in_the_order_they_are_listed(sent, storage, tmp_path):
    """Whatever they are called."""
    split = split_bag(tmp_path, sent, storage)
    for old, new in (('bag_0', 'night'), ('bag_1', 'day')):
        (file,) = split.glob(f'{old}.*')
        file.rename(file.with_stem(new))
    with_listed(
        split,
        lambda names: names.__setitem__(slice(None), [f'night{file.suffix}', f'day{file.suffix}']),
    )
    check(split, sent)


@for_each('storage', STORAGES)
def test_a_folder_of_several_logs_is_refused(sent, storage, tmp_path):
    split = split_bag(tmp_path, sent, storage)
    record(split / 'other.mcap', sent)
    with pytest.raises(LogError, match=r'holds bag_0.* and other.mcap.* name the first file of'):
        list(read_log(split))
    (split / 'metadata.yaml').unlink()
    with pytest.raises(LogError, match=r'different logs'):
        list(read_log(split))
    check(next(split.glob('bag_0.*')), sent)


def test_a_date_is_no_number_of_a_part(sent, tmp_path):
    for name in ('mission.mcap', 'mission_20261120.mcap'):
        record(tmp_path / name, sent)
        check(tmp_path / name, sent)


def test_a_folder_without_a_log_is_refused(tmp_path):
    with pytest.raises(LogError, match=r'holds no log'):
        list(read_log(tmp_path))
    with pytest.raises(LogError, match=r'holds no log'):
        is_finished(tmp_path)


def write_database(tmp_path, sent):
    return next(write_bag(tmp_path / 'bag', sent, 'sqlite3').glob('*.db3'))


@for_each(
    'changes',
    [
        ['DROP TABLE message_definitions', 'DROP TABLE schema', 'DROP TABLE metadata'],
        [
            'DROP TABLE message_definitions',
            'ALTER TABLE topics DROP COLUMN type_description_hash',
            'ALTER TABLE topics DROP COLUMN offered_qos_profiles',
        ],
    ],
)
def test_a_database_without_definitions_is_read_by_what_is_installed(sent, changes, tmp_path):
    database = write_database(tmp_path, sent)
    with sqlite3.connect(database) as connection:
        for change in changes:
            connection.execute(change)
    check(database, sent)


def test_a_database_that_does_not_say_the_quality_of_service_is_read_and_repaired(sent, tmp_path):
    database = write_database(tmp_path, sent)
    with sqlite3.connect(database) as connection:
        connection.executescript(
            """
            CREATE TABLE loose AS SELECT * FROM topics;
            DROP TABLE topics;
            ALTER TABLE loose RENAME TO topics;
            UPDATE topics SET offered_qos_profiles = NULL, type_description_hash = NULL;
            """
        )
    check(database, sent)
    assert repair(database, tmp_path / 'mission.mcap').messages == len(sent)
    check(tmp_path / 'mission.mcap', sent)


@for_each('column', ['name', 'serialization_format', 'offered_qos_profiles'])
def test_a_database_with_something_else_for_a_text_is_corrupt(tmp_path, column, sent):
    database = write_database(tmp_path, sent)
    with sqlite3.connect(database) as connection:
        connection.execute(f'UPDATE topics SET {column} = CAST({column} AS BLOB)')
    with pytest.raises(LogError, match='is corrupt near byte .* where texts should be'):
        list(read_log(database))
    with pytest.raises(LogError, match='has no message that could be saved'):
        repair(database, tmp_path / 'mission.mcap')


def test_a_type_that_is_defined_nowhere_is_an_error_only_when_asked_for(sent, tmp_path):
    database = write_database(tmp_path, sent)
    with sqlite3.connect(database) as connection:
        connection.execute('DROP TABLE message_definitions')
        connection.execute(
            "UPDATE topics SET type = 'no_such_msgs/msg/Path' WHERE name = '/belief'"
        )
    with pytest.raises(LogError, match='topic /belief is'):
        list(read_log(database))
    assert list(read_log(database, ['nav_msgs/msg/Path']))


KILLED = """
import os, sqlite3, sys
connection = sqlite3.connect(sys.argv[1])
connection.execute('PRAGMA journal_mode = WAL')
connection.execute('DELETE FROM messages WHERE id > 30')
connection.commit()
os.kill(os.getpid(), 9)
"""


@pytest.mark.processes
def test_a_database_whose_writer_was_killed_is_read_up_to_its_last_commit(sent, tmp_path):
    database = write_database(tmp_path, sent)
    subprocess.run([sys.executable, '-c', KILLED, database], check=False)
    assert not is_finished(database)
    assert [each.data for each in read_log(database)] == [each.data for each in sent[:30]]


def test_a_database_that_was_cut_is_unfinished_and_corrupt(sent, tmp_path):
    database = write_database(tmp_path, sent)
    content = database.read_bytes()
    for cut in range(16, len(content), 4099):
        database.write_bytes(content[:cut])
        assert not is_finished(database)
        with pytest.raises(LogError, match='is corrupt near byte'):
            list(read_log(database))


@for_each('storage', STORAGES)
def test_a_bag_becomes_a_log_by_repair(sent, tmp_path, storage):
    folder = write_bag(tmp_path / 'bag', sent, storage)
    repaired = repair(folder, tmp_path / 'mission.mcap')
    assert (repaired.messages, repaired.lost) == (len(sent), [])
    check(tmp_path / 'mission.mcap', sent)
