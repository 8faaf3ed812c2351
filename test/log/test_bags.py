# SPDX-License-Identifier: Apache-2.0
"""Bags of other programs are read and replayed like the mission's own log."""

from functools import partial
from itertools import product
from pathlib import Path
import shutil
import subprocess
import sys

from kbnitp_ros.cli.demo import main as demo_command
from kbnitp_ros.cli.replay import main as replay_command
from kbnitp_ros.cli.report import main as report_command
from kbnitp_ros.log.read import is_finished, LogError, read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.write import LogWriter
from laws import for_each
from mission_log import record, record_to
from other_readers import write_bag
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode
import yaml

STORAGE_ZSTD = CompressionMode.STORAGE, CompressionFormat.ZSTD


@pytest.fixture(scope='module')
def sent(whole_mission):
    return whole_mission.sent


def check(path, sent):
    """Check that all messages are read and that the log replays."""
    read = list(read_log(path))
    assert [(each.topic, each.type_name, each.log_time, each.data) for each in read] == [
        (message.topic, message.type_name, message.time + 500, message.data) for message in sent
    ]
    assert is_finished(path)
    report = replay(path)
    assert report.reproduced
    assert report.finished
    assert report.compared['/belief'] == sum(each.topic == '/belief' for each in sent)
    assert len(report.evidence.standings) == 8


def split_bag(tmp_path, sent):
    """Return a bag of two files, named and listed like by ``ros2 bag record``."""
    folder = tmp_path / 'bag'
    folder.mkdir()
    for number, half in enumerate((sent[:20], sent[20:])):
        made = write_bag(tmp_path / f'half_{number}', half)
        (file,) = made.glob('*.mcap')
        file.rename(folder / f'bag_{number}.mcap')
    shutil.copy(made / 'metadata.yaml', folder)
    return described(folder, relative_file_paths=['bag_0.mcap', 'bag_1.mcap'])


def described(folder, **values):
    """Change the metadata.yaml of a bag."""
    path = folder / 'metadata.yaml'
    content = yaml.safe_load(path.read_text())
    content['rosbag2_bagfile_information'].update(values)
    path.write_text(yaml.safe_dump(content))
    return folder


def renamed(folder):
    for old, new in (('bag_0', 'night'), ('bag_1', 'day')):
        folder.joinpath(f'{old}.mcap').rename(folder / f'{new}.mcap')
    return described(folder, relative_file_paths=['night.mcap', 'day.mcap'])


def with_list(left):
    """Return a change: a killed recorder left this list of files, or none."""

    def change(folder):
        if left is None:
            (folder / 'metadata.yaml').unlink()
        else:
            (folder / 'metadata.yaml').write_text(left)
        return folder

    return change


@pytest.mark.slow
@for_each(
    'options, mode',
    product([{'version': 8}, {'version': 9}, {'compression': STORAGE_ZSTD}], ['NONE', 'none', '']),
    every=4,
)
def test_a_bag_is_read_by_its_folder_and_by_its_file(sent, tmp_path, options, mode):
    folder = write_bag(tmp_path / 'bag', sent, **options)
    check(described(folder, compression_mode=mode), sent)
    (file,) = folder.glob('*.mcap')
    check(file, sent)


@pytest.mark.slow
@for_each('change', [
    described,
    renamed,
    # Like bags before Galactic.
    partial(described, relative_file_paths=['bag/bag_0.mcap', 'bag/bag_1.mcap']),
    # By a recorder that was killed.
    partial(described, relative_file_paths=['bag_0.mcap']),
    *map(with_list, [None, '', 'rosbag2_bagfile_information:\n  version: 9\n', '[a']),
], every=2)  # fmt: skip
def test_a_split_bag_is_read_by_its_folder_and_by_its_first_file(sent, tmp_path, change):
    split = change(split_bag(tmp_path, sent))
    check(split, sent)
    if change is not renamed:
        check(split / 'bag_0.mcap', sent)
        later = list(read_log(split / 'bag_1.mcap'))
        assert [each.data for each in later] == [message.data for message in sent[20:]]


def repeat_a_key(folder):
    file = folder / 'metadata.yaml'
    first, *lines = file.read_text().splitlines()
    file.write_text('\n'.join([first, lines[0], *lines]))


def hide_a_file(folder):
    (folder / 'bag_1.mcap').rename(folder / 'bag_2.mcap')
    (folder / 'metadata.yaml').unlink()


def add_a_log(folder):
    record(folder / 'other.mcap', [])


def add_a_log_without_a_list(folder):
    add_a_log(folder)
    (folder / 'metadata.yaml').unlink()


