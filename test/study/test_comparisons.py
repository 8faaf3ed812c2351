# SPDX-License-Identifier: Apache-2.0
"""Strategies are compared with the first in the same worlds, as pandas does it from the table."""

from dataclasses import astuple, replace
from functools import partial

from kbnitp_ros.core import continue_mission
from kbnitp_ros.study import trial as running
from kbnitp_ros.study.comparison import (
    BY_MAP,
    BY_OBJECTIVE,
    BY_PLANNER,
    COMPARISONS,
    CONTACT,
    differ_in_objective,
)
from kbnitp_ros.study.questions import compare
from kbnitp_ros.study.results import trade
from kbnitp_ros.study.scenario import differ_only_in, Strategy
from kbnitp_ros.study.trial import run_trial, trials_of
from kbnitp_ros.study.workers import Folder
from laws import for_each
import pytest
from small_study import compared_by, written

pytestmark = pytest.mark.slow

NONE = Strategy()
CONTACTS = (Strategy(last_contact=1.0), NONE, Strategy(last_contact=0.3))
OBJECTIVES = (NONE, Strategy(objective='behavioral', alpha=2.0), Strategy(loss_cost=0.5))
PLANNERS = (NONE, Strategy(planner='coverage'), Strategy(planner='random'))
MAPS = (NONE, Strategy(survey=0.9), Strategy(survey=0.5, trusted=0.8))


@for_each('comparison, teams, others, name, sign, cells', [
    (BY_PLANNER, PLANNERS, (1, 2), 'difference', 1, [['`coverage`'], ['`random`']]),
    (CONTACT, CONTACTS, (2, 0), 'value', -1, [['0.3'], ['1']]),
    (BY_OBJECTIVE, OBJECTIVES, (1, 2), 'difference', 1, None),
    (BY_MAP, MAPS, (1, 2), 'value', -1, [['0.9', '0.9'], ['0.5', '0.8']]),
])  # fmt: skip
def test_each_is_compared_with_the_first(
    scenario, tmp_path, comparison, teams, others, name, sign, cells
):
    results = compared_by(scenario, teams)
    summary, rows = written(results, comparison, tmp_path)
    assert {each.name for each in COMPARISONS} & summary.keys() == {comparison.name}
    table = results.to_dataframe()
    table['log_loss'] = table['hazard_log_loss'] + table['target_log_loss']
    by = [*vars(NONE), 'deployment']
    means = table.groupby(by)[['log_loss', 'robots_lost']].mean()
    after = summary[comparison.name]['robots']
    for place, (row, shown) in enumerate(rows):
        team = teams[others[place]]
        apart = means.loc[astuple(team)] - means.loc[astuple(NONE)]
        differences = [each['mean'] for each in row[name]]
        assert differences == pytest.approx(list(sign * apart['log_loss'][after]), abs=1e-6)
        if 'lost_more' in row:
            lost = means['robots_lost'][astuple(team)].iloc[-1]
            assert row['lost']['mean'] == pytest.approx(lost, abs=1e-6)
            more = apart['robots_lost'].iloc[-1]
            assert row['lost_more']['mean'] == pytest.approx(more, abs=1e-6)
        told = ['`kappa_bnitp`', *cells[place]] if cells else [row['objective']]
        assert shown[: len(told) + 1] == ['0.9', *told]
        mean, low, high = row[name][0].values()
        assert shown[len(told) + 1] == f'{mean:.1f} [{low:.1f}, {high:.1f}]'


def test_objectives_are_compared_at_equal_log_loss(scenario):
    results = compared_by(scenario, OBJECTIVES)
    summary = BY_OBJECTIVE.summarise(results)
    assert summary['first'] == 'information'
    assert [row['objective'] for row in summary['rows']] == [
        'alpha 2',
        'information, loss cost 0.5',
    ]
    for row, team in zip(summary['rows'], OBJECTIVES[1:]):
        series = partial(results.series, 0.9, 'kappa_bnitp')
        both = trade(series, NONE), trade(series, team)
        more = compare(*both)['difference'].mean
        assert row['lost_at_equal']['mean'] == pytest.approx(more, abs=1e-6)


def test_strategies_that_differ_otherwise_are_not_compared(scenario):
    def differ(*teams):
        return replace(scenario, teams=teams)

    assert differ_in_objective(differ(*OBJECTIVES))
    assert not differ_in_objective(differ(*OBJECTIVES[::2]))
    assert not differ_in_objective(differ(*OBJECTIVES, Strategy(agents=2)))
    assert differ_only_in(differ(*MAPS), 'survey', 'trusted')
    assert not differ_only_in(differ(NONE, Strategy(survey=0.9, agents=2)), 'survey', 'trusted')
    assert not differ_only_in(differ(NONE), 'survey', 'trusted')


def test_each_mission_has_the_planner_and_the_contact_of_its_strategy(scenario, monkeypatch):
    used = []

    def noting(*arguments, truth, **named):
        mission = continue_mission(*arguments, truth=truth, **named)
        known = [d.observation.steps_survived for d in mission if not d.observation.survived]
        used.append((arguments[5].planner, truth.execution.contact, any(known)))
        return mission

    monkeypatch.setattr(running, 'continue_mission', noting)
    # Robots whose first step is their last have nothing to be heard of.
    teams = (*PLANNERS[1:], *CONTACTS[:2])
    few = replace(scenario, teams=teams, robots=30, trials=1, lethalities=(0.5,))
    for trial in trials_of(replace(few, methods=('kappa_bnitp',))):
        run_trial(few, trial)
    assert used == [
        ('coverage', 0.0, False),
        ('random', 0.0, False),
        ('relaxed', 1.0, True),
        ('relaxed', 0.0, False),
    ]


def test_trials_of_the_information_have_the_files_they_had(scenario, tmp_path):
    scenario = replace(
        scenario, teams=OBJECTIVES, methods=('kappa_bnitp',), trials=1, lethalities=(0.9,)
    )
    folder = Folder(tmp_path, scenario)
    for trial in trials_of(scenario):
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
