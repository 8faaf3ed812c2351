# SPDX-License-Identifier: Apache-2.0
"""Means, their intervals and the paired differences."""

from dataclasses import replace
import json

from kbnitp_ros.study.results import LOG_LOSS, mean_of, Results, summarise, table_of
from kbnitp_ros.study.scenario import Strategy
import numpy as np
import pytest
from small_study import run


def test_the_interval_holds_the_true_mean_about_as_often_as_it_says():
    samples = np.random.default_rng(5).exponential(size=(25, 400))
    mean, low, high = mean_of(samples)
    np.testing.assert_allclose(mean, samples.mean(axis=0))
    covered = ((low < 1.0) & (high > 1.0)).mean()
    assert 0.86 < covered < 0.97  # 25 skewed samples: a little less than 0.95


def test_the_interval_is_that_of_resampled_means():
    samples = np.array([1.0, 2.0, 3.0, 10.0])
    rng = np.random.default_rng(1)
    resampled = rng.choice(samples, (100_000, 4)).mean(axis=1)
    expected = np.quantile(resampled, (0.025, 0.975))
    np.testing.assert_allclose(mean_of(samples)[1:], expected, atol=0.2)


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
    mean, low, high = mean_of(final['kappa_bnitp'] - final['relaxed_bnitp'])
    assert row['difference'] == pytest.approx({'mean': mean, 'low': low, 'high': high}, abs=1e-6)
    believed, truth = results.final_maps(0.9, 'relaxed_bnitp')
    false = [b[1][t[0] & ~t[1]].sum() for b, t in zip(believed, truth)]
    assert row['false_targets']['mean'] == pytest.approx(np.mean(false), abs=1e-6)
    assert 'difference' not in rows[0.9, 'kappa_bnitp']
    assert row['robots_lost']['mean'] == results.series(0.9, 'relaxed_bnitp', 'robots_lost')[
        :, -1
    ].mean().round(6)


@pytest.mark.slow
def test_teams_have_rows_of_their_own(scenario):
    teams = (Strategy(), Strategy(2), Strategy(2, 'independent', 0.25))
    scenario = replace(scenario, teams=teams, lethalities=(0.9,), trials=2)
    results = run(scenario)
    summary = summarise(results)
    rows = {(row['method'], row['agents'], row['loss_cost']): row for row in summary['rows']}
    assert len(rows) == len(summary['rows']) == 3 * 3
    reference, other = (
        results.series(0.9, method, *LOG_LOSS, team=teams[2])[:, -1]
        for method in ('kappa_bnitp', 'relaxed_bnitp')
    )
    row = rows['relaxed_bnitp', 2, 0.25]
    assert row['log_loss']['mean'] == pytest.approx(other.mean(), abs=1e-6)
    assert row['difference']['mean'] == pytest.approx((reference - other).mean(), abs=1e-6)
    assert (
        '| `kappa_bnitp_published`, 2 independent, loss cost 0.25 |'
        in table_of(summary).markdown()
    )
    table = results.table().to_pylist()
    assert len(table) == 9 * 2 * 5
    assert {(r['agents'], r['allocation'], r['loss_cost']) for r in table} == {
        (team.agents, team.allocation, team.loss_cost) for team in teams
    }


def test_a_single_trial_has_no_interval(results):
    alone = {trial: outcome for trial, outcome in results.outcomes.items() if not trial.number}
    summary = summarise(Results(replace(results.scenario, trials=1), alone))
    assert summary['rows'][0]['entropy']['low'] is None
    json.dumps(summary, allow_nan=False)
    assert '[' not in table_of(summary).markdown().split('|---|')[1]


def test_the_table_for_people_says_what_the_summary_says(results):
    summary = summarise(results)
    lines = table_of(summary).markdown().splitlines()
    cells = [line.strip('| ').split(' | ') for line in lines if line.startswith('| 0')]
    assert len(cells) == len(summary['rows'])
    for row, (lethality, method, log_loss, *_) in zip(summary['rows'], cells):
        assert float(lethality) == row['lethality']
        assert method == f'`{row["method"]}`'
        entry = row['log_loss']
        assert log_loss == f'{entry["mean"]:.1f} [{entry["low"]:.1f}, {entry["high"]:.1f}]'
