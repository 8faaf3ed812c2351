# SPDX-License-Identifier: Apache-2.0
"""Everybody can read a study's figures, however much it compares."""

from dataclasses import replace

from kbnitp_ros.figures import SERIES
from kbnitp_ros.study.charts import columns_for, groups_of, labels_of
from kbnitp_ros.study.comparison import figures_of
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Contender, Strategy
from kbnitp_ros.study.trial import run_trial, trials_of
from laws import for_each
from legible import check_lines, check_texts
import numpy as np
import pytest
from small_study import run

pytestmark = pytest.mark.slow

ALLOCATED = (
    Strategy(),
    *(Strategy(n, how) for n in (2, 4, 8) for how in ('independent', 'voronoi', 'greedy')),
)
COSTS = tuple(Strategy(loss_cost=cost) for cost in (0.0, 0.05, 0.1, 0.2, 0.4, 0.8))
SURVEYS = (
    Strategy(),
    *(Strategy(survey=right) for right in (0.7, 0.9, 0.99)),
    *(Strategy(survey=0.5, trusted=trusted) for trusted in (0.7, 0.9)),
    Strategy(survey=0.7, trusted=0.9),
)
PLANNERS = tuple(Strategy(planner=name) for name in ('', 'coverage', 'random'))
CONTACTS = tuple(Strategy(last_contact=heard) for heard in (0.0, 0.2, 1.0))
ALL_METHODS = (
    'relaxed_itp',
    'relaxed_bnitp',
    'kappa_bnitp_published',
    'kappa_bnitp',
    'kappa_bnitp_sampled',
)
LETHALITIES = (0.01, 0.1, 0.3, 0.5, 0.6, 0.9)
STUDIES = {
    'methods': {'methods': ALL_METHODS, 'lethalities': LETHALITIES},
    'allocations': {'teams': ALLOCATED, 'lethalities': (0.1, 0.5, 0.9), 'robots': 9},
    'loss costs': {'teams': COSTS, 'lethalities': (0.1, 0.3, 0.5)},
    'surveys': {'teams': SURVEYS, 'lethalities': (0.1, 0.5)},
    'planners': {'teams': PLANNERS, 'lethalities': (0.1, 0.3, 0.5, 0.9)},
    'contacts': {'teams': CONTACTS, 'lethalities': (0.5,), 'trials': 1},
    'methods and teams': {'methods': ALL_METHODS[2:5], 'teams': PLANNERS},
}


def changed(scenario, changes):
    return replace(scenario, **{'methods': ('kappa_bnitp',), 'trials': 2} | changes)


@for_each('name', STUDIES, every=9)
def test_figures_are_legible(scenario, name):
    scenario = changed(scenario, STUDIES[name])
    figures = figures_of(run(scenario))
    assert {'entropy', 'log_loss', 'reliability'} <= figures.keys()
    for figure in figures.values():
        check_texts(figure)
        check_lines(figure)
    _, lines = figures['reliability'].axes[0].get_legend_handles_labels()
    assert len(lines) == len(scenario.lethalities)


@for_each('name', STUDIES)
def test_every_contender_is_in_a_panel_of_few(scenario, name):
    contenders = changed(scenario, STUDIES[name]).contenders
    groups = groups_of(contenders)
    assert all(1 < len(group) <= len(SERIES) for group in groups)
    assert {each for group in groups for each in group} == set(contenders)
    assert (len(groups) == 1) == (len(contenders) <= len(SERIES))


def test_teams_share_a_panel_by_allocation_with_robots_one_by_one(scenario):
    groups = groups_of(changed(scenario, STUDIES['allocations']).contenders)
    assert [[each.team for each in group] for group in groups] == [
        [Strategy(), *(Strategy(agents, how) for agents in (2, 4, 8))]
        for how in ('independent', 'voronoi', 'greedy')
    ]


def test_what_has_no_kinds_is_beside_the_first(scenario):
    groups = groups_of(changed(scenario, STUDIES['surveys']).contenders)
    assert [[each.team for each in group] for group in groups] == [
        [Strategy(), *SURVEYS[1:4]],
        [Strategy(), *SURVEYS[4:]],
    ]


@for_each('methods, teams, expected', [
    (('kappa_bnitp',), (Strategy(),), ['kappa_bnitp']),
    (ALL_METHODS[:2], (Strategy(),), list(ALL_METHODS[:2])),
    (ALL_METHODS[3:4], COSTS[:2], ['loss cost 0', 'loss cost 0.05']),
    (ALL_METHODS[3:4], CONTACTS[:2], ['last contact 0', 'last contact 0.2']),
    (ALL_METHODS[3:4], PLANNERS[:2], ['relaxed', 'coverage']),
    (
        ALL_METHODS[3:4],
        (*SURVEYS[:2], SURVEYS[-1]),
        ['no map', 'map 0.7', 'map 0.7 trusted as 0.9'],
    ),
    (('kappa_bnitp',), (Strategy(), Strategy(2)), ['one by one', '2 greedy']),
    (
        ALL_METHODS[:2],
        (Strategy(), Strategy(2)),
        [f'{of}, {team}' for of in ALL_METHODS[:2] for team in ('one by one', '2 greedy')],
    ),
])  # fmt: skip
def test_contenders_are_called_what_tells_them_apart(scenario, methods, teams, expected):
    scenario = replace(scenario, methods=methods, teams=teams)
    assert list(labels_of(scenario).values()) == expected


def test_rows_of_panels_are_full_if_they_can_be():
    assert [columns_for(panels) for panels in range(1, 10)] == [1, 2, 3, 4, 3, 3, 4, 4, 3]


def test_lines_are_what_was_measured(scenario):
    """The log loss after each round is read back from the figure of the rounds."""
    scenario = changed(scenario, {**STUDIES['allocations'], 'lethalities': (0.1, 0.9)})
    outcomes = {trial: run_trial(scenario, trial) for trial in trials_of(scenario)}
    results = Results(scenario, outcomes)
    panels = iter(figures_of(results)['by_round'].axes)
    for group in groups_of(scenario.contenders):
        for lethality in scenario.lethalities:
            for (method, team), line in zip(group, next(panels).lines, strict=True):
                log_loss = results.series(
                    lethality, method, 'hazard_log_loss', 'target_log_loss', team=team
                ).mean(axis=0)
                ends = [*range(0, 9, team.agents), 9]
                np.testing.assert_allclose(line.get_ydata(), log_loss[ends])
                assert line.get_label() == labels_of(scenario)[Contender(method, team)]
