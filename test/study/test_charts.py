# SPDX-License-Identifier: Apache-2.0
"""Figures are drawn of any study, and reliability is what it says."""

from dataclasses import replace

from disk import room_for
from kbnitp_ros.study.charts import reliability
from kbnitp_ros.study.comparison import write_report
from kbnitp_ros.study.results import Results
from laws import for_each
import numpy as np
import pytest

pytestmark = pytest.mark.slow


def test_a_belief_that_means_what_it_says_is_on_the_diagonal():
    rng = np.random.default_rng(0)
    believed = rng.random((25, 4000))
    held, there = reliability(believed, rng.random(believed.shape) < believed)
    np.testing.assert_allclose(held, np.arange(0.05, 1, 0.1), atol=0.01)
    np.testing.assert_allclose(there, held, atol=0.02)


def test_reliability_by_hand():
    believed = np.array([0.9, 0.1, 0.9, 0.2] * 5)
    truth = np.array([True, False, False, True] * 5)
    held, there = reliability(believed, truth)
    np.testing.assert_allclose(held, [0.1, 0.1, 0.15, 0.2, 0.2, 0.9, 0.9, 0.9, 0.9, 0.9])
    assert there[:5].tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]


def test_few_cells_make_few_classes():
    held, there = reliability(np.array([[0.7], [0.2]]), np.array([[True], [False]]))
    assert held.tolist() == [0.2, 0.7]
    assert there.tolist() == [0.0, 1.0]


@for_each('lethalities, trials', [((0.2, 0.9), 3), ((0.9,), 1)], every=2)
def test_every_study_has_its_report(results, tmp_path, pictures, lethalities, trials):
    scenario = replace(results.scenario, lethalities=lethalities, trials=trials)
    written = write_report(Results(scenario, results.outcomes), tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert all(path.stat().st_size for path in written)


def test_a_disk_that_has_no_room_for_the_report_is_named(results, tmp_path):
    with room_for(1000), pytest.raises(OSError, match=f'File too large: {str(tmp_path)!r}'):
        write_report(results, tmp_path)
