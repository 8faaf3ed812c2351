# SPDX-License-Identifier: Apache-2.0
"""The journal of a robot after power loss, corruption, or a mix-up."""

from copy import deepcopy
import os
from pathlib import Path

from disk import mounted, room_for
from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import Grid
from kbnitp_ros.robot.journal import Journal, JournaledDeployment, Step
from laws import for_each
import pytest

GRID = Grid(4, 3, blocked=[5])
ORDERS = (0, 1, 2, 1, 0)

DOINGS = st.lists(st.integers(0, 5), max_size=30)


def opened(path, agent='scout_1', grid=GRID):
    return Journal(path, agent, grid)


def live(journal, doings):
    """Apply events as far as possible; yield the recorded state after each line."""
    deployment = None
    for number, doing in enumerate(doings):
        if deployment is None:
            deployment = JournaledDeployment(1000 + number, 7, ORDERS)
            journal.depart(deployment)
        elif doing == 0:
            journal.arrive(deployment, number)
            deployment = None
        elif doing < 4 or not deployment.steps or deployment.steps[-1].reading == 1:
            deployment.steps.append(Step(doing, number))
            journal.step(deployment, len(deployment.steps))
        else:
            deployment.steps[-1].reading += 1
            journal.step(deployment, len(deployment.steps))
        yield deepcopy(journal.deployments)


def reopened(path):
    journal = opened(path)
    journal.close()
    return journal


@pytest.mark.slow
@given(doings=DOINGS, data=st.data())
@settings(max_examples=100 if FULL else 40)
def test_a_power_loss_at_any_byte_loses_at_most_the_unsynced_line(tmp_path_factory, doings, data):
    path = tmp_path_factory.mktemp('journal') / 'journal'
    journal = opened(path)
    states, ends = [[]], [path.stat().st_size]
    for state in live(journal, doings):
        states.append(state)
        ends.append(path.stat().st_size)
    journal.close()
    content = path.read_bytes()
    end = data.draw(st.integers(0, len(content)))
    lines = sum(each <= end for each in ends)
    # The end of a torn line may be blocks that were allocated but never written.
    path.write_bytes(content[:end] + bytes(data.draw(st.integers(0, 50))))
    journal = reopened(path)
    assert journal.deployments == states[max(lines - 1, 0)]
    if lines:
        assert path.read_bytes() == content[: ends[lines - 1]]
    else:
        # The journal begins anew, with another identifier.
        assert path.read_bytes().count(b'\n') == 1
        assert path.stat().st_size == ends[0]
    # The robot resumes from it.
    journal = opened(path)
    assert not journal.corruption
    deployment = JournaledDeployment(9999, 7, ORDERS)
    # A line that was torn is one that nobody acted on.
    assert not journal.may_lack(deployment)
    journal.depart(deployment)
    journal.close()
    assert reopened(path).deployments == [*states[max(lines - 1, 0)], deployment]


