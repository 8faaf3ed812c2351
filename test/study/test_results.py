# SPDX-License-Identifier: Apache-2.0
"""The table has one row for every deployment of every trial."""

from kbnitp_ros.study.results import Results
from kbnitp_ros.study.trial import MEASURES, Trial
import numpy as np


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
