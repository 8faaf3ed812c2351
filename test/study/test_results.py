# SPDX-License-Identifier: Apache-2.0
"""The table has a row for every deployment; figures, means and intervals agree with it."""

from dataclasses import replace
import json

from disk import room_for
from kbnitp_ros.study.charts import columns_for, contender_labels, group_contenders, reliability
from kbnitp_ros.study.comparison import study_figures, write_report
from kbnitp_ros.study.results import bootstrap_mean, LOG_LOSS, Results, summarise, summary_table
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.trial import list_trials, MEASURES, run_trial, Trial
from kbnitp_ros.styles import SERIES
from laws import for_each
from legible import check_lines, check_texts
import numpy as np
import pytest
from small_study import run


def test_the_table_is_tidy(results):
    table = results.table()
    types = {field.name: str(field.type) for field in table.schema}
    texts = 'method allocation planner objective dynamics clustering paths goal'
    reals = 'loss_cost last_contact survey trusted alpha lethality'
    assert types == {
        **dict.fromkeys(texts.split(), 'string'),
        **dict.fromkeys((*reals.split(), *MEASURES), 'double'),
        **dict.fromkeys(('trial', 'agents', 'second_base', 'deployment', 'robots_lost'), 'int64'),
    }
    assert table.num_rows == 2 * 3 * 3 * 5
    columns = ('trial', 'method', 'lethality', 'deployment')
    keys = list(zip(*(table[name].to_pylist() for name in columns)))
    assert len(set(keys)) == len(keys)
    assert keys[:6] == [
        *((0, 'relaxed_bnitp', 0.2, deployment) for deployment in range(5)),
        (1, 'relaxed_bnitp', 0.2, 0),
    ]


def test_every_row_holds_its_own_measures(results):
    rows = results.table().to_pylist()
    for row in rows:
        outcome = results.outcomes[Trial(row['lethality'], row['method'], row['trial'])]
        measured = outcome.measures[row['deployment']]
        np.testing.assert_array_equal([row[name] for name in MEASURES], measured)


def test_the_order_of_the_outcomes_does_not_matter(results):
    backwards = Results(results.scenario, dict(reversed(results.outcomes.items()))).table()
    without_nan = backwards.column_names[:-2]
    assert backwards.select(without_nan).equals(results.table().select(without_nan))


def test_series_are_sums_by_trial_and_deployment(results):
    series = results.series(0.9, 'kappa_bnitp', 'hazard_log_loss', 'target_log_loss')
    assert series.shape == (3, 5)
    measured = dict(zip(MEASURES, results.outcomes[Trial(0.9, 'kappa_bnitp', 2)].measures[4]))
    assert series[2, 4] == measured['hazard_log_loss'] + measured['target_log_loss']


def test_final_maps_are_those_of_all_trials(results):
    believed, truth = results.final_maps(0.9, 'kappa_bnitp')
    assert believed.shape == truth.shape == (3, 2, 12)
    outcome = results.outcomes[Trial(0.9, 'kappa_bnitp', 1)]
    assert np.array_equal(believed[1], outcome.believed)
    assert np.array_equal(truth[1], outcome.truth)


def test_the_interval_is_that_of_resampled_means():
    samples = np.array([1.0, 2.0, 3.0, 10.0])
    rng = np.random.default_rng(1)
    resampled = rng.choice(samples, (100_000, 4)).mean(axis=1)
    expected = np.quantile(resampled, (0.025, 0.975))
    np.testing.assert_allclose(bootstrap_mean(samples)[1:], expected, atol=0.2)


def test_differences_are_paired(results):
    summary = summarise(results)
    assert (summary['trials'], summary['robots']) == (3, 4)
    assert summary['reference'] == 'kappa_bnitp'
    rows = {(row['lethality'], row['method']): row for row in summary['rows']}
    assert len(rows) == 6
    final = {
        method: results.series(0.9, method, *LOG_LOSS)[:, -1]
        for method in results.scenario.methods
    }
    row = rows[0.9, 'relaxed_bnitp']
    assert row['log_loss']['mean'] == pytest.approx(final['relaxed_bnitp'].mean(), abs=1e-6)
    mean, low, high = bootstrap_mean(final['kappa_bnitp'] - final['relaxed_bnitp'])
    assert row['difference'] == pytest.approx({'mean': mean, 'low': low, 'high': high}, abs=1e-6)
    believed, truth = results.final_maps(0.9, 'relaxed_bnitp')
    false = [b[1][t[0] & ~t[1]].sum() for b, t in zip(believed, truth)]
    assert row['false_targets']['mean'] == pytest.approx(np.mean(false), abs=1e-6)
    assert 'difference' not in rows[0.9, 'kappa_bnitp']
    assert row['robots_lost']['mean'] == results.series(0.9, 'relaxed_bnitp', 'robots_lost')[
        :, -1
    ].mean().round(6)


def test_a_single_trial_has_no_interval(results):
    alone = {trial: outcome for trial, outcome in results.outcomes.items() if not trial.number}
    summary = summarise(Results(replace(results.scenario, trials=1), alone))
    assert summary['rows'][0]['entropy']['low'] is None
    json.dumps(summary, allow_nan=False)
    assert '[' not in summary_table(summary).markdown().split('|---|')[1]


