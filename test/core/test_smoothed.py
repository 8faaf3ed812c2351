# SPDX-License-Identifier: Apache-2.0
"""All losses held together, against the posterior given all evidence at once."""

import brute_force
from kbnitp_ros.core import Belief, Estimator, Observation, SensorModel, update
import numpy as np
import pytest


def random_mission(rng, width, height, robots, malfunction=0.05):
    """Draw a belief, a model and what robots on random walks met in a world of that belief."""
    joint = brute_force.random_joint(rng, width * height, 0)
    model = SensorModel(float(rng.uniform(0.1, 1)), malfunction=malfunction)
    world = np.array([rng.choice(4, p=cell.ravel()) for cell in joint])
    s, on = brute_force.step_survival(model), brute_force.detection(model)
    seen = []
    for _ in range(robots):
        path = brute_force.random_path(rng, width, height, 0, int(rng.integers(2, 6)))
        survived = all(rng.random() < s[world[cell] // 2] for cell in path[1:])
        readings = [bool(rng.random() < on[world[cell] % 2]) for cell in path[1:]]
        seen.append((path, readings if survived else None))
    return joint, model, seen


def smoothed(joint, model, seen):
    estimator = Estimator(Belief(joint), model, 'kappa_bnitp_smoothed')
    for path, readings in seen:
        estimator.assimilate(Observation(path, readings is not None, readings))
    return estimator.belief.joint


@pytest.mark.parametrize('seed', range(60))
def test_one_deployment_is_taken_in_exactly(seed):
    rng = np.random.default_rng(seed)
    joint, model, seen = random_mission(rng, 3, 3, 1)
    path, readings = seen[0]
    exact = update(Belief(joint), model, Observation(path, readings is not None, readings)).joint
    np.testing.assert_allclose(smoothed(joint, model, seen), exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize('seed', range(40))
def test_a_few_uncertain_cells_are_taken_in_exactly(seed):
    joint, model, seen = random_mission(np.random.default_rng(seed), 2, 2, 8)
    exact = brute_force.posterior(joint, model, *seen)
    np.testing.assert_allclose(smoothed(joint, model, seen), exact, rtol=0, atol=1e-9)


def test_losses_in_a_chain_are_taken_in_exactly():
    """Each loss shares one cell with the next: no cycle, so messages settle on the posterior."""
    rng = np.random.default_rng(0)
    joint, model = brute_force.random_joint(rng, 8, 0), SensorModel(0.6)
    seen = [([0, cell, cell + 1, 0], None) for cell in range(1, 7)]
    exact = brute_force.posterior(joint, model, *seen)
    np.testing.assert_allclose(smoothed(joint, model, seen), exact, rtol=0, atol=1e-6)


def test_many_losses_are_taken_in_closer_than_by_one_pass():
    worse, better = [], []
    for seed in range(30):
        joint, model, seen = random_mission(np.random.default_rng(seed), 4, 2, 12)
        exact = brute_force.posterior(joint, model, *seen)
        one_pass = Belief(joint)
        for path, readings in seen:
            one_pass = update(one_pass, model, Observation(path, readings is not None, readings))
        worse.append(abs(one_pass.joint - exact).max())
        better.append(abs(smoothed(joint, model, seen) - exact).max())
    assert np.mean(better) < 0.2 * np.mean(worse)
    assert max(better) < 0.05


@pytest.mark.parametrize('seed', range(20))
def test_the_order_of_deployments_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    joint, model, seen = random_mission(rng, 2, 2, 6)
    shuffled = [seen[i] for i in rng.permutation(len(seen))]
    np.testing.assert_allclose(
        smoothed(joint, model, seen), smoothed(joint, model, shuffled), rtol=0, atol=1e-9
    )


def test_a_refused_deployment_leaves_no_trace():
    joint = Belief.from_maps([0, 0, 0.5], [0.5] * 3, [0.5] * 3).joint
    model = SensorModel(0.5, malfunction=0.0)
    estimator = Estimator(Belief(joint), model, 'kappa_bnitp_smoothed')
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(Observation([0, 1, 0], False))
    assert estimator.belief.joint.tobytes() == joint.tobytes()
    estimator.assimilate(Observation([0, 1, 2, 0], False))
    unaware = smoothed(joint, model, [([0, 1, 2, 0], None)])
    assert estimator.belief.joint.tobytes() == unaware.tobytes()


def test_a_deployment_impossible_only_after_an_earlier_one_is_refused():
    """The loss can only be cell 1's doing, which is deadly: nobody returns from there."""
    belief = Belief.from_maps([0, 0.5], [0.5] * 2, [0.5] * 2)
    model = SensorModel(1.0, malfunction=0.0, false_negative=0.0)
    for method in ('kappa_bnitp', 'kappa_bnitp_smoothed'):
        estimator = Estimator(belief, model, method)
        estimator.assimilate(Observation([0, 1, 0], False))
        assert estimator.belief.hazard[1] == pytest.approx(1)
        before = estimator.belief.joint.tobytes()
        with pytest.raises(ValueError, match='impossible'):
            estimator.assimilate(Observation([0, 1, 0], True, [True, False]))
        assert estimator.belief.joint.tobytes() == before
