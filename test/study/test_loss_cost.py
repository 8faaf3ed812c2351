# SPDX-License-Identifier: Apache-2.0
"""What a robot is worth: missions are compared where they know as much."""

from dataclasses import replace
import json

from kbnitp_ros.study.comparison import BY_LOSS_COST, write_report
from kbnitp_ros.study.questions import at_equal_log_loss, compare, EQUAL
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import differ_only_in, Strategy
from laws import for_each
import numpy as np
import pytest
from small_study import compared_by

pytestmark = pytest.mark.slow

TEAMS = (Strategy(loss_cost=0.5), Strategy(), Strategy(loss_cost=5))


@pytest.fixture(scope='module')
def costs(scenario):
    """Return the results of missions at three loss costs, not in their order."""
    return compared_by(scenario, TEAMS)


def equal(*missions):
    return dict(zip(EQUAL, at_equal_log_loss(*(np.array(m, dtype=float) for m in missions))))


def test_missions_are_compared_at_the_lowest_log_loss_that_both_reach():
    least = [[0, 1, 2, 2, 3], [10, 6, 4, 3, 2]]
    this = [[0, 0, 1, 1, 1], [10, 9, 7, 5, 8]]
    # 5 is half the way from 6 to 4, between the first robot and the second.
    assert equal(least, this) == {
        'log_loss': 5,
        'sent_at_least': 1.5,
        'sent': 3,
        'lost_at_least': 1.5,
        'lost': 1,
        'difference': -0.5,
        'fewer': -1.5,
    }
    there_and_back = equal(this, least)
    assert there_and_back['difference'] == 0.5
    assert there_and_back['sent'] == 1.5


def test_a_mission_counts_up_to_where_it_first_got_there():
    least = [[0, 1, 2, 3, 4], [10, 4, 4, 6, 4]]
    this = [[0, 0, 0, 1, 1], [10, 8, 6, 4, 2]]
    assert equal(least, this) == {
        'log_loss': 4,
        'sent_at_least': 1,
        'sent': 3,
        'lost_at_least': 1,
        'lost': 1,
        'difference': 0,
        'fewer': -2,
    }


def test_a_mission_that_learns_nothing_is_compared_with_nothing():
    nothing = [[0, 1, 2], [10, 11, 12]]
    compared = equal([[0, 1, 2], [10, 6, 4]], nothing)
    assert compared == dict.fromkeys(EQUAL, 0) | {'log_loss': 10}


def test_the_difference_is_that_of_the_same_worlds():
    """A loss cost that saves each world's mission the same has no interval."""
    lost = np.array([[0, 1, 2], [0, 3, 6], [0, 5, 10]], dtype=float)
    log_loss = np.array([[9, 4, 1]] * 3, dtype=float)
    least, this = (np.stack([of, log_loss], axis=1) for of in (lost, np.maximum(0, lost - 1)))
    compared = compare(least, this)
    assert compared['difference'] == pytest.approx((-1, -1, -1))
    mean, low, high = compared['lost_at_least']
    assert mean == 6
    assert low < 4 < 8 < high


def test_loss_costs_differ(scenario):
    for differ, teams in (
        (True, TEAMS),
        (False, TEAMS[:1]),
        (False, (Strategy(), Strategy(2, loss_cost=0.1))),
        (False, (Strategy(), Strategy(last_contact=0.1))),
    ):
        assert differ_only_in(replace(scenario, teams=teams), 'loss_cost') is differ


def test_each_is_compared_with_the_least(costs):
    summary = BY_LOSS_COST.summarise(costs)
    assert summary['least'] == 0
    assert [row['loss_cost'] for row in summary['rows']] == [0.5, 5]

    def means(team):
        lost = costs.series(0.9, 'kappa_bnitp', 'robots_lost', team=team)
        loss = costs.series(0.9, 'kappa_bnitp', 'hazard_log_loss', 'target_log_loss', team=team)
        return lost.mean(axis=0), loss.mean(axis=0)

    for row, team in zip(summary['rows'], (TEAMS[0], TEAMS[2])):
        found = equal(means(Strategy()), means(team))
        for name in EQUAL[:-1]:
            assert row[name]['mean'] == pytest.approx(found[name], abs=1e-6), name


@for_each('trials', [3, 1], every=2)
def test_the_report_of_loss_costs_has_their_figure(costs, tmp_path, trials):
    written = write_report(
        Results(replace(costs.scenario, trials=trials), costs.outcomes), tmp_path
    )
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert {path.name for path in written if path.suffix == '.png'} == {
        f'{name}.png' for name in ('entropy', 'log_loss', 'reliability', 'robots_lost')
    }
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert (summary['loss_cost']['rows'][0]['difference']['low'] is None) == (trials == 1)
    general, _, compared = (tmp_path / 'summary.md').read_text().partition('At equal log loss')
    assert compared
    assert 'ifference' not in general  # there is but one method
