# SPDX-License-Identifier: Apache-2.0
"""All losses held together, against the posterior given all evidence at once."""

import brute_force
from kbnitp_ros.core import Belief, Estimator, Grid, Observation, SensorModel, update, World
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


HAZARDS = np.array([[0, *bits] for bits in np.ndindex(*15 * [2])], dtype=float)


def posterior_of_hazards(joint, model, seen):
    """Enumerate the hazards of 4x4 cells, none at the base; targets are told by them alone."""
    survive, on = np.array(brute_force.step_survival(model)), brute_force.detection(model)
    local, weight = joint.copy(), np.ones(len(HAZARDS))
    for path, readings in seen:
        if readings is None:
            exposed = HAZARDS @ np.bincount(path[1:], minlength=16)
            weight *= 1 - survive[0] ** (len(path) - 1 - exposed) * survive[1] ** exposed
        else:
            for cell, reading in zip(path[1:], readings):
                read = np.array([p if reading else 1 - p for p in on])
                local[cell] *= survive[:, None] * read
    of_hazard = local.sum(axis=2)
    weight *= np.where(HAZARDS, of_hazard[:, 1], of_hazard[:, 0]).prod(axis=1)
    hazard = weight @ HAZARDS / weight.sum()
    given = local / np.where(of_hazard > 0, of_hazard, 1)[:, :, None]
    return np.stack([1 - hazard, hazard], axis=-1)[:, :, None] * given


def divergence(exact, belief):
    """KL divergence of a belief from the exact one, nats, summed over the cells."""
    possible = exact > 0
    return (exact[possible] * np.log(exact[possible] / belief[possible])).sum()


@pytest.mark.parametrize('lethality', [0.1, 0.3, 0.5, 0.9])
def test_a_mission_is_taken_in_nearly_exactly(lethality):
    """25 robots on 4x4 cells from a prior of maximum entropy."""
    model = SensorModel(lethality)
    joint = Belief.prior(Grid(4, 4), 0.5, 0.45, 0.8).joint
    near, far = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world = World.random(Grid(4, 4), rng, 0.5, 0.8, 0.1)
        paths = [brute_force.random_path(rng, 4, 4, 0, rng.integers(1, 11)) for _ in range(25)]
        observations = [world.traverse(path, model, rng) for path in paths]
        seen = [(o.path.tolist(), o.readings) for o in observations]
        exact = posterior_of_hazards(joint, model, seen)
        one_pass = Estimator(Belief(joint), model)
        for observation in observations:
            one_pass.assimilate(observation)
        near.append(divergence(exact, smoothed(joint, model, seen)))
        far.append(divergence(exact, one_pass.belief.joint))
    assert np.mean(near) < 1e-4
    assert np.mean(near) < 0.01 * np.mean(far)