@pytest.mark.slow
@given(doings=DOINGS, data=st.data())
@settings(max_examples=100 if FULL else 40)
def test_lines_after_corruption_are_cut_off_and_kept_beside(tmp_path_factory, doings, data):
    path = tmp_path_factory.mktemp('journal') / 'journal'
    journal = opened(path)
    states = [[], *live(journal, doings)]
    journal.close()
    content = bytearray(path.read_bytes())
    heading = content.index(b'\n') + 1
    if len(content) == heading:
        return
    place = data.draw(st.integers(heading, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    journal = reopened(path)
    whole = bytes(content[:place]).count(b'\n') - 1
    assert journal.deployments == states[whole]
    assert str(path) in journal.corruption
    kept = [each for each in path.parent.iterdir() if 'corrupt' in each.name]
    # A deployment may have been cut off, until the next one is recorded.
    lost = JournaledDeployment(9999, 7, ORDERS)
    assert journal.may_lack(lost) == bool(kept)
    whole_lines = path.read_bytes()
    if kept:
        whole_lines = whole_lines[: whole_lines.rindex(b'\n', 0, -1) + 1]
    journal = opened(path)
    assert not journal.corruption
    assert journal.may_lack(lost) == bool(kept)
    assert journal.may_lack(JournaledDeployment(9999, 8, ORDERS)) == bool(kept and not whole)
    journal.depart(lost)
    assert not journal.may_lack(lost)
    journal.close()
    assert not reopened(path).may_lack(lost)
    together = whole_lines + (kept[0].read_bytes() if kept else b'')
    # A torn last line is not kept: nobody has acted on it.
    assert bytes(content).startswith(together)
    cut = bytes(content).removeprefix(together)
    assert kept or b'\n' not in cut
    assert bool(kept) == (len(together) == len(content))


def test_a_journal_of_another_robot_is_refused_by_name(tmp_path):
    path = tmp_path / 'folder' / 'journal'
    opened(path).close()
    content = path.read_bytes()
    with pytest.raises(ValueError, match=r'folder/journal was written with agent "scout_1", and'):
        opened(path, 'scout_2')
    assert path.read_bytes() == content


def test_a_journal_of_another_field_is_kept_in_the_folder_of_its_mission(tmp_path):
    path = tmp_path / 'journal'
    kept = []
    fields = (GRID, Grid(5, 3, blocked=[5]), Grid(4, 3, blocked=[6]), Grid(4, 3, yaw=0.1))
    for number, grid in enumerate(fields):
        journal = opened(path, grid=grid)
        assert not journal.deployments
        assert {each.read_bytes() for each in tmp_path.glob('7/*')} == set(kept)
        deployment = JournaledDeployment(number + 1, 7, (0, 1, 0), 1)
        journal.depart(deployment)
        content = path.read_bytes()
        journal.close()
        # A robot in flight is in that field.
        with pytest.raises(ValueError, match=r'was written with grid .*this node has '):
            opened(path, grid=Grid(6, 6))
        assert path.read_bytes() == content
        journal = opened(path, grid=grid)
        journal.arrive(journal.deployments[-1], 2)
        journal.close()
        kept.append(path.read_bytes())


def test_each_journal_has_an_identifier_of_its_own(tmp_path):
    path, other = tmp_path / 'journal', tmp_path / 'other'
    journal = opened(path)
    known = journal.id
    assert len(known) == 32
    assert set(known) <= set('0123456789abcdef')
    assert reopened(other).id != known
    journal.depart(JournaledDeployment(1, 7, ORDERS, 1))
    journal.arrive(journal.deployments[-1], 2)
    journal.close()
    assert reopened(path).id == known
    # The journal of the next mission is another one.
    journal = opened(path)
    journal.begin(8)
    assert journal.id != known
    journal.close()
    kept = reopened(tmp_path / '7' / 'journal')
    assert kept.id == known


# First line and a deployment of a journal of kbnitp_ros 1.9.
OF_1_9 = (
    b'ac4f8fc2 {"journal":2,"agent":"scout_1","grid":{"width":4,"height":3,"base":0,'
    b'"resolution":1.0,"origin":[0.0,0.0],"connectivity":8,"through_corners":true,'
    b'"blocked":"ef2d127de37b942b"}}\n'
    b'60c58b9b {"deployment":1000,"mission":7,"orders":[0,1,2,1,0],"departed":1001}\n'
)


def test_a_journal_of_an_earlier_version_is_refused_by_version_and_left_alone(tmp_path):
    path = tmp_path / 'journal'
    path.write_bytes(OF_1_9)
    with pytest.raises(ValueError, match='is of version 2, and this node reads version 3') as told:
        opened(path)
    assert 'kbnitp_ros that wrote it (1.9 or earlier), or move it away' in str(told.value)
    assert path.read_bytes() == OF_1_9
    assert [*tmp_path.iterdir()] == [path]


def test_nothing_is_written_to_a_journal_that_was_deleted(tmp_path):
    path = tmp_path / 'journal'
    journal = opened(path)
    path.unlink()
    with pytest.raises(FileNotFoundError, match=f'The file was deleted: {str(path)!r}'):
        journal.depart(JournaledDeployment(1, 7, ORDERS))
    assert not journal.deployments
    journal.close()


@for_each(
    'content',
    [b'my letters\n', b'my letters', b'letters', b'\n', b'x' * 100, b'0123abcd {"journal":1,'],
)
def test_other_files_are_refused_and_left_alone(tmp_path, content):
    path = tmp_path / 'letters'
    path.write_bytes(content)
    with pytest.raises(ValueError, match='letters is not the journal of a robot'):
        opened(path)
    assert path.read_bytes() == content


def test_two_processes_never_write_one_journal(tmp_path):
    journal = opened(tmp_path / 'journal')
    with pytest.raises(ValueError, match='in use by another process'):
        opened(tmp_path / 'journal')
    journal.close()
    opened(tmp_path / 'journal').close()


def test_a_full_disk_loses_no_recorded_line(tmp_path):
    path = tmp_path / 'journal'
    journal = opened(path)
    deployment = JournaledDeployment(1, 7, ORDERS)
    journal.depart(deployment)
    size = path.stat().st_size
    refused = f'File too large: {str(path)!r}'
    # Part of the next line fits.
    with room_for(size + 10):
        for number in range(3):
            deployment.steps.append(Step(number, number, 1))
            with pytest.raises(OSError, match=refused):
                journal.step(deployment, len(deployment.steps))
            assert path.stat().st_size == size
        with pytest.raises(OSError, match=refused):
            journal.arrive(deployment, 9)
        with pytest.raises(OSError, match=refused):
            journal.depart(JournaledDeployment(2, 7, ORDERS))
    assert len(journal.deployments) == 1
    # With room again, pending lines are written in order.
    journal.write()
    journal.close()
    (known,) = reopened(path).deployments
    assert known == deployment
    assert known.is_home


@pytest.mark.processes
def test_a_disk_that_cannot_be_written_to_is_named(tmp_path):
    with mounted(tmp_path / 'disk', 'ro') as folder:
        path = folder / 'journal'
        with pytest.raises(OSError, match=f'Read-only file system: {str(path)!r}'):
            opened(path)


def test_every_line_is_on_the_disk_before_the_robot_goes_on(tmp_path, monkeypatch):
    synced = {}
    fsync = os.fsync

    def keep(descriptor):
        fsync(descriptor)
        synced[str(Path(f'/proc/self/fd/{descriptor}').readlink())] = os.fstat(descriptor).st_size

    monkeypatch.setattr(os, 'fsync', keep)
    path = tmp_path / 'journal'
    journal = opened(path)
    assert str(tmp_path) in synced
    for _ in live(journal, [1, 1, 4, 4, 2, 0, 1, 0]):
        assert synced[str(path)] == path.stat().st_size
    journal.close()
