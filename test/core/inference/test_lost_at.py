# SPDX-License-Identifier: Apache-2.0
"""Knowledge of where a robot was lost is assimilated exactly, by every method."""

from itertools import permutations

import brute_force
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    METHODS,
    Observation,
    Report,
    SensorModel,
    update,
)
from kbnitp_ros.core.inference import sampler
from kbnitp_ros.core.inference.one_pass import OnePass
from laws import for_each
import numpy as np
import pytest

# Fields of 2x3 to 4x3 cells; brute force enumerates all states of the visited ones.
SIZES = [(2, 3), (3, 2), (3, 3), (4, 3)]
MAX_CELLS = 6


def draw_lost_at(rng, steps):
    """Draw the weights of the steps: arbitrary, a bell, pings, or one certain step."""
    kind = rng.integers(4)
    step = np.arange(steps)
    if kind == 0:
        lost_at = rng.random(steps) * (rng.random(steps) < 0.6)
    elif kind == 1:
        lost_at = np.exp(-(((step - rng.integers(steps)) / rng.uniform(0.5, 3.0)) ** 2) / 2.0)
    elif kind == 2:
        heard = rng.integers(steps)
        lost_at = np.where(step >= heard, (1.0 - rng.random()) ** (step - heard), 0.0)
    else:
        lost_at = (step == rng.integers(steps)).astype(float)
    return lost_at * rng.choice([1e-9, 1.0, 1e9]) if lost_at.any() else draw_lost_at(rng, steps)


def draw_path(rng, width, height, base):
    while True:
        steps = int(rng.integers(1, 10))
        path = brute_force.random_path(rng, width, height, base, steps)
        if len(set(path)) <= MAX_CELLS:
            return path


def located(seed, independent=False):
    """Draw a belief, sensors, a path, the steps survived, and perhaps `lost_at`."""
    rng = np.random.default_rng(seed)
    while True:
        width, height = SIZES[rng.integers(len(SIZES))]
        base = int(rng.integers(width * height))
        joint = brute_force.random_joint(rng, width * height, base)
        if independent:
            joint = Belief(joint).independent().joint
        model = SensorModel(**brute_force.random_sensors(rng))
        path = draw_path(rng, width, height, base)
        lost_at = None if seed % 4 == 3 else draw_lost_at(rng, len(path) - 1)
        steps = int(rng.integers(len(path) - 1)) if lost_at is None or rng.random() < 0.3 else 0
        chance = brute_force.evidence_probability(joint, model, path, None, steps, lost_at)
        if chance > 1e-6 * (1.0 if lost_at is None else lost_at.max()):
            return joint, model, path, steps, lost_at


@pytest.mark.slow
@for_each('method', ['kappa_bnitp', 'relaxed_itp'], every=5)
@for_each('seed', range(300))
def test_where_a_robot_was_lost_is_taken_in_exactly(seed, method):
    joint, model, path, steps, lost_at = located(seed, independent=method == 'relaxed_itp')
    observation = Observation(path, False, None, steps, lost_at)
    found = update(Belief(joint), model, observation, method)
    expected = brute_force.posterior(joint, model, (path, None, steps, lost_at))
    assert found.hazard == pytest.approx(expected[:, 1].sum(axis=1), rel=0, abs=1e-12)
    if method == 'kappa_bnitp':
        assert found.joint == pytest.approx(expected, rel=0, abs=1e-12)


@for_each('seed', range(100))
def test_the_published_methods_weigh_each_step_by_it(seed):
    joint, model, path, steps, lost_at = located(seed)
    observation = Observation(path, False, None, steps, lost_at)
    found = update(Belief(joint), model, observation, 'kappa_bnitp_published')
    lost_at = np.ones(len(path) - 1) if lost_at is None else lost_at
    first = max(steps, int(np.argmax(lost_at > 0)))
    while not lost_at[first]:
        first += 1
    alive = joint.copy()
    for cell in path[: first + 1][1:]:
        alive[cell] *= np.array(brute_force.step_survival(model))[:, None]
    alive /= alive.sum(axis=(1, 2), keepdims=True)
    expected = brute_force.published_loss(alive, model, path[first:], lost_at[first:])
    for cell, (hazard, target, _) in expected.items():
        assert found.hazard[cell] == pytest.approx(hazard, rel=1e-9, abs=1e-12)
        assert found.target[cell] == pytest.approx(target, rel=1e-9, abs=1e-12)


def mission(seed):
    rng = np.random.default_rng([seed, 24])
    while True:
        width, height = SIZES[rng.integers(len(SIZES))]
        base = int(rng.integers(width * height))
        joint = brute_force.random_joint(rng, width * height, base)
        arguments = brute_force.random_sensors(rng)
        model = SensorModel(**{**arguments, 'malfunction': max(arguments['malfunction'], 0.02)})
        deployments = []
        for number in range(3):
            path = draw_path(rng, width, height, base)
            if number == 0 or rng.random() < 0.6:
                deployments.append((path, None, 0, draw_lost_at(rng, len(path) - 1)))
            else:
                deployments.append((path, rng.choice([-1, 0, 1], len(path) - 1)))
        if len({cell for path, *_ in deployments for cell in path}) > MAX_CELLS:
            continue
        chance = 1.0
        for number in range(3):
            posterior = brute_force.posterior(joint, model, *deployments[: number + 1])
            if not np.isfinite(posterior).all():
                chance = 0.0
        if chance:
            return joint, model, deployments


