# SPDX-License-Identifier: Apache-2.0
"""Reports agree with the log, for every kind of log, and are written whole or not at all."""

from itertools import pairwise
import re
import resource
import subprocess
import sys

from kbnitp_ros.cli.report import main
from kbnitp_ros.configuration import make_estimator, node_parameters
from kbnitp_ros.core import Belief, Grid, log_loss, Observation, path_information
from kbnitp_ros.log.history import read_history
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.maps import quantise_belief, read_probabilities
from kbnitp_ros.messages.topics import BELIEF
from kbnitp_ros.report import page
from kbnitp_ros.report.facts import mission_facts
from kbnitp_ros.report.mission import read_summary
from kbnitp_ros.report.tables import COLUMNS, mission_curves, rows
from laws import for_each
from mission_log import GRID, Mission, MODEL, on, record, record_to, without
from missions import sent_by_single, Shown, single, team
import numpy as np
import pandas
import pytest

NAMES = ('hazard', 'target', 'kappa')

FILES = {
    'report.html',
    'deployments.csv', 'belief.npz', 'hazard.yaml', 'hazard.pgm', 'target.yaml', 'target.pgm',
    'kappa.yaml', 'kappa.pgm', 'said.csv', 'said.geojson',
}  # fmt: skip


def report(log, out):
    assert main([str(log), '--out', str(out)]) == 0
    return {file.name for file in out.iterdir()}


def told(log):
    """Return mission, curves, page and table of a log, without pictures."""
    mission = read_summary(log)
    curves = mission_curves(mission)
    html, left_out = page.mission_page(mission, curves)
    assert not left_out
    return mission, curves, html, rows(mission, curves)


@pytest.fixture(scope='module')
def shown(tmp_path_factory):
    folder = tmp_path_factory.mktemp('single')
    log = single(folder / 'mission.mcap')
    report(log, folder / 'out')
    return log, folder / 'out'


@pytest.mark.slow
def test_a_single_robot(shown):
    log, out = shown
    assert {file.name for file in out.iterdir()} == FILES
    mission = read_summary(log)
    assert [moment.held for moment in mission.moments] == list(range(7))
    assert all(one.time < other.time for one, other in pairwise(mission.moments))
    assert [each.deployment for each in mission.moments] == [None, *range(6)]
    assert [deployment.moment for deployment in mission.deployments] == list(range(1, 7))
    assert mission.notes == []
    assert mission.world is not None


def test_the_arrays_are_the_beliefs_on_record(shown):
    log, out = shown
    beliefs = read_history(log).beliefs
    with np.load(out / 'belief.npz') as arrays:
        assert arrays['joint'].tobytes() == np.stack([b.joint for b in beliefs]).tobytes()
        assert np.array_equal(arrays['kappa'][-1], beliefs[-1].kappa)
        world = read_history(log).world
        assert np.array_equal(arrays['true_hazard'], world.hazard)
        assert arrays['hazard_loss'][3] == log_loss(beliefs[3].hazard, world.hazard)


def test_the_tables_agree_with_the_arrays_and_the_log(shown):
    log, out = shown
    # Whole numbers may be missing, as for robots in flight.
    types = {name: kind.replace('int64', 'Int64') for name, kind in COLUMNS.items()}
    read = pandas.read_csv(out / 'deployments.csv', dtype=types, float_precision='round_trip')
    assert list(read) == list(COLUMNS)
    table = read.to_dict('records')
    mission = read_summary(log)
    for row, deployment in zip(table, mission.deployments, strict=True):
        assert row['path'] == ' '.join(map(str, deployment.path))
        assert row['outcome'] == ('returned' if deployment.outcome.survived else 'lost')
        before, after = (mission.moments[row['moment'] + each].belief for each in (-1, 0))
        assert row['information_expected'] == path_information(before, MODEL, deployment.path)
        gained = before.joint_entropy() - after.joint_entropy()
        assert row['information_gained'] == pytest.approx(gained, abs=1e-12)
        assert row['entropy'] == pytest.approx(after.entropy())
    assert {row['outcome'] for row in table} == {'returned', 'lost'}


def test_the_last_belief_can_be_the_prior_of_another_mission(shown):
    log, out = shown
    mission = read_summary(log)
    values = {name: each.default for name, each in node_parameters('estimator').items()}
    values |= {f'prior.{name}_map': str(out / f'{name}.yaml') for name in NAMES}
    values['learn.numbers'] = ()
    begun = make_estimator(values, mission.grid).belief
    for name in NAMES:
        believed = getattr(mission.moments[-1].belief, name)
        read = read_probabilities(out / f'{name}.yaml', mission.grid, 0.5)
        assert np.abs(read - believed).max() <= 1 / 255
        certain = (
            believed if name != 'kappa' else np.where(begun.hazard > 0, believed, begun.kappa)
        )
        assert np.abs(getattr(begun, name) - certain).max() <= 1 / 255 + 1e-6


