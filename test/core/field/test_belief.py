# SPDX-License-Identifier: Apache-2.0
"""Beliefs are distributions, and are measured by their formulas."""

from math import isfinite, log

import brute_force
from kbnitp_ros.core import Belief, brier_score, Grid, log_loss
from laws import for_each
import numpy as np
import pytest


def marginals(joint):
    hazard = joint[:, 1].sum(axis=1)
    return hazard, joint[:, :, 1].sum(axis=1), joint[:, 1, 1] / hazard


def naive_entropy(probabilities):
    return -sum(p * log(p) for p in probabilities if p > 0)


@for_each('seed', range(20))
def test_maps_and_joint_are_views_of_each_other(seed):
    joint = np.random.default_rng(seed).dirichlet(np.full(4, 0.7), 30).reshape(-1, 2, 2)
    hazard, target, kappa = marginals(joint)
    belief = Belief.from_maps(hazard, target, kappa)
    np.testing.assert_allclose(belief.joint, joint, atol=1e-14)
    np.testing.assert_allclose(belief.hazard, hazard, atol=1e-14)
    np.testing.assert_allclose(belief.target, target, atol=1e-14)
    np.testing.assert_allclose(belief.kappa, kappa, atol=1e-12)
    again = Belief(joint)
    np.testing.assert_allclose(again.hazard, hazard, atol=1e-15)
    np.testing.assert_allclose(again.target, target, atol=1e-15)
    np.testing.assert_allclose(again.kappa, kappa, rtol=1e-14)


def test_the_extremes_have_a_joint():
    belief = Belief.from_maps([0, 1, 1, 0.5, 0.5], [0.3, 0.7, 0, 1, 0.5], [0.3, 0.7, 0, 1, 1])
    np.testing.assert_allclose(
        belief.joint.reshape(-1, 4),
        [[0.7, 0.3, 0, 0], [0, 0, 0.3, 0.7], [0, 0, 1, 0], [0, 0.5, 0, 0.5], [0.5, 0, 0, 0.5]],
        atol=1e-15,
    )
    assert (belief.joint >= 0).all()


def test_views_never_leave_the_probabilities_by_rounding():
    """from_maps accepts the maps of any belief, also near certainty."""
    joint = np.random.default_rng(0).dirichlet([1e-3, 1.0, 1e-3, 1.0], 20000).reshape(-1, 2, 2)
    for nearly in (joint, joint.transpose(0, 2, 1)):
        belief = Belief(nearly)
        for view in (belief.hazard, belief.target, belief.kappa):
            assert view.max() <= 1
        again = Belief.from_maps(belief.hazard, belief.target, belief.kappa)
        np.testing.assert_allclose(again.joint, nearly, rtol=0, atol=1e-9)
        assert np.isfinite(belief.entropy())


def test_kappa_is_the_target_where_there_is_no_hazard():
    belief = Belief([[[0.7, 0.3], [0.0, 0.0]], [[0.5, 0.3], [0.1, 0.1]]])
    np.testing.assert_allclose(belief.kappa, [0.3, 0.5], atol=1e-15)


def test_prior_has_no_hazard_at_the_base_and_nothing_in_blocked_cells():
    grid = Grid(3, 2, base=4, blocked=(1, 5))
    belief = Belief.prior(grid, hazard=0.5, target=0.45, kappa=0.8)
    usual = [[0.45, 0.05], [0.1, 0.4]]
    for cell in (0, 2, 3):
        np.testing.assert_allclose(belief.joint[cell], usual, atol=1e-15)
    np.testing.assert_allclose(belief.joint[4], [[0.9, 0.1], [0, 0]], atol=1e-15)
    for cell in (1, 5):
        assert belief.joint[cell].tolist() == [[1, 0], [0, 0]]


def test_prior_takes_maps():
    """At the base the target is q = (0.3 - 0.4 * 0.5) / 0.5, the target without a hazard."""
    grid = Grid(3, 1, base=1)
    hazard, target, kappa = [0.2, 0.5, 0.4], [0.5, 0.3, 0.2], [0.9, 0.4, 0.1]
    belief = Belief.prior(grid, hazard, target, kappa)
    np.testing.assert_allclose(belief.hazard, [0.2, 0.0, 0.4], atol=1e-15)
    np.testing.assert_allclose(belief.target, [0.5, 0.2, 0.2], atol=1e-15)
    np.testing.assert_allclose(belief.kappa, [0.9, 0.2, 0.1], atol=1e-14)


@for_each('seed', range(10))
def test_entropies(seed):
    joint = brute_force.random_joint(np.random.default_rng(seed), 20, base=3)
    joint[0] = [[1, 0], [0, 0]]
    joint[1] = [[0, 0], [0, 1]]
    belief = Belief(joint)
    by_map = sum(naive_entropy([p, 1 - p]) for p in joint[:, 1].sum(axis=1))
    by_map += sum(naive_entropy([p, 1 - p]) for p in joint[:, :, 1].sum(axis=1))
    assert belief.entropy() == pytest.approx(by_map, rel=1e-12)
    assert belief.joint_entropy() == pytest.approx(naive_entropy(joint.ravel()), rel=1e-12)


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
