# SPDX-License-Identifier: Apache-2.0
"""Maps of hazards known beforehand are compared with none, in the same worlds."""

from dataclasses import replace

from kbnitp_ros.core import Belief, Grid, World
from kbnitp_ros.study.comparison import BY_MAP
from kbnitp_ros.study.scenario import differ_only_in, Strategy
from kbnitp_ros.study.survey import surveyed
import numpy as np
import pytest
from small_study import compared_by, written

pytestmark = pytest.mark.slow

TEAMS = (Strategy(), Strategy(survey=0.9), Strategy(survey=0.5, trusted=0.8))
GRID = Grid(40, 40)
WORLD = World.random(GRID, np.random.default_rng(3), 0.15, 0.8, 0.1)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)


@pytest.fixture(scope='module')
def compared(scenario):
    """Return the results of missions with three maps."""
    return compared_by(scenario, TEAMS)


def test_a_map_is_right_as_often_as_told_and_believed_as_often_as_trusted():
    cells = np.arange(1, GRID.cells)
    for survey, trusted in ((0.7, 0.0), (0.9, 0.0), (0.5, 0.8)):
        belief = surveyed(PRIOR, WORLD, Strategy(survey=survey, trusted=trusted), 1, 2)
        told = belief.hazard[cells] > 0.15
        assert (told == WORLD.hazard[cells]).mean() == pytest.approx(survey, abs=0.04)
        odds = (trusted or survey) / (1 - (trusted or survey))
        expected = np.where(told, odds, 1 / odds) * 0.15 / 0.85
        assert belief.hazard[cells] == pytest.approx(expected / (1 + expected))
        assert belief.kappa == pytest.approx(PRIOR.kappa)
        assert belief.hazard[0] == 0.0
    assert surveyed(PRIOR, WORLD, Strategy(), 1, 2) is PRIOR


def test_a_better_map_is_wrong_only_where_a_poorer_one_is():
    wrong = [
        (surveyed(PRIOR, WORLD, Strategy(survey=survey), 1, 2).hazard > 0.15) != WORLD.hazard
        for survey in (0.7, 0.9)
    ]
    assert (wrong[0] | ~wrong[1])[1:].all()


def test_each_is_compared_with_none(compared):
    summary = BY_MAP.summarise(compared)
    assert [(row['survey'], row['trusted']) for row in summary['rows']] == [(0.9, 0.9), (0.5, 0.8)]
    assert summary['robots'] == [0, 4]

    def log_loss(team):
        measures = ('hazard_log_loss', 'target_log_loss')
        return compared.series(0.9, 'kappa_bnitp', *measures, team=team)

    for row, team in zip(summary['rows'], TEAMS[1:]):
        value = (log_loss(TEAMS[0]) - log_loss(team)).mean(axis=0)
        assert row['value'][0]['mean'] == pytest.approx(value[0], abs=1e-6)
        assert row['value'][-1]['mean'] == pytest.approx(value[-1], abs=1e-6)
    # A right map tells something at once, and one that is trusted in vain costs.
    assert summary['rows'][0]['value'][0]['mean'] > 0.0 > summary['rows'][1]['value'][0]['mean']


def test_the_report_has_a_table_of_it(compared, tmp_path):
    summary, rows = written(compared, BY_MAP, tmp_path)
    for row, cells in rows:
        assert cells[2:4] == [f'{row["survey"]:g}', f'{row["trusted"]:g}']
    assert not {'loss_cost', 'teams', 'planners'} & summary.keys()


def test_only_teams_that_differ_in_maps_alone_are_compared(scenario):
    maps = 'survey', 'trusted'
    assert differ_only_in(replace(scenario, teams=TEAMS), *maps)
    assert not differ_only_in(
        replace(scenario, teams=(Strategy(), Strategy(survey=0.9, agents=2))), *maps
    )
    assert not differ_only_in(replace(scenario, teams=(Strategy(),)), *maps)