def test_the_printed_table_agrees_with_the_summary(results):
    summary = summarise(results)
    lines = summary_table(summary).markdown().splitlines()
    cells = [line.strip('| ').split(' | ') for line in lines if line.startswith('| 0')]
    assert len(cells) == len(summary['rows'])
    for row, (lethality, method, log_loss, *_) in zip(summary['rows'], cells):
        assert float(lethality) == row['lethality']
        assert method == f'`{row["method"]}`'
        entry = row['log_loss']
        assert log_loss == f'{entry["mean"]:.1f} [{entry["low"]:.1f}, {entry["high"]:.1f}]'


@pytest.mark.slow
def test_a_calibrated_belief_is_on_the_diagonal():
    rng = np.random.default_rng(0)
    believed = rng.random((25, 4000))
    held, there = reliability(believed, rng.random(believed.shape) < believed)
    np.testing.assert_allclose(held, np.arange(0.05, 1, 0.1), atol=0.01)
    np.testing.assert_allclose(there, held, atol=0.02)


@pytest.mark.slow
def test_reliability_by_hand():
    believed = np.array([0.9, 0.1, 0.9, 0.2] * 5)
    truth = np.array([True, False, False, True] * 5)
    held, there = reliability(believed, truth)
    np.testing.assert_allclose(held, [0.1, 0.1, 0.15, 0.2, 0.2, 0.9, 0.9, 0.9, 0.9, 0.9])
    assert there[:5].tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]


@pytest.mark.slow
@for_each('lethalities, trials', [((0.2, 0.9), 3), ((0.9,), 1)], every=2)
def test_every_study_has_its_report(results, tmp_path, pictures, lethalities, trials):
    scenario = replace(results.scenario, lethalities=lethalities, trials=trials)
    written = write_report(Results(scenario, results.outcomes), tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert all(path.stat().st_size for path in written)


@pytest.mark.slow
def test_a_full_disk_is_reported_by_file(results, tmp_path):
    with room_for(1000), pytest.raises(OSError, match=f'File too large: {str(tmp_path)!r}'):
        write_report(results, tmp_path)


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
    'planners': {'teams': PLANNERS, 'lethalities': (0.1, 0.3, 0.5, 0.9)},
    'methods': {'methods': ALL_METHODS, 'lethalities': LETHALITIES},
    'allocations': {'teams': ALLOCATED, 'lethalities': (0.1, 0.5, 0.9), 'robots': 9},
    'loss costs': {'teams': COSTS, 'lethalities': (0.1, 0.3, 0.5)},
    'surveys': {'teams': SURVEYS, 'lethalities': (0.1, 0.5)},
    'contacts': {'teams': CONTACTS, 'lethalities': (0.5,), 'trials': 1},
    'methods and teams': {'methods': ALL_METHODS[2:5], 'teams': PLANNERS},
}


def changed(scenario, changes):
    return replace(scenario, **{'methods': ('kappa_bnitp',), 'trials': 2} | changes)


@pytest.mark.slow
@for_each('name', STUDIES, every=9)
def test_figures_are_legible(scenario, name):
    scenario = changed(scenario, STUDIES[name])
    figures = study_figures(run(scenario))
    assert {'entropy', 'log_loss', 'reliability'} <= figures.keys()
    for figure in figures.values():
        check_texts(figure)
        check_lines(figure)
    _, lines = figures['reliability'].axes[0].get_legend_handles_labels()
    assert len(lines) == len(scenario.lethalities)


@pytest.mark.slow
@for_each('name', STUDIES)
def test_every_contender_is_in_a_panel_of_few(scenario, name):
    contenders = changed(scenario, STUDIES[name]).contenders
    groups = group_contenders(contenders)
    assert all(1 < len(group) <= len(SERIES) for group in groups)
    assert {each for group in groups for each in group} == set(contenders)
    assert (len(groups) == 1) == (len(contenders) <= len(SERIES))


@pytest.mark.slow
def test_teams_share_a_panel_by_allocation_with_robots_one_by_one(scenario):
    groups = group_contenders(changed(scenario, STUDIES['allocations']).contenders)
    assert [[team for _, team in group] for group in groups] == [
        [Strategy(), *(Strategy(agents, how) for agents in (2, 4, 8))]
        for how in ('independent', 'voronoi', 'greedy')
    ]


@pytest.mark.slow
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
def test_contenders_are_named_by_their_differences(scenario, methods, teams, expected):
    scenario = replace(scenario, methods=methods, teams=teams)
    assert list(contender_labels(scenario).values()) == expected


@pytest.mark.slow
def test_rows_of_panels_are_full_if_they_can_be():
    assert [columns_for(panels) for panels in range(1, 10)] == [1, 2, 3, 4, 3, 3, 4, 4, 3]


@pytest.mark.slow
def test_lines_are_the_measured_values(scenario):
    """The log loss after each round is read back from the figure of the rounds."""
    scenario = changed(scenario, {**STUDIES['allocations'], 'lethalities': (0.1, 0.9)})
    outcomes = {trial: run_trial(scenario, trial) for trial in list_trials(scenario)}
    results = Results(scenario, outcomes)
    panels = iter(study_figures(results)['by_round'].axes)
    for group in group_contenders(scenario.contenders):
        for lethality in scenario.lethalities:
            for (method, team), line in zip(group, next(panels).lines, strict=True):
                log_loss = results.series(
                    lethality, method, 'hazard_log_loss', 'target_log_loss', team=team
                ).mean(axis=0)
                ends = [*range(0, 9, team.agents), 9]
                np.testing.assert_allclose(line.get_ydata(), log_loss[ends])
                assert line.get_label() == contender_labels(scenario)[method, team]
