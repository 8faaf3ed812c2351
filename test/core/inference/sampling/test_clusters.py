# SPDX-License-Identifier: Apache-2.0
"""Sampling clustered hazards, against the posterior by enumeration."""

import brute_force
from extent import FULL
from kbnitp_ros.core import (
    Belief,
    Clustering,
    Estimator,
    Grid,
    SensorModel,
    Unknowns,
    World,
)
from laws import for_each
import numpy as np
import pytest

METHOD = 'kappa_bnitp_sampled'
KAPPA, BACKGROUND = 0.8, 0.1
GRIDS = [(2, 3), (3, 3), (4, 3)]


def uniform_prior(grid, density):
    """Return a prior of one density, with no hazard at the base."""
    return Belief.prior(grid, density, density * KAPPA + (1 - density) * BACKGROUND, KAPPA)


def likelihood(states, model, observations):
    survival = np.array(brute_force.step_survival(model))
    positive = np.array(brute_force.detection(model))
    looks = np.ones((2, states.shape[1]))
    product_of = np.ones(len(states))
    for observation in observations:
        survived = np.prod(survival[states[:, observation.path[1:]]], axis=1)
        product_of *= survived if observation.survived else 1.0 - survived
        if observation.survived:
            for cell, reading in zip(observation.path[1:], observation.readings):
                looks[:, cell] *= positive if reading else 1.0 - positive
    by_hazard = np.array([BACKGROUND, KAPPA])
    read = by_hazard[:, None] * looks[1] + (1.0 - by_hazard[:, None]) * looks[0]
    return product_of * np.prod(read[states, np.arange(states.shape[1])], axis=1)


def posterior(grid, couplings, density, model, observations):
    by_coupling = []
    for coupling in couplings:
        states, weight = brute_force.clustered_prior(grid, coupling, density)
        by_coupling.append(weight * likelihood(states, model, observations))
    joint = np.array(by_coupling) / np.sum(by_coupling)
    return joint.sum(axis=0) @ states, joint.sum(axis=1)


def random_mission(seed, malfunction=0.05):
    rng = np.random.default_rng([2024, seed])
    width, height = GRIDS[seed % 3]
    blocked = (5,) if seed % 5 == 0 else ()
    grid = Grid(width, height, base=int(rng.integers(5)), blocked=blocked)
    clustering = Clustering(grid, 'learn' if seed % 2 else float(rng.uniform(0.1, 1.7)))
    density = float(rng.uniform(0.05, 0.5))
    model = SensorModel(float(rng.choice([0.1, 0.5, 0.9])), malfunction)
    coupling = float(rng.choice(clustering.bins.values))
    states, weight = brute_force.clustered_prior(grid, coupling, density)
    hazard = states[rng.choice(len(states), p=weight)].astype(bool)
    target = rng.random(grid.cells) < np.where(hazard, KAPPA, BACKGROUND)
    world = World(hazard, target)
    paths = []
    while len(paths) < 10:
        steps = int(rng.integers(2, 8))
        path = brute_force.random_path(rng, width, height, grid.base, steps)
        if not set(path) & set(blocked):
            paths.append(path)
    observations = [world.traverse(path, model, rng) for path in paths]
    return grid, clustering, density, model, observations


def new_estimator(grid, clustering, density, model, seed=0):
    return Estimator(uniform_prior(grid, density), model, METHOD, seed=seed, clustering=clustering)


def divergence(exact, hazard):
    p, q = np.stack([exact, 1 - exact]), np.stack([hazard, 1 - hazard])
    inside = p > 1e-12
    return float((p[inside] * np.log(p[inside] / q[inside])).sum())


def divergences(seeds):
    of_beliefs, of_couplings = [], []
    for seed in seeds:
        grid, clustering, density, model, observations = random_mission(seed)
        estimator = new_estimator(grid, clustering, density, model, seed)
        for observation in observations:
            estimator.assimilate(observation)
        couplings = clustering.bins.values
        exact, weights = posterior(grid, couplings, density, model, observations)
        of_beliefs.append(divergence(exact, estimator.belief.hazard))
        if clustering.coupling == 'learn':
            mean = estimator.parameters['coupling'].mean
            of_couplings.append(abs(mean - weights @ couplings))
    return of_beliefs, of_couplings


