# SPDX-License-Identifier: Apache-2.0
"""What is done stays done, and nothing else counts."""

from dataclasses import replace
import os

from disk import mounted, room_for
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import Trial
from kbnitp_ros.study.workers import Folder
import numpy as np
import pytest

TRIAL = Trial(0.9, 'kappa_bnitp', 1)


@pytest.fixture
def folder(tmp_path, scenario, results):
    """Return a folder with one trial done."""
    folder = Folder(tmp_path / 'made' / 'here', scenario)
    folder.save(TRIAL, results.outcomes[TRIAL])
    return folder


def the_file(tmp_path):
    (file,) = tmp_path.rglob('*.npz')
    return file


def test_a_trial_that_the_disk_has_no_room_for_is_named_and_run_again(folder, results, tmp_path):
    other = TRIAL._replace(number=2)
    with room_for(100), pytest.raises(OSError, match=r'File too large: .*trials/.*-2\.npz\.part'):
        folder.save(other, results.outcomes[TRIAL])
    assert list(folder.outcomes()) == [TRIAL]


@pytest.mark.processes
def test_a_disk_that_cannot_be_written_to_is_named(scenario, tmp_path):
    with mounted(tmp_path / 'disk', 'ro') as disk:
        path = disk / 'study'
        with pytest.raises(OSError, match=f'Read-only file system: {str(path)!r}'):
            Folder(path, scenario)


def test_an_outcome_is_kept_to_the_last_bit(folder, results):
    outcomes = folder.outcomes()
    assert list(outcomes) == [TRIAL]
    for kept, given in zip(outcomes[TRIAL], results.outcomes[TRIAL], strict=True):
        assert kept.dtype == given.dtype
        assert np.array_equal(kept, given, equal_nan=kept.dtype == float)


@pytest.mark.slow
def test_a_trial_that_is_damaged_does_not_count(folder, tmp_path, results):
    """Or the damage is where nothing of the trial stands."""
    file = the_file(tmp_path)
    content = file.read_bytes()
    for length in (0, 1, 30, len(content) // 2, len(content) - 1):
        file.write_bytes(content[:length])
        assert folder.outcomes() == {}
    undamaged = [array.tobytes() for array in results.outcomes[TRIAL]]
    heads = [at for at in range(len(content)) if content.startswith(b'PK', at)]
    # Names, sizes and kinds of what is in the file stand near these.
    places = {at + offset for at in heads for offset in range(110)} | {*range(0, len(content), 61)}
    noticed = 0
    for at in sorted(places & {*range(len(content))}):
        for flipped in (1, 0x80):
            damaged = bytes([content[at] ^ flipped])
            after = at + 1
            file.write_bytes(content[:at] + damaged + content[after:])
            found = folder.outcomes()
            noticed += not found
            for outcome in found.values():
                assert [array.tobytes() for array in outcome] == undamaged
    assert noticed > len(places)
    file.rename(f'{file}.part')
    assert folder.outcomes() == {}


def test_a_trial_of_another_shape_does_not_count(folder, results):
    outcome = results.outcomes[TRIAL]
    for other in (
        outcome._replace(measures=outcome.measures[:-1]),
        outcome._replace(believed=outcome.believed.ravel()),
        outcome._replace(truth=outcome.believed),
        outcome._replace(learnt=outcome.learnt[:, 1:]),
        outcome._replace(numbers=outcome.numbers[1:]),
    ):
        folder.save(TRIAL, other)
        assert folder.outcomes() == {}


def test_a_trial_that_cannot_be_opened_is_told(folder, tmp_path):
    file = the_file(tmp_path)
    file.unlink()
    file.mkdir()
    with pytest.raises(OSError, match=r'Is a directory: .*\.npz'):
        folder.outcomes()


@pytest.mark.parametrize('change, complaint', [
    ({'robots': 5}, 'robots 4 and not 5'),
    ({'lethalities': (0.2, 0.8)}, r'lethalities \(0.2, 0.9\) and not \(0.2, 0.8\)'),
    ({'believed_lethality': 1.0}, 'believed_lethality None and not 1.0'),
])  # fmt: skip
def test_the_folder_of_another_scenario_is_refused(folder, tmp_path, scenario, change, complaint):
    with pytest.raises(ValueError, match=f'here holds results of another scenario.*{complaint}'):
        Folder(tmp_path / 'made' / 'here', replace(scenario, **change))


def test_more_trials_are_added_to_those_that_are_done(folder, tmp_path, scenario, results):
    done = folder.outcomes()
    # Its process ended.
    os.close(folder._lock)
    more = Folder(tmp_path / 'made' / 'here', replace(scenario, trials=4))
    assert more.outcomes().keys() == done.keys()
    fourth = Trial(0.2, 'kappa_bnitp', 3)
    more.save(fourth, results.outcomes[TRIAL])
    assert more.outcomes().keys() == {*done, fourth}


def test_trials_of_an_unknown_scenario_are_refused(tmp_path, scenario):
    tmp_path.joinpath('trials').mkdir()
    with pytest.raises(ValueError, match='unknown scenario.*another folder'):
        Folder(tmp_path, scenario)


def test_the_folder_of_a_mission_is_refused(tmp_path, scenario):
    tmp_path.joinpath('mission.mcap').touch()
    with pytest.raises(ValueError, match='holds a mission: name another folder'):
        Folder(tmp_path, scenario)


def test_two_studies_do_not_work_in_one_folder(folder, tmp_path, scenario):
    with pytest.raises(ValueError, match='another study at work'):
        Folder(tmp_path / 'made' / 'here', scenario)


def test_a_file_is_no_folder(tmp_path, scenario):
    tmp_path.joinpath('file').write_text('')
    with pytest.raises(OSError, match='file'):
        Folder(tmp_path / 'file', scenario)


def test_the_trials_of_teams_are_kept_apart(tmp_path, scenario, results):
    scenario = replace(scenario, teams=(Strategy(), Strategy(2), Strategy(2, loss_cost=0.1)))
    folder = Folder(tmp_path / 'teams', scenario)
    done = [TRIAL, TRIAL._replace(team=Strategy(2))]
    for trial in done:
        folder.save(trial, results.outcomes[TRIAL])
    assert list(folder.outcomes()) == done
