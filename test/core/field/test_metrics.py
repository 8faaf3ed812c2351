# SPDX-License-Identifier: Apache-2.0
"""How far beliefs are from the world, and that the exact ones are as near as can be."""

from math import isfinite, log

import brute_force
from kbnitp_ros.core import Belief, brier_score, Grid, log_loss, SensorModel, update, World
from laws import for_each
import numpy as np
import pytest


@for_each('seed', range(10))
def test_scores_by_their_formulas(seed):
    rng = np.random.default_rng(seed)
    believed, truth = rng.uniform(0.001, 0.999, 30), rng.random(30) < 0.5
    expected = -sum(log(p if there else 1 - p) for p, there in zip(believed, truth))
    assert log_loss(believed, truth) == pytest.approx(expected, rel=1e-12)
    expected = sum((p - there) ** 2 for p, there in zip(believed, truth))
    assert brier_score(believed, truth) == pytest.approx(expected, rel=1e-12)


def test_certainty_costs_nothing_when_right_and_much_when_wrong():
    believed = np.array([0.0, 1.0, 1.0])
    assert log_loss(believed, [False, True, True]) == pytest.approx(0, abs=1e-12)
    assert brier_score(believed, [False, True, True]) == 0
    one, two = log_loss(believed, [False, True, False]), log_loss(believed, [True, True, False])
    assert isfinite(two)
    assert one > 30
    assert two == pytest.approx(2 * one)
    assert brier_score(believed, [True, True, False]) == 2


@for_each('score', [log_loss, brier_score])
def test_a_truth_of_another_size_is_refused(score):
    with pytest.raises(ValueError, match='truth'):
        score(np.array([0.5, 0.5, 0.5]), [True])


@pytest.fixture(scope='module')
def one_deployment_each():
    """Beliefs, exact and as published, of many worlds drawn from the prior."""
    grid, model, rng = Grid(3, 3), SensorModel(0.6), np.random.default_rng(1)
    prior = Belief.prior(grid, 0.3, 0.36, 0.8)
    drawn = []
    for _ in range(600):
        world = World.random(grid, rng, 0.3, 0.8, target_background=(0.36 - 0.24) / 0.7)
        path = brute_force.random_path(rng, 3, 3, 0, 8)
        seen = world.traverse(path, model, rng)
        drawn.append(
            (
                world,
                seen,
                update(prior, model, seen),
                update(prior, model, seen, 'kappa_bnitp_published'),
            )
        )
    return prior, drawn


def test_exact_beliefs_are_calibrated(one_deployment_each):
    """What is believed with p is there with frequency p."""
    _, drawn = one_deployment_each
    for name in ('hazard', 'target'):
        believed = np.concatenate([getattr(exact, name) for _, _, exact, _ in drawn])
        there = np.concatenate([getattr(world, name) for world, _, _, _ in drawn])
        for low, high in ((0.0, 0.2), (0.2, 0.4), (0.4, 1.0)):
            group = (believed >= low) & (believed < high)
            assert group.sum() > 100
            # Cells of one world share a fate, so the spread of independent cells is too small.
            spread = 2 * np.sqrt((believed[group] * (1 - believed[group])).sum())
            assert abs(there[group].sum() - believed[group].sum()) < 4 * spread


def test_exact_beliefs_have_the_least_log_loss(one_deployment_each):
    prior, drawn = one_deployment_each
    lost = [case for case in drawn if not case[1].survived]
    assert len(lost) > 200
    exact, published, unchanged = (
        np.array([log_loss(belief.hazard, world.hazard) for world, belief in pairs])
        for pairs in (
            [(w, e) for w, _, e, _ in lost],
            [(w, p) for w, _, _, p in lost],
            [(w, prior) for w, _, _, _ in lost],
        )
    )
    for other in (published, unchanged):
        gain = other - exact
        assert gain.mean() > 3 * gain.std() / np.sqrt(len(gain))
