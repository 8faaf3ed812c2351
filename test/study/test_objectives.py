# SPDX-License-Identifier: Apache-2.0
"""Objectives are compared with the first, in the same worlds, beside loss costs."""

from dataclasses import replace

from kbnitp_ros.study.comparison import BY_OBJECTIVE, differ_in_objective
from kbnitp_ros.study.folder import Folder
from kbnitp_ros.study.loss_cost import compare, trade
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import run_trial, trials_of
import pytest
from small_study import compared_by, written

pytestmark = pytest.mark.slow

TEAMS = (Strategy(), Strategy(objective='behavioral', alpha=2.0), Strategy(loss_cost=0.5))


@pytest.fixture(scope='module')
def compared(scenario):
    """Return the results of missions by three objectives."""
    return compared_by(scenario, TEAMS)


def test_each_is_compared_with_the_first(compared):
    summary = BY_OBJECTIVE.summarise(compared)
    assert summary['first'] == 'information'
    assert [row['objective'] for row in summary['rows']] == [
        'alpha 2',
        'information, loss cost 0.5',
    ]

    def at_end(team, *measures):
        return compared.series(0.9, 'kappa_bnitp', *measures, team=team)[:, -1]

    log_loss = ('hazard_log_loss', 'target_log_loss')
    for row, team in zip(summary['rows'], TEAMS[1:]):
        worse = (at_end(team, *log_loss) - at_end(Strategy(), *log_loss)).mean()
        assert row['difference'][-1]['mean'] == pytest.approx(worse, abs=1e-6)
        more = (at_end(team, 'robots_lost') - at_end(Strategy(), 'robots_lost')).mean()
        assert row['lost_more']['mean'] == pytest.approx(more, abs=1e-6)
        both = (trade(compared, 0.9, 'kappa_bnitp', each) for each in (Strategy(), team))
        equal = compare(*both).mean[-1]
        assert row['lost_at_equal']['mean'] == pytest.approx(equal, abs=1e-6)


def test_the_report_has_a_table_of_it(compared, tmp_path):
    _, rows = written(compared, BY_OBJECTIVE, tmp_path)
    assert (tmp_path / 'robots_lost.png').exists()
    for row, cells in rows:
        assert cells[:2] == ['0.9', row['objective']]
        assert cells[-2].startswith(f'{row["lost_more"]["mean"]:.1f} [')


def test_it_is_for_scenarios_that_differ_in_objectives(scenario):
    assert differ_in_objective(replace(scenario, teams=TEAMS))
    assert not differ_in_objective(replace(scenario, teams=TEAMS[::2]))
    assert not differ_in_objective(replace(scenario, teams=(*TEAMS, Strategy(agents=2))))


def test_trials_of_the_information_have_the_files_they_had(scenario, tmp_path):
    scenario = replace(scenario, teams=TEAMS, methods=('kappa_bnitp',), trials=1)
    folder = Folder(tmp_path, replace(scenario, lethalities=(0.9,)))
    for trial in trials_of(replace(scenario, lethalities=(0.9,))):
        folder.save(trial, run_trial(scenario, trial))
    assert sorted(path.name for path in tmp_path.rglob('*.npz')) == [
        '0.9-kappa_bnitp-1-greedy-0.0-0.npz',
        '0.9-kappa_bnitp-1-greedy-0.0-objectivebehavioral-alpha2.0-0.npz',
        '0.9-kappa_bnitp-1-greedy-0.5-0.npz',
    ]


def test_what_a_planner_does_not_seek_is_refused(scenario):
    team = Strategy(planner='coverage', objective='behavioral', alpha=2.0)
    with pytest.raises(ValueError, match='the planner coverage seeks none'):
        replace(scenario, teams=(team,)).check_search()
