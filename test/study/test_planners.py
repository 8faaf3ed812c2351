# SPDX-License-Identifier: Apache-2.0
"""Planners are compared with the first, in the same worlds."""

from dataclasses import replace

from kbnitp_ros.core import continue_mission, SearchOptions
from kbnitp_ros.study import trial as running
from kbnitp_ros.study.comparison import BY_PLANNER
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import run_trial, trials_of
import pytest
from small_study import compared_by, written

pytestmark = pytest.mark.slow

TEAMS = (Strategy(), Strategy(planner='coverage'), Strategy(planner='random'))


@pytest.fixture(scope='module')
def compared(scenario):
    """Return the results of missions by three planners."""
    return compared_by(scenario, TEAMS)


def test_each_team_has_its_planner(scenario, monkeypatch):
    used = []

    def noting(*arguments, **options):
        used.extend(each.planner for each in arguments if isinstance(each, SearchOptions))
        return continue_mission(*arguments, **options)

    monkeypatch.setattr(running, 'continue_mission', noting)
    scenario = replace(scenario, teams=TEAMS, trials=1, lethalities=(0.5,))
    for trial in trials_of(replace(scenario, methods=('kappa_bnitp',))):
        run_trial(scenario, trial)
    assert used == [scenario.planning.planner, 'coverage', 'random']


def test_each_is_compared_with_the_first(compared):
    summary = BY_PLANNER.summarise(compared)
    assert summary['first'] == compared.scenario.planning.planner
    assert [row['planner'] for row in summary['rows']] == ['coverage', 'random']

    def at_end(team, *measures):
        return compared.series(0.9, 'kappa_bnitp', *measures, team=team)[:, -1]

    log_loss = ('hazard_log_loss', 'target_log_loss')
    for row, team in zip(summary['rows'], TEAMS[1:]):
        worse = (at_end(team, *log_loss) - at_end(Strategy(), *log_loss)).mean()
        assert row['difference'][-1]['mean'] == pytest.approx(worse, abs=1e-6)
        lost = at_end(team, 'robots_lost')
        assert row['lost']['mean'] == pytest.approx(lost.mean(), abs=1e-6)
        more = (lost - at_end(Strategy(), 'robots_lost')).mean()
        assert row['lost_more']['mean'] == pytest.approx(more, abs=1e-6)


def test_the_report_has_a_table_of_it(compared, tmp_path):
    _, rows = written(compared, BY_PLANNER, tmp_path)
    for row, cells in rows:
        assert cells[:3] == ['0.9', '`kappa_bnitp`', f'`{row["planner"]}`']
        assert cells[-1].startswith(f'{row["lost_more"]["mean"]:.1f} [')
