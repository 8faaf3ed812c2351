# SPDX-License-Identifier: Apache-2.0
"""Losses as a Bayesian network, in pyAgrum: what the methods come to beside its posterior."""

from kbnitp_ros.core import Belief, Estimator, Observation, SensorModel, update
from laws import for_each
import numpy as np
import pyagrum

NETWORKS = 50
MOST_CELLS = 12


def draw(seed, losses):
    """Draw a belief of at most 12 cells and the base, a sensor model, and lost paths."""
    rng = np.random.default_rng(seed)
    cells = int(rng.integers(2, MOST_CELLS + 1))
    hazard = np.append(0.0, rng.uniform(0.02, 0.8, cells))
    target = rng.uniform(0.1, 0.9, cells + 1)
    model = SensorModel(rng.uniform(0.05, 1.0), rng.choice([0.0, 0.05, 0.3]))
    paths = [[0, *rng.integers(1, cells + 1, rng.integers(1, 15)), 0] for _ in range(losses)]
    return Belief.from_maps(hazard, target, target), model, paths


def posterior(belief, model, paths):
    """Return P(Z = 1 | all robots lost): each loss is a noisy-OR of the hazards on its path."""
    safe, hazardous = model.survival([0, 1]).tolist()
    net = pyagrum.BayesNet()
    for cell, hazard in enumerate(belief.hazard):
        net.add(pyagrum.LabelizedVariable(f'z{cell}', '', 2))
        net.cpt(f'z{cell}').fillWith([1.0 - hazard, hazard])
    for number, path in enumerate(paths):
        leak = 1.0 - safe ** (len(path) - 1)
        lost = net.addNoisyORNet(pyagrum.LabelizedVariable(f'lost{number}', '', 2), leak)
        for cell, visits in zip(*np.unique(path[1:], return_counts=True)):
            net.addWeightedArc(
                net.idFromName(f'z{cell}'), lost, 1.0 - (hazardous / safe) ** int(visits)
            )
    inference = pyagrum.LazyPropagation(net)
    inference.setEvidence({f'lost{number}': 1 for number in range(len(paths))})
    inference.makeInference()
    return np.array([inference.posterior(f'z{cell}')[1] for cell in range(belief.cells)])


def averaged_universes(belief, model, path):
    """Return P(Z = 1 | lost), averaged over the step at which the robot was destroyed."""
    safe, hazardous = model.survival([0, 1])
    weights, hazards = [], []
    alive = np.stack([1.0 - belief.hazard, belief.hazard])
    for cell in path[1:]:
        # Destroyed here: all steps before were survived, and this one was not.
        here = alive.copy()
        here[:, cell] *= 1.0 - np.array([safe, hazardous])
        total = here.sum(axis=0)
        weights.append(total.prod())
        hazards.append(here[1] / np.where(total > 0.0, total, 1.0))
        alive[:, cell] *= safe, hazardous
    return np.average(hazards, axis=0, weights=weights)


@for_each('seed', range(NETWORKS))
def test_one_loss_says_the_same_in_the_network_the_universes_and_the_update(seed):
    belief, model, (path,) = draw(seed, 1)
    expected = posterior(belief, model, [path])
    lost = Observation(path, survived=False)
    for method in ('kappa_bnitp', 'relaxed_itp'):
        found = update(belief, model, lost, method).hazard
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    universes = averaged_universes(belief, model, path)
    np.testing.assert_allclose(universes, expected, rtol=0, atol=1e-12)


def test_several_losses_are_tied_together_in_the_network_and_by_sampling():
    off = {'kappa_bnitp': [], 'kappa_bnitp_sampled': []}
    for seed in range(100, 120):
        belief, model, paths = draw(seed, 6)
        expected = posterior(belief, model, paths)
        for method, errors in off.items():
            estimator = Estimator(belief, model, method)
            for path in paths:
                estimator.assimilate(Observation(path, survived=False))
            errors.append(abs(estimator.belief.hazard - expected).max())
    # One loss after another forgets that each ties the cells of its path together.
    assert np.mean(off['kappa_bnitp_sampled']) < 0.3 * np.mean(off['kappa_bnitp'])
    assert max(off['kappa_bnitp_sampled']) < 0.05
