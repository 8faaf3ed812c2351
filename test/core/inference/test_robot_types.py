# SPDX-License-Identifier: Apache-2.0
"""Robots of several types: each deployment is taken in with the sensor model of its own robot."""

import brute_force
from kbnitp_ros.core import (
    Belief,
    Estimator,
    Observation,
    RobotType,
    SensorModel,
    Unknowns,
)
from laws import for_each
import numpy as np
import pytest


def random_robot_type(rng):
    """Draw the numbers of the sensor model that a robot type overrides."""
    own = {name: p for name, p in brute_force.random_sensors(rng).items() if rng.random() < 0.6}
    return RobotType(**own)


def random_robots(seed, robots, most_steps=6, independent=False):
    rng = np.random.default_rng(seed)
    joint = brute_force.random_joint(rng, 4, 0)
    if independent:
        joint = Belief(joint).independent().joint
    model = SensorModel(**brute_force.random_sensors(rng))
    world = np.array([rng.choice(4, p=cell.ravel()) for cell in joint])
    seen = []
    for _ in range(robots):
        robot_type = random_robot_type(rng)
        own = robot_type.model(model)
        path = brute_force.random_path(rng, 2, 2, 0, int(rng.integers(1, most_steps)))
        survive, detect = brute_force.step_survival(own), brute_force.detection(own)
        alive = [rng.random() < survive[world[cell] // 2] for cell in path[1:]]
        readings, known = None, 0
        if all(alive):
            readings = [
                -1 if rng.random() < 0.2 else int(rng.random() < detect[world[cell] % 2])
                for cell in path[1:]
            ]
        else:
            known = int(rng.integers(alive.index(False) + 1))
        seen.append((robot_type, path, readings, known))
    return joint, model, seen


def assimilated(joint, model, seen, method, **options):
    estimator = Estimator(Belief(joint), model, method, **options)
    for robot_type, path, readings, known in seen:
        estimator.assimilate(Observation(path, readings is not None, readings, known), robot_type)
    return estimator


def enumerated(joint, model, seen):
    return brute_force.weighed(joint, [(kind.model(model), *each) for kind, *each in seen])[1]


@for_each('seed', range(20))
def test_robots_of_several_types_are_sampled_closely(seed):
    joint, model, seen = random_robots(seed, 6)
    exact = enumerated(joint, model, seen)
    found = assimilated(joint, model, seen, 'kappa_bnitp_sampled').belief.joint
    possible = exact > 0.0
    apart = (exact[possible] * np.log(exact[possible] / found[possible])).sum()
    assert apart < 5e-3
    np.testing.assert_allclose(found, exact, rtol=0, atol=0.05)


LETHALITIES = (np.arange(200) + 0.5) / 200


@pytest.mark.slow
@for_each('seed', range(6))
def test_a_lethality_is_learnt_from_robots_that_share_it(seed):
    """By enumeration: a robot with its own lethality informs of hazards, not of the shared one."""
    rng = np.random.default_rng(seed)
    joint, _, seen = random_robots(seed, 8)
    own = [
        RobotType(),
        RobotType(lethality=0.2),
        RobotType(false_negative=0.4),
        RobotType(malfunction=0.15),
    ]
    seen = [(own[rng.integers(4)], *each) for _, *each in seen]
    model = SensorModel(0.5)
    sampled = assimilated(
        joint, model, seen, 'kappa_bnitp_sampled', unknowns=Unknowns(lethality=(0.0, 1.0))
    )
    cells, states, prior = brute_force.enumerate_states(joint, range(len(joint)))
    weight = np.tile(prior, (LETHALITIES.size, 1))
    for row, lethality in enumerate(LETHALITIES):
        for robot_type, path, *outcome in seen:
            weight[row] *= brute_force.evidence_likelihood(
                robot_type.model(SensorModel(lethality)), cells, states, path, *outcome
            )
    weight /= weight.sum()
    mean = (weight.sum(axis=1) * LETHALITIES).sum()
    hazard = weight.sum(axis=0) @ states[:, :, 0]
    assert sampled.parameters['lethality'].mean == pytest.approx(mean, abs=0.03)
    assert sampled.model.lethality == pytest.approx(mean, abs=0.03)
    np.testing.assert_allclose(sampled.belief.hazard, hazard, rtol=0, atol=0.05)


@for_each('name', ['lethality', 'malfunction', 'true_positive', 'false_positive'])
def test_nothing_is_learnt_from_robots_with_their_own_number(name):
    joint, _, seen = random_robots(3, 8)
    model, seen = SensorModel(0.5), [(RobotType(**{name: 0.4}), *each) for _, *each in seen]
    unknowns = Unknowns(**{name: (0.0, 1.0)})
    after = assimilated(joint, model, seen, 'kappa_bnitp_sampled', unknowns=unknowns)
    assert after.parameters[name].mean == pytest.approx(0.5, abs=0.03)