@for_each('seed', range(5))
def test_every_belief_has_maps_that_are_a_belief(seed, tmp_path):
    """Also where hazard and target exclude each other's rounding."""
    rng = np.random.default_rng(seed)
    joint = rng.dirichlet([0.05] * 4, size=20_000)
    joint[:4] = np.eye(4)
    belief = Belief(joint.reshape(-1, 2, 2))
    levels = quantise_belief(belief)
    for name, each in levels.items():
        assert np.abs(each / 255 - getattr(belief, name)).max() <= 1 / 255
    Belief.from_maps(*((1.0 - (255 - each) / 255) for each in levels.values()))


def test_a_team_of_eight_with_silent_losses_and_late_returns(tmp_path):
    log, whole = team(tmp_path / 'mission.mcap')
    mission, curves, _, _ = told(log)
    late = [moment for moment in mission.moments if moment.is_late]
    assert late
    assert all(each.outcome.survived for each in late)
    assert len(mission.moments) == len(mission.deployments) + len(late) + 1 == 25 + len(late)
    assert mission.moments[-1].belief.joint.tobytes() == whole.ledger.belief.joint.tobytes()
    assert np.isnan(curves.expected[[each.is_late for each in mission.moments]]).all()
    assert curves.lost[-1] == sum(not each.survived for each in mission.ended)
    assert (np.diff(curves.lost) == -1).sum() == len(late)
    # The whole round is in flight before its first report, seven after it.
    assert curves.out[:9].tolist() == [0, 7, 6, 5, 4, 3, 2, 1, 0]
    assert curves.joint_entropy[0] - curves.joint_entropy[-1] == pytest.approx(
        np.nansum(curves.gained)
    )