def test_beliefs_are_those_of_enumeration(record_property):
    of_beliefs, of_couplings = divergences(range(300 if FULL else 9))
    record_property('divergences', np.percentile(of_beliefs, [50, 90, 99, 100]).tolist())
    assert np.mean(of_beliefs) < 0.001
    assert np.quantile(of_beliefs, 0.95) < 0.003
    assert np.mean(of_couplings) < 0.02


@for_each('seed', range(6))
def test_the_belief_before_any_robot_is_the_prior(seed):
    grid, clustering, density, model, _ = random_mission(seed)
    exact, _ = posterior(grid, clustering.bins.values, density, model, [])
    estimator = new_estimator(grid, clustering, density, model)
    assert estimator.belief.hazard == pytest.approx(exact, abs=0.01)
    # Targets follow hazards as in the prior.
    belief, prior = estimator.belief, uniform_prior(grid, density)
    assert belief.kappa[belief.hazard > 0] == pytest.approx(prior.kappa[belief.hazard > 0])


def test_draws_are_clustered():
    grid = Grid(6, 6)
    shared = []
    for coupling in (0.0, 1.2):
        estimator = new_estimator(grid, Clustering(grid, coupling), 0.2, SensorModel(0.5))
        maps = estimator.draws(2000, np.random.default_rng(0))[0].reshape(-1, 6, 6)
        shared.append((maps[:, 1:] & maps[:, :-1]).mean())
        assert maps.mean() * 36 / 35 == pytest.approx(0.2, abs=0.01)
    assert shared[1] > 1.5 * shared[0]


@pytest.mark.slow
def test_density_and_coupling_are_learnt_together():
    """On a field that was fully observed, against all densities and couplings."""
    grid = Grid(4, 3)
    clustering, unknowns = Clustering(grid, 'learn'), Unknowns(hazard_density=(0.05, 0.6))
    hazard = np.zeros(12, bool)
    hazard[[2, 3, 6, 7]] = True
    # A safe, perfect sensor of targets that are hazards reveals them all.
    model = SensorModel(0.0, 0.0, true_positive=1.0 - 1e-9, false_positive=1e-9)
    prior = Belief.prior(grid, 0.3, 0.3, 1.0)
    estimator = Estimator(prior, model, METHOD, unknowns, clustering=clustering)
    path = [0, 1, 2, 3, 7, 11, 10, 6, 9, 8, 5, 4, 0]
    world = World(hazard, hazard)
    for seed in range(12):
        estimator.assimilate(world.traverse(path, model, np.random.default_rng(seed)))
    bins = unknowns.hazard_density.bins()
    weights = np.empty((clustering.bins.values.size, bins.values.size))
    for row, coupling in enumerate(clustering.bins.values):
        for column, density in enumerate(bins.values):
            states, weight = brute_force.clustered_prior(grid, coupling, density)
            here = weight[(states == hazard).all(axis=1)].item()
            weights[row, column] = here * np.exp(bins.log_prior[column])
    weights /= weights.sum()
    means = weights.sum(axis=1) @ clustering.bins.values, weights.sum(axis=0) @ bins.values
    found = estimator.parameters['coupling'].mean, estimator.parameters['hazard_density'].mean
    assert found == pytest.approx(means, abs=0.03)


def test_a_coupling_of_0_is_no_clustering_bit_for_bit():
    grid, _, density, model, observations = random_mission(1)
    beliefs = []
    for clustering in (None, Clustering(grid, 0.0)):
        estimator = new_estimator(grid, clustering, density, model)
        for observation in observations:
            estimator.assimilate(observation)
        beliefs.append(estimator.belief.joint.tobytes())
    assert beliefs[0] == beliefs[1]
