# SPDX-License-Identifier: Apache-2.0
"""What is intact of a log becomes a finished file."""

from disk import room_for
from kbnitp_ros.cli.replay import main
from kbnitp_ros.log.files import parts_of
from kbnitp_ros.log.mcap_file import repair
from kbnitp_ros.log.read import is_finished, read_metadata, read_part, RecordedMessage
from kbnitp_ros.log.schema import BagFile, write_metadata
from kbnitp_ros.log.write import LogWriter
from laws import for_each
from mission_log import record, record_to
from other_readers import check_all_read
import pytest


@pytest.fixture
def folder(whole_mission, tmp_path):
    """Return a folder with a log in three parts, the second of which was never finished."""
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
    """Return all that is said of the messages of some files, but where they stand."""
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
    repaired = repair(folder, target)
    assert repaired.messages == len(whole_mission.sent)
    assert repaired.lost == [f'{folder / "mission_1.mcap"} is unfinished']
    assert is_finished(target)
    assert content(target) == content(*parts_of(folder))
    assert read_metadata(target)['run'] == {'seed': '8'}
    check_all_read(target)
    # A log that is named by its folder may be repaired into it.
    parts = content(*parts_of(folder))
    repair(folder, folder / 'whole.mcap')
    assert content(folder / 'whole.mcap') == parts


@for_each('name, told', [
    ('mission.mcap', 'mission.mcap'),
    ('x.db3', "x.db3' is no name for a log: it must end in .mcap"),
    ('mission_3.mcap', 'would be taken for a part'),
])  # fmt: skip
def test_a_bad_target_is_refused_and_what_is_there_is_kept(folder, capsys, name, told):
    before = {file: file.read_bytes() for file in folder.iterdir()}
    assert main([str(folder), '--repair', str(folder / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_a_disk_that_has_no_room_is_left_without_the_file(folder, tmp_path):
    target = tmp_path / 'repaired' / 'mission.mcap'
    target.parent.mkdir()
    with room_for(10_000), pytest.raises(OSError, match=f'File too large: {str(target)!r}'):
        repair(folder, target)
    assert list(target.parent.iterdir()) == []


def test_a_log_that_cannot_be_described_is_not_left_half_repaired(folder, tmp_path):
    target = tmp_path / 'repaired' / 'mission.mcap'
    # In the place of what is to be written.
    target.parent.joinpath('mission.mcap.metadata.yaml.new').mkdir(parents=True)
    with pytest.raises(OSError, match=r'metadata\.yaml\.new'):
        repair(folder, target)
    assert not target.exists()


def test_a_disk_that_has_no_room_for_the_description_keeps_the_old_one(folder):
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


def test_what_comes_before_an_error_is_saved_of_each_part(folder, whole_mission, tmp_path):
    path = folder / 'mission.mcap'
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(whole_mission.sent[10].data) + 20] ^= 1
    path.write_bytes(damaged)
    kept = len([each for each in read_part(path, []) if isinstance(each, RecordedMessage)])
    assert kept == 10
    later = len(content(*parts_of(folder)[1:]))
    repaired = repair(folder, tmp_path / 'repaired.mcap')
    assert repaired.messages == kept + later
    assert repaired.lost[0] == f'{folder / "mission_1.mcap"} is unfinished'
    assert repaired.lost[1].startswith(f'{path} is corrupt after byte')
    assert is_finished(tmp_path / 'repaired.mcap')


@for_each('cut', [0, 5, 8, 100])
def test_nothing_is_made_of_nothing(whole_mission, tmp_path, cut, capsys):
    path = record(tmp_path / 'mission.mcap', whole_mission.sent)
    path.write_bytes(path.read_bytes()[:cut])
    assert main([str(path), '--repair', str(tmp_path / 'repaired.mcap')]) == 2
    assert 'mission.mcap has no message that could be saved' in capsys.readouterr().err
    assert not (tmp_path / 'repaired.mcap').exists()
