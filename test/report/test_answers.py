# SPDX-License-Identifier: Apache-2.0
"""Answers about one mission, and about two side by side."""

from itertools import product
import re

from kbnitp_msgs.msg import Decision as DecisionMessage
from kbnitp_ros.cli.report import main
from kbnitp_ros.core import Decision, Dynamics, Grid, HazardDraws, Observation, update
from kbnitp_ros.files import counted
from kbnitp_ros.messages.progress import decision_message, read_decision
from kbnitp_ros.report.answers import (
    advice,
    answer_tiles,
    classify_cells,
    expected_losses,
    expected_used_up,
    list_findings,
    shares,
    undecided,
    used_up_at,
)
from kbnitp_ros.report.comparison import differences, given_differently, reservations
from kbnitp_ros.report.mission import read_mission
from kbnitp_ros.report.tables import mission_curves
from laws import for_each
from mission_log import GRID, MODEL, record
from missions import sent_by_single, Shown, single
import numpy as np
import pytest


def answered(whole, folder):
    """Return the mission of these messages, and its tiles by question."""
    mission = read_mission(record(folder / 'mission.mcap', whole.sent))
    tiles = answer_tiles(mission, mission_curves(mission))
    return mission, {each.question: each for each in tiles}


@pytest.fixture(scope='module')
def told(tmp_path_factory):
    return answered(sent_by_single(20), tmp_path_factory.mktemp('answers'))


def test_every_cell_is_counted_by_its_definition(told):
    mission, _ = told
    hazard, cells = mission.moments[-1].belief.hazard, classify_cells(mission)
    for cell in range(mission.grid.cells):
        is_inside = cell not in mission.grid.blocked
        entered = any(cell in each.path for each in mission.ended)
        assert cells.free[cell] == (is_inside and hazard[cell] <= 0.05)
        assert cells.suspected[cell] == (is_inside and entered and hazard[cell] >= 0.5)
        assert cells.entered[cell] == entered
    assert undecided(mission, -1) == sum(
        0.05 < hazard[cell] < 0.95 for cell in np.flatnonzero(mission.grid.free)
    )


def test_findings_are_sorted_by_probability(told):
    mission, _ = told
    belief = mission.moments[-1].belief
    found = {(finding.kind, finding.cell): finding for finding in list_findings(mission)}
    free = mission.grid.free
    assert {cell for kind, cell in found if kind == 'target'} == {
        *np.flatnonzero(free & (belief.target >= 0.5)).tolist()
    }
    assert {cell for kind, cell in found if kind == 'hazard'} == {
        *np.flatnonzero(classify_cells(mission).suspected).tolist()
    }
    for (kind, cell), each in found.items():
        assert each.probability == getattr(belief, kind)[cell]
        assert [each.x, each.y] == mission.grid.centers([cell])[0].tolist()
        looks = sum((seen.path[1:] == cell).sum() for seen in mission.ended if seen.survived)
        assert each.looks == looks
    probable = [each.probability for each in list_findings(mission)]
    assert probable == sorted(probable, reverse=True)


@for_each('seed', range(20))
def test_a_loss_is_shared_among_the_cells_of_its_path(seed):
    rng = np.random.default_rng(seed)
    steps = 5
    survival, known = rng.uniform(0.1, 0.9, steps), int(rng.integers(steps))
    seen = Observation([GRID.base] * (steps + 1), False, steps_survived=known)
    expected = np.zeros(steps)
    for fates in product((False, True), repeat=steps):
        if not all(fates) and fates.index(False) >= known:
            each = np.where(fates, survival, 1.0 - survival)
            expected[fates.index(False)] += each.prod()
    assert shares(seen, survival) == pytest.approx(expected / expected.sum())


def test_losses_add_up_to_the_robots_lost(told):
    mission, tiles = told
    lost = sum(not each.survived for each in mission.ended)
    losses = expected_losses(mission)
    assert losses.sum() == pytest.approx(lost)
    assert not losses[~classify_cells(mission).entered].any()
    assert tiles['What did it cost?'].answer == f'{lost} of 20 robots lost'


def test_used_up_hazards_are_former_ones_that_are_gone(tmp_path):
    whole = Shown(dynamics=Dynamics('used_up'))
    # Also, no cell is counted twice: both together are the former hazards.
    path = [2, 7, 12, 11, 6, 1, 2]
    lost_at = [0.0, 0.2, 1.0, 0.5, 0.1, 0.1]
    for ending in ({}, {'steps_survived': 2}, {'lost_at': lost_at}):
        whole.deploy(Observation(path, False, **ending))
        whole.deploy(Observation(path, True, [True, False, False, True, False, False]))
    mission, _ = answered(whole, tmp_path)
    moments, total = mission.moments, np.zeros(GRID.cells)
    for place in range(1, len(moments)):
        was_there = update(moments[place - 1].belief, MODEL, moments[place].outcome).hazard
        used_up = used_up_at(mission, place)
        assert used_up == pytest.approx(was_there - moments[place].belief.hazard, abs=1e-12)
        assert used_up.sum() > 0.0
        total += used_up
    assert expected_used_up(mission) == pytest.approx(total)


def test_robots_in_flight_are_stated(tmp_path):
    whole = sent_by_single(3)
    whole.send_out(whole.walk().path)
    mission, tiles = answered(whole, tmp_path)
    assert advice(mission) == ('Wait', 'No report yet from 1 robot.')
    assert tiles['What did it cost?'].detail.endswith('1 in flight')