def test_an_unfinished_log(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        record_to(log, sent_by_single().sent[:20], synced=True)
        mission, _, html, _ = told(log.path)
    assert 1 < len(mission.moments) < 7
    assert 'The log is unfinished' in html


def test_robots_in_flight_at_the_end(tmp_path):
    whole = sent_by_single(3)
    whole.send_out(whole.walk().path)
    log = record(tmp_path / 'mission.mcap', whole.sent)
    _, _, html, (*_, row) = told(log)
    assert '1 robot was in flight' in html
    assert row['outcome'] == 'out'
    assert row['told'] is row['moment'] is row['entropy'] is None


@pytest.mark.slow
def test_a_log_with_no_truth(tmp_path):
    log = single(tmp_path / 'mission.mcap', with_truth=False)
    assert report(log, tmp_path / 'out') == FILES
    mission, curves, _, _ = told(log)
    facts = mission_facts(mission, curves, np.arange(7))
    assert facts['truth'] is None
    assert not {'hazard_loss', 'target_loss', 'log_loss'} & facts['curves'].keys()
    assert np.isnan(curves.hazard_loss).all()


@pytest.mark.full
def test_a_thousand_deployments_in_900_cells(tmp_path):
    log = single(tmp_path / 'mission.mcap', 1000, grid=Grid(30, 30))
    assert report(log, tmp_path / 'out') == FILES
    assert (tmp_path / 'out/report.html').stat().st_size < 15_000_000
    assert len(pandas.read_csv(tmp_path / 'out/deployments.csv')) == 1000


@pytest.mark.slow
def test_a_page_can_be_sent_by_mail_and_states_what_it_omits_for_that(tmp_path, monkeypatch):
    mission, curves, whole, _ = told(single(tmp_path / 'mission.mcap', 81))
    assert len(whole.encode()) < 1_000_000
    monkeypatch.setattr(page, 'MAX_BYTES', len(whole.encode()) - 500)
    less, left_out = page.mission_page(mission, curves)
    assert len(less.encode()) <= page.MAX_BYTES
    assert left_out in less
    assert 'of 82 moments' in left_out
    monkeypatch.setattr(page, 'MAX_BYTES', 1000)
    with pytest.raises(ValueError, match='MB with two beliefs'):
        page.mission_page(mission, curves)


def test_repeated_beliefs_are_shown_once(tmp_path):
    whole = sent_by_single(3)
    held, prior = on(whole.sent, '/belief')[-1], on(whole.sent, '/belief')[0]
    log = record(tmp_path / 'mission.mcap', [*whole.sent, prior, held])
    assert [each.held for each in read_summary(log).moments] == [0, 1, 2, 3]


def gap(whole, *numbers):
    """Return a mission's messages without some of its beliefs and their views."""
    beliefs = [on(whole.sent, '/belief')[number] for number in numbers]
    return without(whole.sent, *beliefs)


def test_beliefs_that_a_restarted_recorder_missed_are_stated(tmp_path):
    whole = sent_by_single(6)
    sent = gap(whole, 3)
    before = sent.index(on(whole.sent, '/belief')[4])
    with LogWriter(tmp_path / 'mission.mcap') as log:
        record_to(log, sent[:before])
    with LogWriter(tmp_path / 'mission.mcap', resume=True) as log:
        record_to(log, sent[before:])
    mission, curves, _, _ = told(tmp_path / 'mission.mcap')
    assert [moment.held for moment in mission.moments] == [0, 1, 2, 4, 5, 6]
    assert [each.is_after_gap for each in mission.moments] == [False] * 3 + [True] + [False] * 2
    assert 'after deployment 3' in mission.notes[0]
    assert mission.deployments[2].moment == 3
    assert np.isnan([curves.expected[3], curves.gained[3]]).all()
    assert curves.lost[-1] == sum(not each.survived for each in mission.ended)


def broken(tmp_path):
    """Return logs that cannot be reported on, with the error messages."""
    whole = sent_by_single(6)
    none = tmp_path / 'none.mcap'
    none.write_text('no log at all')
    yield none, 'is no MCAP file'
    yield tmp_path / 'missing.mcap', 'missing.mcap'
    yield record(tmp_path / 'empty.mcap', []), f'has no readable beliefs: .*{BELIEF}'
    missing = record(tmp_path / 'gap.mcap', gap(whole, 3))
    yield missing, 'belief after deployment 3 is missing, and neither'


def test_bad_logs_are_refused_and_nothing_is_left(tmp_path, capsys):
    for log, said in broken(tmp_path):
        there = set(tmp_path.iterdir())
        assert main([str(log), '--out', str(tmp_path / 'out')]) == 2, log
        error = capsys.readouterr().err
        assert re.search(said, error), error
        assert error.startswith('report: ')
        assert set(tmp_path.iterdir()) == there


def test_a_mission_without_departures_is_reported(tmp_path):
    log = record(tmp_path / 'never.mcap', Mission().sent)
    assert main([str(log), '--out', str(tmp_path / 'out')]) == 0
    page = (tmp_path / 'out' / 'report.html').read_text()
    assert '0 robots of 0 agents' in page
    assert re.search(r'No report has changed the belief\. Undecided: \d+ cells\.', page)


def test_an_existing_folder_is_left_alone(shown, tmp_path, capsys):
    log, _ = shown
    mine = tmp_path / 'mine'
    mine.mkdir()
    (mine / 'thesis.txt').write_text('all of it')
    assert main([str(log), '--out', str(mine)]) == 2
    assert 'exists and is not empty: name another' in capsys.readouterr().err
    assert [file.name for file in mine.iterdir()] == ['thesis.txt']
    assert main([str(log), '--out', str(mine / 'thesis.txt')]) == 2
    assert (mine / 'thesis.txt').read_text() == 'all of it'
    capsys.readouterr()
    for out, why in (
        (mine / 'thesis.txt' / 'out', ' cannot be made: .*/thesis.txt is no folder'),
        ('/proc/out', ': No such file'),
        ('/proc/deep/out', ': No such file'),
    ):
        assert main([str(log), '--out', str(out)]) == 2
        assert re.match(f'report: {out}{why}', capsys.readouterr().err)


@pytest.mark.processes
def test_a_full_disk_leaves_no_report(shown, tmp_path):
    log, _ = shown
    little = 100_000

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (little, little))

    done = subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', 'report', log, '--out', tmp_path / 'out'],
        capture_output=True, text=True, preexec_fn=limit,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith(f'report: {tmp_path / "out"}: File too large (raise')
    assert not list(tmp_path.iterdir())


def test_strings_of_the_log_are_escaped_in_the_page(tmp_path):
    whole = Shown(GRID)
    agent = 'scout"><script>alert(1)<'
    seen = whole.walk()
    whole.deploy(Observation(seen.path, False), agent=agent)
    log = record(tmp_path / 'mission.mcap', whole.sent)
    assert '<script>alert' not in told(log)[2]