def observed(path, readings, steps_survived=0, lost_at=None):
    return Observation(path, readings is not None, readings, steps_survived, lost_at)


@for_each('seed', range(30))
def test_sampling_takes_missions_in(seed):
    assert divergence_of_sampling(*mission(seed)) < 0.003


# The missions of 300 with the largest error at the default sweeps: .003 to .02.
@pytest.mark.slow
@for_each('seed', [63, 291, 267, 53], every=4)
def test_sampling_comes_to_the_exact_posterior_with_sweeps(seed, monkeypatch):
    monkeypatch.setattr(sampler, 'MAX_SWEEPS', 512)
    monkeypatch.setattr(sampler, 'CONVERGED', 0.0)
    assert divergence_of_sampling(*mission(seed)) < 1e-4


def divergence_of_sampling(joint, model, deployments):
    estimator = Estimator(Belief(joint), model, 'kappa_bnitp_sampled')
    for deployment in deployments:
        estimator.assimilate(observed(*deployment))
    expected = brute_force.posterior(joint, model, *deployments)
    found = estimator.belief.joint
    seen = expected > 0
    return float((expected[seen] * np.log(expected[seen] / found[seen])).sum())


def test_uniform_lost_at_is_no_information():
    joint, model, path, *_ = located(3)
    for method in METHODS:
        plain, told = (Estimator(Belief(joint), model, method) for _ in range(2))
        plain.assimilate(Observation(path, False))
        told.assimilate(Observation(path, False, None, 0, [7.0] * (len(path) - 1)))
        assert told.belief.joint.tobytes() == plain.belief.joint.tobytes()


def test_a_loss_in_a_stretch_is_one_on_a_shorter_path():
    """Steps after the last possible one do not matter."""
    belief = Belief.from_maps([0.0, 0.3, 0.4, 0.2], [0.4] * 4, [0.8] * 4)
    longer, shorter = (
        Estimator(belief, SensorModel(0.5), 'kappa_bnitp_sampled') for _ in range(2)
    )
    longer.assimilate(Observation([0, 1, 2, 0, 3, 0], False, lost_at=[0, 2, 2, 0, 0]))
    shorter.assimilate(Observation([0, 1, 2, 0], False, steps_survived=1))
    assert longer.belief.joint.tobytes() == shorter.belief.joint.tobytes()


def test_impossible_steps_are_survived():
    seen = Observation([0, 1, 2, 3, 0], False, None, 1, [4.0, 0.0, 2.0, 1.0])
    assert seen.steps_survived == 2
    assert seen.lost_at.tolist() == [0.0, 0.0, 1.0, 0.5]
    assert Observation([0, 1, 2, 3, 0], False, None, 1, [5.0, 3.0, 3.0, 3.0]).lost_at is None


@for_each('method', ['kappa_bnitp', 'kappa_bnitp_sampled'])
def test_an_impossible_loss_is_refused_and_changes_nothing(method):
    """Without malfunctions no robot is lost in its only possible step, into a safe cell."""
    belief = Belief.from_maps([0.0, 0.5, 0.0, 0.5], [0.4] * 4, [0.8] * 4)
    estimator = Estimator(belief, SensorModel(0.5, malfunction=0.0), method)
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(Observation([0, 1, 2, 3, 0], False, lost_at=[0, 1, 0, 0]))
    assert estimator.belief.joint.tobytes() == belief.joint.tobytes()


def test_a_method_without_support_gets_no_lost_at(monkeypatch):
    monkeypatch.setattr(OnePass, 'takes_lost_at', False)
    estimator = Estimator(Belief.from_maps([0.0, 0.5], [0.4] * 2, [0.8] * 2), SensorModel(0.5))
    with pytest.raises(ValueError, match='kappa_bnitp does not .*: use kappa_bnitp_sampled'):
        estimator.assimilate(Observation([0, 1, 1, 0], False, lost_at=[1, 2, 3]))
    estimator.assimilate(Observation([0, 1, 1, 0], False, lost_at=[2, 2, 2]))


def test_the_most_informative_report_counts():
    """A later contact first, then the closer one, in any order; a late return replaces both."""
    grid, path = Grid(2, 2), (0, 1, 2, 3, 0)
    prior = Belief.prior(grid, 0.3, 0.4, 0.8)
    key = DeploymentKey('scout_1', 1)
    reports = [
        Report(False),
        Report(False, lost_at=(1.0, 2.0, 3.0, 1.0)),
        Report(False, lost_at=(1.0, 5.0, 1.0, 0.5)),
        Report(False, steps_survived=1),
        Report(False, lost_at=(0.0, 1.0, 9.0, 1.0)),
    ]
    for order in permutations(range(len(reports))):
        ledger = Ledger(grid, 4, Estimator(prior, SensorModel(0.5)))
        ledger.record_path(key, path)
        best = -1
        for number in order:
            assert ledger.record_report(key, reports[number]) == (number > best)
            best = max(best, number)
        assert ledger.outcomes[key].lost_at.tolist() == [0.0, 1 / 9, 1.0, 1 / 9]
    assert ledger.record_report(key, Report(True, ((1, 0), (2, 0), (3, 1), (0, 0))))
    expected = update(prior, SensorModel(0.5), Observation(path, True, [0, 0, 1, 0]))
    assert ledger.belief.joint.tobytes() == expected.joint.tobytes()
    with pytest.raises(ValueError, match=r'deployment scout_1 at .*lost_at\[2\] is nan'):
        ledger.record_report(key, Report(False, lost_at=(1.0, 1.0, float('nan'), 1.0)))
