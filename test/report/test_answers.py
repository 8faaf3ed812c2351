# SPDX-License-Identifier: Apache-2.0
"""Answers about a mission."""

from itertools import product

from kbnitp_msgs.msg import Decision as DecisionMessage
from kbnitp_ros.core import Decision, Dynamics, HazardDraws, Observation, update
from kbnitp_ros.messages.progress import decision_fields, decision_message, read_decision
from kbnitp_ros.report.answers import (
    advice,
    answer_tiles,
    brief,
    classify_cells,
    expected_losses,
    expected_used_up,
    list_findings,
    safe_cells,
    shares,
    undecided,
    used_up_at,
)
from kbnitp_ros.report.mission import read_summary
from kbnitp_ros.report.tables import mission_curves
from laws import for_each
from mission_log import GRID, MODEL, record
from missions import sent_by_single, Shown
import numpy as np
import pytest


def answered(whole, folder):
    """Return the mission of these messages, and its tiles by question."""
    mission = read_summary(record(folder / 'mission.mcap', whole.sent))
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
        sent = any(cell in each.path for each in mission.ended)
        entered = cell in mission.grid.bases or any(
            cell in each.path[: (each.steps if each.survived else each.steps_survived) + 1]
            for each in mission.ended
        )
        assert cells.free[cell] == (is_inside and entered and hazard[cell] <= 0.05)
        assert cells.assumed[cell] == (is_inside and not entered and hazard[cell] <= 0.05)
        assert cells.suspected[cell] == (is_inside and sent and hazard[cell] >= 0.5)
        assert cells.entered[cell] == (is_inside and entered)
    assert cells.assumed.sum() + cells.free.sum() == (mission.grid.free & (hazard <= 0.05)).sum()
    assert undecided(mission, -1) == sum(
        0.05 < hazard[cell] < 0.95 for cell in np.flatnonzero(mission.grid.free)
    )


def test_findings_are_sorted_by_probability(told):
    mission, _ = told
    belief = mission.moments[-1].belief
    found = {(finding['kind'], finding['cell']): finding for finding in list_findings(mission)}
    free = mission.grid.free
    assert {cell for kind, cell in found if kind == 'target'} == {
        *np.flatnonzero(free & (belief.target >= 0.5)).tolist()
    }
    assert {cell for kind, cell in found if kind == 'hazard'} == {
        *np.flatnonzero(classify_cells(mission).suspected).tolist()
    }
    for (kind, cell), each in found.items():
        assert each['probability'] == getattr(belief, kind)[cell]
        assert [each['x'], each['y']] == mission.grid.centers([cell])[0].tolist()
        looks = sum((seen.path[1:] == cell).sum() for seen in mission.ended if seen.survived)
        assert each['looks'] == looks
    probable = [each['probability'] for each in list_findings(mission)]
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
    assert not losses[~mission.visited()].any()
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


def test_a_loss_in_a_safe_cell_is_told_as_a_malfunction(tmp_path):
    whole = Shown()
    for _ in range(12):
        whole.deploy(Observation([2, 7, 2], True, [False, False]))
    whole.deploy(Observation([2, 7, 2], False))
    mission, tiles = answered(whole, tmp_path)
    cells = classify_cells(mission)
    assert cells.free[7]
    (row,) = (row for row in safe_cells(mission) if row['cell'] == 7)
    assert row['malfunctions'] == expected_losses(mission)[7] > 0.4
    assert '(malfunctions)' in tiles['Where were robots lost? (x, y in m)'].detail


def test_cells_without_a_visit_are_counted_apart(tmp_path):
    whole = Shown(hazard=0.01)
    whole.deploy(Observation([2, 7, 6, 2], True, [False] * 3, entered=[True, False, True]))
    mission, tiles = answered(whole, tmp_path)
    safe = {row['cell'] for row in safe_cells(mission)}
    assert 7 in safe
    assert 6 not in safe
    tile = tiles['Which cells are safe?']
    assert tile.answer.startswith(f'{len(safe)} of ')
    more = int(classify_cells(mission).assumed.sum())
    assert f'{more} cells more without a visit, by the prior' in tile.detail


@for_each('number, text', [(123.4, '123'), (10.0, '10'), (9.96, '10'), (0.123, '0.12')])
def test_numbers_have_no_exponent(number, text):
    assert brief(number) == text
    assert brief(1e-5) == 'less than 0.01'


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
    fields = decision_fields(GRID, decision, 3, mission.now, mission.now)
    return decision, decision_message(fields)


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
