# SPDX-License-Identifier: Apache-2.0
"""Sampling, against the posterior by enumeration of all states and all values."""

from functools import cache
from math import log
import os
import subprocess
import sys

import brute_force
from extent import FULL
from kbnitp_ros.core import (
    Belief,
    Beta,
    Estimator,
    Grid,
    Observation,
    SensorModel,
    Unknowns,
    World,
)
from kbnitp_ros.core.inference import sampler
from laws import for_each
import numpy as np
import pytest

METHOD = 'kappa_bnitp_sampled'
EVERYTHING = {
    'lethality': (0.05, 1.0),
    'malfunction': Beta(2, 20),
    'hazard_density': (0.0, 0.9),
    'kappa': Beta(3, 2, low=0.1),
    'target_background': (0.02, 0.7),
    'true_positive': (0.5, 1.0),
    'false_positive': Beta(1, 4, high=0.6),
}


def observed(path, readings=None, steps_survived=0):
    return Observation(path, readings is not None, readings, steps_survived)


def assimilated(prior, model, observations, unknowns=Unknowns(), seed=0):  # noqa: B008
    estimator = Estimator(prior, model, METHOD, unknowns, seed)
    for observation in observations:
        estimator.assimilate(observation)
    return estimator


def random_mission(rng, width, height, robots, joint, model):
    world = np.array([rng.choice(4, p=cell.ravel()) for cell in joint])
    s, on = brute_force.step_survival(model), brute_force.detection(model)
    seen = []
    for _ in range(robots):
        path = brute_force.random_path(rng, width, height, 0, int(rng.integers(2, 6)))
        survived = [rng.random() < s[world[cell] // 2] for cell in path[1:]]
        readings = [int(rng.random() < on[world[cell] % 2]) for cell in path[1:]]
        if all(survived):
            looked = rng.random(len(readings)) < 0.9
            seen.append((path, np.where(looked, readings, -1)))
        else:
            contact = int(rng.integers(survived.index(False) + 1)) if rng.random() < 0.3 else 0
            seen.append((path, None, contact))
    return seen


def divergence(exact, belief):
    possible = exact > 0
    return (exact[possible] * np.log(exact[possible] / belief[possible])).sum()


def log_odds(p):
    return log(p / (1 - p))


def moved(probabilities, average):
    """Shift the log odds of all open cells to a given mean."""
    is_open = (probabilities > 0) & (probabilities < 1)
    if not is_open.any():
        return probabilities

    def by(offset):
        return 1 / (1 + np.exp(-np.array([log_odds(p) for p in probabilities[is_open]]) - offset))

    low, high = -60.0, 60.0
    while high - low > 1e-13:
        middle = (low + high) / 2
        low, high = (middle, high) if by(middle).mean() < average else (low, middle)
    after = probabilities.copy()
    after[is_open] = by(low)
    return after


def with_value(joint, model, name, value):
    if name in ('lethality', 'malfunction', 'true_positive', 'false_positive'):
        return joint, SensorModel(**{**vars(model), name: value})
    hazard = joint[:, 1].sum(axis=1)
    possible = hazard > 0
    kappa = np.divide(joint[:, 1, 1], hazard, out=np.zeros_like(hazard), where=possible)
    background = joint[:, 0, 1] / joint[:, 0].sum(axis=1)
    if name == 'hazard_density':
        hazard = moved(hazard, value)
    elif name == 'kappa':
        kappa[possible] = moved(kappa[possible], value)
    else:
        background = moved(background, value)
    safe = 1 - hazard
    cells = [safe * (1 - background), safe * background, hazard * (1 - kappa), hazard * kappa]
    return np.stack(cells, axis=-1).reshape(-1, 2, 2), model


def posterior(joint, model, seen, name, bins):
    """Return the weights of a number's values and the cells' joints, by enumeration."""
    evidence, joints = [], []
    for value in bins.values:
        prior, sensors = with_value(joint, model, name, value)
        probability, after = brute_force.weighed(prior, [(sensors, *each) for each in seen])
        evidence.append(probability)
        joints.append(after)
    weights = np.array(evidence) * np.exp(bins.log_prior)
    weights /= weights.sum()
    return weights, np.einsum('g,gczx->czx', weights, joints)


LEARNT = [
    *((name, 4) for name in EVERYTHING),
    # Cells that no robot entered.
    *((name, 9) for name in ('hazard_density', 'kappa', 'target_background')),
]


@pytest.mark.slow
@for_each('name, cells', LEARNT, every=4)
@for_each('seed', range(3 if FULL else 1))
def test_a_number_is_learnt_as_by_enumeration(name, cells, seed, monkeypatch):
    """By 20 robots on some 2x2 cells."""
    monkeypatch.setattr(sampler, 'CONVERGED_LEARNING', 0.0)
    rng = np.random.default_rng(seed)
    joint = brute_force.random_joint(rng, cells, 0)
    model = SensorModel(0.6, malfunction=0.1)
    seen = random_mission(rng, 2, 2, 20, joint, model)
    unknowns = Unknowns(**{name: EVERYTHING[name]})
    estimator = Estimator(Belief(joint), model, METHOD, unknowns)
    for number, deployment in enumerate(seen, 1):
        monkeypatch.setattr(sampler, 'MAX_SWEEPS', 400 if number == len(seen) else 4)
        estimator.assimilate(observed(*deployment))
    learnt = estimator.parameters[name]
    weights, after = posterior(joint, model, seen, name, learnt.bins)
    assert np.abs(learnt.weights - weights).sum() / 2 < 0.01
    assert learnt.mean == pytest.approx(weights @ learnt.bins.values, abs=0.003)
    assert divergence(after, estimator.belief.joint) < 1e-4
    assert estimator.parameters.keys() == {name}


HAZARDS = np.array([[0, *bits] for bits in np.ndindex(*15 * [2])], dtype=float)


@cache
def exposures(path):
    """Return the number of hazards that a path enters, for each state."""
    visits = np.bincount(np.frombuffer(path, dtype=np.intp)[1:], minlength=16)
    return (HAZARDS @ visits).astype(int)


def weight_of_hazards(joint, model, observations):
    """Enumerate the hazards of 4x4 cells, none at the base; targets follow from them."""
    survive, on = np.array(brute_force.step_survival(model)), brute_force.detection(model)
    local, weight = joint.copy(), np.ones(len(HAZARDS))
    for observation in observations:
        path = observation.path
        if observation.readings is None:
            exposed = exposures(path.tobytes())
            survived = [survive[0] ** (len(path) - 1 - n) * survive[1] ** n for n in range(11)]
            weight *= np.take(1 - np.array(survived), exposed)
        else:
            for cell, reading in zip(path[1:], observation.readings):
                read = np.array([p if reading else 1 - p for p in on])
                local[cell] *= survive[:, None] * read
    of_hazard = local.sum(axis=2)
    weight *= np.where(HAZARDS, of_hazard[:, 1], of_hazard[:, 0]).prod(axis=1)
    return weight, local


def marginals(weight, local):
    hazard = weight @ HAZARDS / weight.sum()
    of_hazard = local.sum(axis=2)
    given = local / np.where(of_hazard > 0, of_hazard, 1)[:, :, None]
    return np.stack([1 - hazard, hazard], axis=-1)[:, :, None] * given


FIELD = Grid(4, 4)
ENTROPIC = Belief.prior(FIELD, 0.5, 0.45, 0.8)


def mission_of_25(seed, model):
    rng = np.random.default_rng(seed)
    world = World.random(FIELD, rng, 0.5, 0.8, 0.1)
    paths = [brute_force.random_path(rng, 4, 4, 0, rng.integers(1, 11)) for _ in range(25)]
    return [world.traverse(path, model, rng) for path in paths]


@pytest.mark.slow
@for_each('lethality', [0.9, 0.1, 0.3, 0.5], every=4)
def test_a_mission_is_taken_in_nearly_exactly(lethality):
    """From a prior of maximum entropy."""
    model = SensorModel(lethality)
    away = []
    for seed in range(20 if FULL else 8):
        observations = mission_of_25(seed, model)
        exact = marginals(*weight_of_hazards(ENTROPIC.joint, model, observations))
        away.append(divergence(exact, assimilated(ENTROPIC, model, observations).belief.joint))
    assert np.mean(away) < 0.001


@pytest.mark.slow
def test_more_sweeps_converge_to_the_exact_posterior(monkeypatch):
    monkeypatch.setattr(sampler, 'CONVERGED', 0.0)
    model = SensorModel(0.5)
    observations = mission_of_25(3, model)
    exact = marginals(*weight_of_hazards(ENTROPIC.joint, model, observations))
    for sweeps, close in ((8, 1e-3), (128, 1e-4), (512, 3e-5))[: 3 if FULL else 2]:
        away, said = [], []
        # The estimate varies as much as its error, so a comparison takes many missions.
        for seed in range(20 if FULL else 6):
            monkeypatch.setattr(sampler, 'MAX_SWEEPS', 4)
            estimator = assimilated(ENTROPIC, model, observations[:-1], seed=seed)
            monkeypatch.setattr(sampler, 'MAX_SWEEPS', sweeps)
            estimator.assimilate(observations[-1])
            away.append(divergence(exact, estimator.belief.joint))
            said.append(estimator.sampling_error)
        assert np.mean(away) < close
        assert 0.5 < np.mean(said) / np.mean(away) < 2.0


@for_each('malfunction, lethality', [(0.0, 1.0), (0.0, 0.4), (0.2, 1.0)])
@for_each('seed', range(5))
def test_certain_cells_are_sampled(malfunction, lethality, seed):
    rng = np.random.default_rng(seed)
    joint = brute_force.random_joint(rng, 6, 0)
    joint[4] = [[0, 0], [0.3, 0.7]]
    model = SensorModel(lethality, malfunction=malfunction, false_negative=0.0)
    seen = random_mission(rng, 3, 2, 10, joint, model)
    exact = brute_force.posterior(joint, model, *seen)
    found = assimilated(Belief(joint), model, [observed(*deployment) for deployment in seen])
    np.testing.assert_allclose(found.belief.joint, exact, rtol=0, atol=0.02)


def test_without_losses_the_posterior_is_exact():
    rng = np.random.default_rng(1)
    joint, model = brute_force.random_joint(rng, 9, 0), SensorModel(0.5)
    seen = []
    for _ in range(6):
        path = brute_force.random_path(rng, 3, 3, 0, 5)
        seen.append((path, (rng.random(5) < 0.5).astype(int)))
    found = assimilated(Belief(joint), model, [observed(*deployment) for deployment in seen])
    exact = brute_force.posterior(joint, model, *seen)
    np.testing.assert_allclose(found.belief.joint, exact, rtol=0, atol=1e-12)
    assert found.sampling_error < 1e-12


def test_before_the_first_deployment_the_belief_is_the_prior():
    unknowns = Unknowns(**EVERYTHING)
    estimator = Estimator(ENTROPIC, SensorModel(0.5), METHOD, unknowns)
    density = 0.45
    kappa = estimator.parameters['kappa'].mean
    np.testing.assert_allclose(estimator.belief.hazard[1:], density, rtol=0, atol=1e-6)
    np.testing.assert_allclose(estimator.belief.kappa[1:], kappa, rtol=0, atol=1e-6)
    assert estimator.belief.hazard[0] == 0
    assert estimator.belief.target[0] == pytest.approx(0.36)
    assert estimator.model.lethality == pytest.approx(0.525)
    assert estimator.model.malfunction == pytest.approx(2 / 22, abs=1e-4)
    assert estimator.model.true_positive == pytest.approx(0.75)
    assert estimator.model.false_negative == 0.05
    assert estimator.sampling_error == 0
    for name, prior in unknowns.priors.items():
        learnt = estimator.parameters[name]
        assert prior.low <= learnt.quantile(0) < learnt.mean < learnt.quantile(1) <= prior.high
    uniform = estimator.parameters['lethality']
    assert uniform.sd == pytest.approx(0.95 / 12**0.5, rel=1e-3)
    assert uniform.quantile(0.25) == pytest.approx(0.05 + 0.95 / 4)


def test_the_model_to_plan_with_survives_and_reads_as_expected():
    """Without deployments lethality and malfunction are independent; a loss couples them."""
    unknowns = Unknowns(lethality=(0, 1), malfunction=(0, 1))
    belief = Belief.prior(Grid(2, 1), [0, 0.5], 0.5, 0.5)
    model = SensorModel(0.5, false_negative=0.2)
    observations = [Observation([0, 1, 0], False)] * 3 + [Observation([0, 1, 0], True, [0, 0])]
    estimator = assimilated(belief, model, observations, unknowns)
    leth, mal = np.meshgrid(*[estimator.parameters['lethality'].bins.values] * 2, indexing='ij')
    weight = np.outer(*[np.exp(estimator.parameters['lethality'].bins.log_prior)] * 2)
    by_hazard = []
    for z in (0, 1):
        survived = (1 - mal) ** 2 * (1 - 0.8 * leth * z)
        by_hazard.append(weight * survived * (1 - survived) ** 3)
    weight = sum(by_hazard) / sum(by_hazard).sum()
    assert estimator.model.malfunction == pytest.approx((weight * mal).sum(), abs=0.02)
    expected = (weight * (1 - mal) * (1 - 0.8 * leth)).sum()
    assert estimator.model.survival(1) == pytest.approx(expected, abs=0.02)


BITS = """
import sys
if sys.argv[1] == 'none':
    sys.modules['numba'] = None
from hashlib import sha256
from kbnitp_ros.core import Belief, Estimator, Grid, Observation, SensorModel, Unknowns
from kbnitp_ros.core.inference import sampler

sampler.MAX_SWEEPS = 4
names = set(Unknowns.__dataclass_fields__) - {'reach', 'duds'}
everything = {name: (0.1, 0.9) for name in names}
digest = sha256()
for unknowns in (Unknowns(), Unknowns(**everything)):
    estimator = Estimator(
        Belief.prior(Grid(3, 2), 0.3, 0.4, 0.7), SensorModel(0.5), 'kappa_bnitp_sampled', unknowns
    )
    for path, readings in (
        ([0, 1, 4, 0], None),
        ([0, 3, 0], [1, 0]),
        ([0, 1, 1, 4, 3, 0], None),
    ):
        estimator.assimilate(Observation(path, readings is not None, readings))
        digest.update(estimator.belief.joint.tobytes())
        digest.update(repr(estimator.model).encode())
        digest.update(repr(estimator.sampling_error).encode())
print(digest.hexdigest())
"""


def bits(numba='some', **environment):
    """Return the hash of a posterior computed in another process."""
    ran = subprocess.run(
        [sys.executable, '-W', 'ignore', '-c', BITS, numba],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return ran.stdout


@pytest.mark.processes
def test_bits_are_the_same_compiled_and_interpreted_in_one_thread_and_in_several():
    compiled = bits(OMP_NUM_THREADS='1', OPENBLAS_NUM_THREADS='1')
    assert bits('none', OMP_NUM_THREADS='4', OPENBLAS_NUM_THREADS='4') == compiled
    if FULL:
        assert bits(OMP_NUM_THREADS='4', OPENBLAS_NUM_THREADS='4') == compiled
        assert bits(NUMBA_DISABLE_JIT='1') == compiled


def test_the_numbers_drawn_are_not_those_of_a_world_of_that_seed():
    for others in (5, [5, 0], [5, 3]):
        drawn = np.random.default_rng(others).random(4)
        for deployments in (0, 3):
            assert not np.isin(sampler.generator(5, deployments).random(4), drawn).any()


def test_only_evidence_that_no_value_explains_is_refused():
    """Without malfunctions a loss needs a hazard, or a malfunction rate above 0."""
    safe = Belief.prior(Grid(2, 1), 0.0, 0.5, 0.5)
    lost = Observation([0, 1, 0], False)
    told = SensorModel(0.5, malfunction=0.0)
    estimator = Estimator(safe, told, METHOD, Unknowns(true_positive=(0, 1)))
    before = estimator.belief, estimator.parameters, estimator.model
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(lost)
    assert (estimator.belief, estimator.parameters, estimator.model) == before
    estimator.assimilate(Observation([0, 1, 0], True, [0, 1]))
    learner = Estimator(safe, told, METHOD, Unknowns(malfunction=(0.0, 0.5)))
    learner.assimilate(lost)
    assert learner.parameters['malfunction'].mean > 0.25


def test_a_field_beyond_memory_is_refused_with_an_estimate():
    prior = Belief.prior(Grid(600, 600), 0.5, 0.45, 0.8)
    with pytest.raises(ValueError, match='sampling 360000 cells takes about 4.4 GB'):
        Estimator(prior, SensorModel(0.5), 'kappa_bnitp_sampled')