def decision_on(mission, confidence):
    """Return a decision on a lane by a planner, and its message."""
    hazardous = np.zeros((4, GRID.cells), dtype=bool)
    hazardous[0, 1] = True
    draws = HazardDraws(hazardous, 1e6)
    path = np.array([GRID.base, 1, 0])
    decision = Decision.about('area', draws, path, confidence)
    return decision, decision_message(GRID, decision, 3, mission.now, mission.now)


@for_each('confidence, reached', [(0.7, True), (0.9, False)])
def test_a_goal_is_answered(confidence, reached, tmp_path):
    whole = sent_by_single(3)
    decision, message = decision_on(whole, confidence)
    again = read_decision(GRID, message)
    assert again.p_free == decision.p_free == 0.75
    assert again.reached == reached
    whole.publish('decision', message)
    mission, tiles = answered(whole, tmp_path)
    assert tiles['Is the area safe?'].answer == 'Free of hazards with 75.0 %'
    assert advice(mission)[0] == ('Stop' if reached else 'Send more')


def test_a_missing_goal_is_stated(told):
    assert told[1]['Is the lane safe?'].answer == 'No goal was given'


@for_each('name, value', [('probability', 1.5), ('probability', np.nan), ('hazards_95', np.inf)])
def test_a_bad_decision_is_refused(name, value):
    message = DecisionMessage(probability=0.5)
    setattr(message, name, value)
    with pytest.raises(ValueError, match=name):
        read_decision(GRID, message)


def test_the_truth_gives_the_number_of_right_answers(told):
    mission, tiles = told
    cells, hazard = classify_cells(mission), mission.world.hazard
    free, suspected = (np.flatnonzero(each) for each in (cells.free, cells.suspected))
    missed = sum(hazard[cell] for cell in free)
    assert (
        f'By the recorded truth {free.size - missed} of {free.size} safe cells have no hazard, '
        f'{sum(hazard[cell] for cell in suspected)} of {suspected.size} suspected cells have one'
    ) in tiles['Can I trust it?'].detail


@pytest.fixture(scope='module')
def logs(tmp_path_factory):
    """Return the logs of two missions in one field: the second has three robots more."""
    folder = tmp_path_factory.mktemp('two')
    return [single(folder / f'{name}.mcap', robots) for name, robots in (('one', 6), ('two', 9))]


@pytest.fixture(scope='module')
def pairs(logs):
    return [(each, mission_curves(each)) for each in map(read_mission, logs)]


def last(pair):
    """Return the final hazard and the entered cells, independently computed."""
    mission, _ = pair
    entered = np.zeros(mission.grid.cells, dtype=bool)
    for deployment in mission.deployments:
        entered[deployment.outcome.path] = True
    return mission.moments[-1].belief.hazard, entered


def test_differences_are_those_of_the_beliefs(pairs):
    (one, was), (other, since) = map(last, pairs)
    said = list(differences(*pairs))
    assert said[0] == (
        f'Free only in A: {counted(((one <= 0.05) & (other > 0.05)).sum(), "cell")}; '
        f'only in B: {counted(((other <= 0.05) & (one > 0.05)).sum(), "cell")}.'
    )
    suspected = [(hazard >= 0.5) & entered for hazard, entered in ((one, was), (other, since))]
    assert said[2].startswith(f'{(suspected[0] & suspected[1]).sum()} in both; only in A: ')
    only = int((suspected[1] & ~suspected[0]).sum())
    assert (said[2].rpartition(': ')[2] == 'none.') == (only == 0)
    entered = [(was & ~since).sum(), (since & ~was).sum()]
    assert re.findall(r'Entered only in A: (\d+) cells?; only in B: (\d+)', said[3]) == [
        tuple(map(str, entered))
    ]
    assert 'B sent 3 robots more' in said[6]


def test_a_mission_beside_itself_has_no_difference(pairs):
    one, _ = pairs
    said = ' '.join(differences(one, one))
    assert set(re.findall(r'only in [AB]: (\d+)', said)) == {'0'}
    assert said.count('only in A: none; only in B: none') == 2
    assert 'as many nats left in B' in said
    assert 'B sent as many robots and lost as many.' in said
    assert 'No difference.' in said
    assert list(reservations(one[0], one[0])) == []
    assert list(given_differently(one[0], one[0])) == []


def test_different_truths_are_stated(tmp_path, pairs):
    whole = Shown(seed=5)
    whole.publish_truth()
    whole.deploy(whole.walk())
    other = read_mission(record(tmp_path / 'mission.mcap', whole.sent))
    first = pairs[0][0]
    hazards = (other.world.hazard != first.world.hazard).sum()
    (said,) = reservations(first, other)
    assert f'differ: hazards in {hazards} cell' in said
    unknown = read_mission(single(tmp_path / 'unknown.mcap', 2, with_truth=False))
    assert list(reservations(first, unknown)) == ['Only A has the truth on record.']


def test_the_command_writes_one_page(logs, tmp_path, capsys):
    folder = tmp_path / 'compared'
    assert main([*map(str, logs), '--out', str(folder)]) == 0
    assert [file.name for file in folder.iterdir()] == ['comparison.html']
    assert 'comparison.html' in capsys.readouterr().out
    page = (folder / 'comparison.html').read_text()
    for log in logs:
        assert str(log) in page
    assert main([*map(str, logs), '--out', str(folder)]) == 2
    assert 'not empty' in capsys.readouterr().err


def test_other_fields_are_refused(logs, tmp_path, capsys):
    other = single(tmp_path / 'other.mcap', 2, grid=Grid(7, 6, resolution=0.5))
    folder = tmp_path / 'compared'
    assert main([str(logs[0]), str(other), '--out', str(folder)]) == 2
    assert '7x6 cells of 0.5 m' in capsys.readouterr().err
    assert not folder.exists()
