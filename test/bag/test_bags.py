# SPDX-License-Identifier: Apache-2.0
"""Bags by other programs are read and replayed like the mission's own log."""

from pathlib import Path
import re
import subprocess
import sys

from bags import write_bag
from kbnitp_ros.bag.reader import is_finished, LogError, read_log
from kbnitp_ros.bag.repair import repair
from kbnitp_ros.bag.writer import LogWriter
from kbnitp_ros.cli.demo import main as demo_command
from kbnitp_ros.cli.replay import main as replay_command
from kbnitp_ros.cli.report import main as report_command
from kbnitp_ros.log.replay import replay
from laws import for_each
from mission_log import record, record_to
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode
import yaml

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
def test_a_bag_is_read_by_its_folder_and_by_its_file(sent, tmp_path, version):
    folder = write_bag(tmp_path / 'bag', sent, version=version)
    check(folder, sent)
    (file,) = (each for each in folder.iterdir() if each.name != 'metadata.yaml')
    check(file, sent)


def test_compressed_chunks_are_read(sent, tmp_path):
    check(write_bag(tmp_path / 'bag', sent, compression=STORAGE_ZSTD), sent)


@for_each('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_what_rosbag2_compressed_is_refused(sent, tmp_path, mode):
    folder = write_bag(tmp_path / 'bag', sent, compression=(mode, CompressionFormat.ZSTD))
    with pytest.raises(LogError, match=r'bag is compressed, mode \w+: decompress it with ros2'):
        list(read_log(folder))


@for_each('mode', ['NONE', 'none'])
def test_a_bag_that_says_it_is_not_compressed_is_read(sent, tmp_path, mode):
    folder = write_bag(tmp_path / 'bag', sent)
    described = yaml.safe_load((folder / 'metadata.yaml').read_text())
    described['rosbag2_bagfile_information']['compression_mode'] = mode
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(described))
    check(folder, sent)


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


def split_bag(tmp_path, sent):
    """Return a bag of two files, as ``ros2 bag record`` names and lists them."""
    folder = tmp_path / 'bag'
    folder.mkdir()
    for number, half in enumerate((sent[:20], sent[20:])):
        made = write_bag(tmp_path / f'half_{number}', half)
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


def test_a_split_bag_is_read_by_its_folder_and_by_its_first_file(sent, tmp_path):
    split = split_bag(tmp_path, sent)
    check(split, sent)
    check(next(split.glob('bag_0.*')), sent)
    later = list(read_log(next(split.glob('bag_1.*'))))
    assert [each.data for each in later] == [each.data for each in sent[20:]]


def test_the_folder_may_be_part_of_a_listed_name(sent, tmp_path):
    """As in bags before Galactic."""
    split = split_bag(tmp_path, sent)
    with_listed(split, lambda names: names.__setitem__(slice(None), [f'bag/{n}' for n in names]))
    check(split, sent)


def test_a_recorder_that_was_killed_left_an_old_list(sent, tmp_path):
    split = split_bag(tmp_path, sent)
    with_listed(split, list.pop)
    check(split, sent)


@pytest.mark.slow
@for_each('left', [None, '', 'rosbag2_bagfile_information:\n  version: 9\n', '[a'])
def test_a_recorder_that_was_killed_left_no_list(sent, left, tmp_path):
    split = split_bag(tmp_path, sent)
    if left is None:
        (split / 'metadata.yaml').unlink()
    else:
        (split / 'metadata.yaml').write_text(left)
    check(split, sent)


def test_a_list_that_says_two_things_is_refused(sent, tmp_path):
    split = split_bag(tmp_path, sent)
    file = split / 'metadata.yaml'
    first, *lines = file.read_text().splitlines()
    file.write_text('\n'.join([first, lines[0], *lines]))
    (key,) = re.findall(r'(\w+):', lines[0])
    told = rf"metadata\.yaml: the key '{key}' stands in line 3 and in line 2"
    for path in (split, next(split.glob('bag_0.*'))):
        with pytest.raises(LogError, match=told):
            list(read_log(path))


@for_each('is_listed', [True, False])
def test_a_missing_file_is_missed(is_listed, sent, tmp_path):
    split = split_bag(tmp_path, sent)
    (gone,) = split.glob('bag_1.*')
    if is_listed:
        gone.unlink()
    else:
        gone.rename(gone.with_stem('bag_2'))
        (split / 'metadata.yaml').unlink()
    with pytest.raises(LogError, match=rf'{gone.name} of the log .*bag_0.* is missing'):
        list(read_log(split))


def test_files_are_put_in_the_order_they_are_listed(sent, tmp_path):
    """Whatever they are called."""
    split = split_bag(tmp_path, sent)
    for old, new in (('bag_0', 'night'), ('bag_1', 'day')):
        (file,) = split.glob(f'{old}.*')
        file.rename(file.with_stem(new))
    with_listed(
        split,
        lambda names: names.__setitem__(slice(None), [f'night{file.suffix}', f'day{file.suffix}']),
    )
    check(split, sent)


def test_a_folder_of_several_logs_is_refused(sent, tmp_path):
    split = split_bag(tmp_path, sent)
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


def test_a_bag_becomes_a_log_by_repair(sent, tmp_path):
    folder = write_bag(tmp_path / 'bag', sent)
    repaired = repair(folder, tmp_path / 'mission.mcap')
    assert (repaired.messages, repaired.lost) == (len(sent), [])
    check(tmp_path / 'mission.mcap', sent)


@pytest.mark.processes
def test_a_bag_of_sqlite_is_refused_with_what_converts_it(sent, tmp_path, capsys):
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
@for_each('damaged', [20, 35])
def test_commands_show_what_is_before_an_error_and_fail(sent, tmp_path, damaged, capsys):
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        record_to(log, sent, synced=True)
    content = bytearray(path.read_bytes())
    content[content.index(sent[damaged].data) + 20] ^= 1
    path.write_bytes(content)
    beliefs = sum(each.topic == '/belief' for each in read_log(path, None, []))
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