@for_each('change, told', [
    (repeat_a_key, r"metadata\.yaml: the key '\w+' appears in line 3 and in line 2"),
    (lambda folder: (folder / 'bag_1.mcap').unlink(), 'bag_1.mcap of the log .*bag_0.* missing'),
    (lambda folder: (folder / 'bag_0.mcap').rename(folder / 'x.mcap'), 'yaml lists, is missing'),
    (hide_a_file, 'bag_1.mcap of the log .*bag_0.* missing'),
    (add_a_log, 'holds bag_0.* and other.mcap.* name the first file of'),
    (add_a_log_without_a_list, 'different logs'),
    (lambda folder: [file.unlink() for file in folder.iterdir()], 'holds no log'),
    (partial(described, compression_mode='FILE'), 'compressed, mode FILE: decompress it with'),
])  # fmt: skip
def test_a_bag_that_cannot_be_read_whole_is_refused(sent, tmp_path, change, told):
    split = split_bag(tmp_path, sent)
    change(split)
    for read in (read_log, lambda path: [is_finished(path)]):
        with pytest.raises(LogError, match=told):
            list(read(split))


@for_each('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_bags_compressed_by_rosbag2_are_refused(sent, tmp_path, mode):
    folder = write_bag(tmp_path / 'bag', sent, compression=(mode, CompressionFormat.ZSTD))
    with pytest.raises(LogError, match=r'bag is compressed, mode \w+: decompress it with ros2'):
        list(read_log(folder))


def convert(folder, target):
    """Convert a bag to MCAP as a user does; return the new one."""
    command = Path(sys.executable).with_name('rosbags-convert')
    subprocess.run(
        [command, '--src', folder, '--dst', target, '--dst-storage', 'mcap'], check=True
    )
    return target


@pytest.mark.processes
def test_a_log_converted_by_rosbags_is_read(sent, tmp_path):
    folder = tmp_path / 'recorded'
    folder.mkdir()
    record(folder / 'mission.mcap', sent)
    check(convert(folder, tmp_path / 'converted'), sent)


def test_a_date_is_not_a_part_number(sent, tmp_path):
    for name in ('mission.mcap', 'mission_20261120.mcap'):
        record(tmp_path / name, sent)
        check(tmp_path / name, sent)


@pytest.mark.processes
def test_an_sqlite_bag_is_refused_with_the_conversion_command(sent, tmp_path, capsys):
    folder = write_bag(tmp_path / 'bag', sent, 'sqlite3')
    told = f'{folder / "bag.db3"} is a SQLite bag: convert it to MCAP with ros2 bag convert'
    out = ['--out', str(tmp_path / 'page')]
    for path in map(str, (folder, folder / 'bag.db3')):
        assert replay_command([path]) == report_command([path, *out]) == 2
        for line in capsys.readouterr().err.splitlines():
            assert told in line
        with pytest.raises(LogError, match='bag.db3 is no MCAP file'):
            LogWriter(path, resume=True)
    check(convert(folder, tmp_path / 'converted'), sent)


@pytest.mark.slow
@for_each('damaged', [20, 35], every=2)
def test_commands_show_messages_before_an_error_and_fail(sent, tmp_path, damaged, capsys):
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        record_to(log, sent, synced=True)
    content = bytearray(path.read_bytes())
    content[content.index(sent[damaged].data) + 20] ^= 1
    path.write_bytes(content)
    beliefs = sum(message.topic == '/belief' for message in read_log(path, None, []))
    assert 1 < beliefs < 9
    assert replay_command([str(path)]) == 2
    said = capsys.readouterr()
    assert f'/belief: {beliefs} of {beliefs} messages reproduced' in said.out
    assert 'is corrupt after byte' in said.err
    assert report_command([str(path), '--out', str(tmp_path / 'page')]) == 2
    said = capsys.readouterr()
    assert 'is corrupt after byte' in said.err
    page = (tmp_path / 'page/report.html').read_text()
    assert 'is corrupt after byte' in page
    with pytest.raises(LogError, match='is corrupt after byte'):
        LogWriter(path, resume=True)
    assert demo_command(['--resume', str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f'demo: {path} is corrupt after byte')
    assert path.read_bytes() == content


def test_parts_named_by_rosbag2_from_033_on_are_read_without_metadata(tmp_path, sent, capsys):
    """The recording computer lost its power before it wrote metadata.yaml."""
    folder, third = tmp_path / 'bag', len(sent) // 3
    folder.mkdir()
    rest = sent[third:]
    parts = (sent[:third], rest[:third], rest[third:])
    for number, part in enumerate(parts):
        (file,) = write_bag(tmp_path / f'part_{number}', part).glob('*.mcap')
        file.rename(folder / f'{number}_mission_2026_03_01-10_0{number}_00.mcap')
    first, second, _ = sorted(folder.iterdir())
    for path in (folder, first):
        check(path, sent)
    assert replay_command([str(folder)]) == 0
    capsys.readouterr()
    assert len(list(read_log(second))) == third
    replay_command([str(second)])
    assert f'{second} is one file of several of a log: name the folder' in capsys.readouterr().err
    second.rename(tmp_path / second.name)
    with pytest.raises(LogError, match='part 1 of the log .*0_mission.* is missing: restore it'):
        list(read_log(folder))
    shutil.copy(tmp_path / second.name, folder)
    shutil.copy(first, folder / '0_mission_2026_03_02-10_00_00.mcap')
    with pytest.raises(LogError, match='which belong to different logs'):
        list(read_log(folder))
