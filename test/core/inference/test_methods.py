# SPDX-License-Identifier: Apache-2.0
"""The belief after a deployment, against enumeration, the paper and a network of noisy-ORs."""

import brute_force
from kbnitp_ros.core import (
    Belief,
    Estimator,
    Grid,
    METHODS,
    Observation,
    SensorModel,
    update,
)
from laws import for_each
import numpy as np
import pyagrum
import pytest


def deployments(seed, most_cells, most_steps):
    rng = np.random.default_rng(seed)
    joint, sensors, path = brute_force.random_case(rng, most_cells, most_steps)
    model = SensorModel(**sensors)
    readings = rng.random(len(path) - 1) < 0.5
    can_be_lost = brute_force.evidence_probability(joint, model, path, None) > 0
    if seed % 2 and can_be_lost:
        return joint, model, Observation(path, False)
    return joint, model, Observation(path, True, readings)


@for_each('seed', range(400), every=4)
def test_exact_update_is_the_enumeration_of_all_states(seed):
    joint, model, observation = deployments(seed, most_cells=6, most_steps=10)
    expected = brute_force.posterior(
        joint, model, (observation.path.tolist(), observation.readings)
    )
    after = update(Belief(joint), model, observation)
    np.testing.assert_allclose(after.joint, expected, rtol=0, atol=1e-12)


@for_each('seed', range(400), every=4)
def test_published_update_is_the_paper_equations_summed_out(seed):
    joint, model, observation = deployments(seed, most_cells=6, most_steps=7)
    path = observation.path.tolist()
    if observation.survived:
        expected = brute_force.published_return(joint, model, path, observation.readings)
    else:
        expected = brute_force.published_loss(joint, model, path)
    after = update(Belief(joint), model, observation, 'kappa_bnitp_published')
    for cell, (hazard, target, kappa) in expected.items():
        assert after.hazard[cell] == pytest.approx(hazard, abs=1e-12)
        assert after.target[cell] == pytest.approx(target, abs=1e-12)
        if hazard > 1e-12:  # kappa of a cell without hazard is undetermined
            assert after.kappa[cell] == pytest.approx(kappa, abs=1e-12 + 1e-15 / hazard)


def without_kappa(joint):
    hazard, target = joint.sum(axis=2), joint.sum(axis=1)
    return hazard[:, :, None] * target[:, None, :]


@for_each(
    'relaxed, correlated',
    [('relaxed_itp', 'kappa_bnitp'), ('relaxed_bnitp', 'kappa_bnitp_published')],
)
@for_each('seed', range(60))
def test_methods_without_kappa_start_from_kappa_equal_to_target(seed, relaxed, correlated):
    joint, model, observation = deployments(seed, most_cells=6, most_steps=10)
    estimator = Estimator(Belief(joint), model, relaxed)
    np.testing.assert_allclose(estimator.belief.joint, without_kappa(joint), rtol=0, atol=1e-15)
    estimator.assimilate(observation)
    expected = update(Belief(without_kappa(joint)), model, observation, correlated)
    np.testing.assert_allclose(estimator.belief.joint, expected.joint, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        estimator.belief.joint, without_kappa(estimator.belief.joint), rtol=0, atol=1e-12
    )


@for_each('hazard', [1e-3, 1e-6, 1e-9, 1e-12])
def test_rare_hazards_of_a_perfect_robot_are_told_apart(hazard):
    """Two cells may equally have destroyed it; no precision is lost to 1 - (1 - tiny)."""
    belief = Belief.from_maps([0.0, hazard, 2 * hazard], [0.5] * 3, [0.5] * 3)
    model = SensorModel(0.9, malfunction=0.0)
    after = update(belief, model, Observation([0, 1, 2, 0], False))
    expected = brute_force.posterior(belief.joint, model, ([0, 1, 2, 0], None))
    np.testing.assert_allclose(after.hazard, expected[:, 1].sum(axis=1), rtol=1e-9)
    np.testing.assert_allclose(after.hazard, [0, 1 / 3, 2 / 3], atol=2 * hazard)


def test_an_unknown_method_is_refused_with_the_known_ones():
    belief = Belief.from_maps([0.0, 0.5], [0.5, 0.5], [0.5, 0.5])
    everyone = '(?=.*' + ')(?=.*'.join(METHODS) + ')'
    with pytest.raises(ValueError, match=f'method.*kappa_magic{everyone}'):
        update(belief, SensorModel(0.5), Observation([0, 1, 0], False), 'kappa_magic')
    with pytest.raises(ValueError, match=f'method.*kappa_magic{everyone}'):
        Estimator(belief, SensorModel(0.5), 'kappa_magic')


def test_versions_are_known():
    prior = Belief.prior(Grid(3, 3), 0.5, 0.45, 0.8)
    assert {name: Estimator(prior, SensorModel(0.5), name).version for name in METHODS} == {
        **dict.fromkeys(METHODS, 1),
        'kappa_bnitp_sampled': 3,
    }


MAX_CELLS = 12


def draw(seed, losses):
    """Draw a belief of at most 12 cells and the base, a sensor model, and paths of losses."""
    rng = np.random.default_rng(seed)
    cells = int(rng.integers(2, MAX_CELLS + 1))
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


def test_several_losses_are_correlated_in_the_network_and_by_sampling():
    off = {'kappa_bnitp': [], 'kappa_bnitp_sampled': []}
    for seed in range(100, 120):
        belief, model, paths = draw(seed, 6)
        expected = posterior(belief, model, paths)
        for method, errors in off.items():
            estimator = Estimator(belief, model, method)
            for path in paths:
                estimator.assimilate(Observation(path, survived=False))
            errors.append(abs(estimator.belief.hazard - expected).max())
    # Folding one loss after another loses the correlation between cells of a path.
    assert np.mean(off['kappa_bnitp_sampled']) < 0.3 * np.mean(off['kappa_bnitp'])
    assert max(off['kappa_bnitp_sampled']) < 0.05
