# SPDX-License-Identifier: Apache-2.0
"""Last contacts and missing readings are taken in exactly."""

import brute_force
from kbnitp_ros.core import Belief, Observation, SensorModel, update
import numpy as np
import pytest


def last_contact(seed, independent=False):
    """Draw a small belief, sensors, a path, and after how many of its steps it was lost."""
    rng = np.random.default_rng(seed)
    while True:
        joint, sensors, path = brute_force.random_case(rng, most_cells=5, most_steps=7)
        if independent:
            joint = Belief(joint).independent().joint
        model, steps = SensorModel(**sensors), int(rng.integers(len(path) - 1))
        if brute_force.evidence_probability(joint, model, path, None, steps) > 1e-6:
            return joint, model, path, steps


def missing_readings(seed):
    """Draw a small belief, sensors, a path, and readings of which some are missing."""
    rng = np.random.default_rng(seed)
    while True:
        joint, sensors, path = brute_force.random_case(rng, most_cells=5, most_steps=7)
        model, readings = SensorModel(**sensors), rng.choice([-1, 0, 1], len(path) - 1)
        if brute_force.evidence_probability(joint, model, path, readings) > 1e-6:
            return joint, model, path, readings


@pytest.mark.parametrize('seed', range(300))
def test_a_last_contact_is_exact(seed):
    joint, model, path, steps = last_contact(seed)
    observation = Observation(path, survived=False, steps_survived=steps)
    found = update(Belief(joint), model, observation).joint
    expected = brute_force.posterior(joint, model, (path, None, steps))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize('seed', range(300))
def test_missing_readings_are_exact(seed):
    joint, model, path, readings = missing_readings(seed)
    found = update(Belief(joint), model, Observation(path, True, readings)).joint
    expected = brute_force.posterior(joint, model, (path, readings))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize('seed', range(100))
def test_multi_universe_averaging_takes_a_last_contact_exactly(seed):
    joint, model, path, steps = last_contact(seed, independent=True)
    observation = Observation(path, survived=False, steps_survived=steps)
    found = update(Belief(joint), model, observation, 'relaxed_itp').hazard
    expected = brute_force.posterior(joint, model, (path, None, steps))
    assert found == pytest.approx(expected[:, 1].sum(axis=1), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize('seed', range(100))
def test_the_published_loss_starts_from_the_steps_survived(seed):
    joint, model, path, steps = last_contact(seed)
    observation = Observation(path, survived=False, steps_survived=steps)
    found = update(Belief(joint), model, observation, 'kappa_bnitp_published')
    alive = joint.copy()
    for cell in path[: steps + 1][1:]:
        alive[cell] *= np.array(brute_force.step_survival(model))[:, None]
    alive /= alive.sum(axis=(1, 2), keepdims=True)
    for cell, (hazard, target, _) in brute_force.published_loss(
        alive, model, path[steps:]
    ).items():
        assert found.hazard[cell] == pytest.approx(hazard, rel=1e-9, abs=1e-12)
        assert found.target[cell] == pytest.approx(target, rel=1e-9, abs=1e-12)


def test_nothing_known_is_nothing_changed():
    joint, model, path, _ = last_contact(1)
    plain = update(Belief(joint), model, Observation(path, False)).joint
    told = update(Belief(joint), model, Observation(path, False, None, 0)).joint
    assert plain.tobytes() == told.tobytes()
    readings = [True, False] * len(path)
    looked = Observation(path, True, readings[: len(path) - 1])
    as_numbers = Observation(path, True, np.array(readings[: len(path) - 1], dtype=int))
    assert looked.readings.dtype == as_numbers.readings.dtype == bool


@pytest.mark.parametrize(
    'arguments, message',
    [
        ({'survived': False, 'steps_survived': 3}, 'steps_survived is 3.*at most 2'),
        ({'survived': False, 'steps_survived': -1}, 'steps_survived is -1.*at least 0'),
        ({'survived': False, 'steps_survived': 1.5}, 'steps_survived is 1.5'),
        ({'readings': [1, 0, 1], 'steps_survived': 1}, 'steps_survived is 1.*returned'),
        ({'readings': [1, 0, -2]}, 'readings is -2'),
        ({'readings': [-1, 0, 2]}, 'readings is 2'),
        ({'readings': [-1, 0]}, 'readings has shape'),
        ({'readings': [-1, 0, float('nan')]}, 'readings is nan'),
    ],
)
def test_what_cannot_be_known_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Observation(**{'path': [0, 1, 2, 0], 'survived': True, **arguments})
