# SPDX-License-Identifier: Apache-2.0
"""Targets that change between deployments: by enumeration, learnt, in worlds and missions."""

import brute_force
import fields_in_full
from kbnitp_ros.core import (
    Belief,
    Beta,
    Dynamics,
    Estimator,
    Execution,
    Grid,
    Learning,
    Observation,
    ORDINARY,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    World,
)
from kbnitp_ros.core.inference.filter import Evidence
from kbnitp_ros.core.inference.particles import Filters
from laws import for_each
import numpy as np
import pytest

MODEL = SensorModel(0.6, 0.1, 0.1, 0.9, 0.15)
LEARN = Dynamics('learn')
RATE = Dynamics('changing', vanish=(0.01, 0.3))


def drawn(seed, count=4, width=3, height=2):
    """Draw a joint, and outcomes of robots."""
    rng = np.random.default_rng([seed, 41])
    outcomes = []
    for _ in range(count):
        path = brute_force.random_path(rng, width, height, 0, int(rng.integers(1, 8)))
        steps = len(path) - 1
        if rng.random() < 0.6:
            outcomes.append(Observation(path, True, rng.integers(-1, 2, steps)))
        else:
            fits = rng.random(steps) + 0.01 if rng.random() < 0.5 else None
            outcomes.append(Observation(path, False, None, int(rng.integers(steps)), fits))
    return brute_force.random_joint(rng, width * height, 0), outcomes


@for_each('seed, kind', [(s, k) for s in range(60) for k in ('static', 'changing')], every=6)
def test_changing_targets_have_the_belief_of_all_states(seed, kind):
    joint, outcomes = drawn(seed)
    hazards = Dynamics(kind, 0.05, 0.2) if kind == 'changing' else Dynamics()
    targets = Dynamics('changing', 0.07, 0.3)
    estimator = Estimator(Belief(joint), MODEL, dynamics=hazards, target_dynamics=targets)
    for number, outcome in enumerate(outcomes, 1):
        estimator.assimilate(outcome)
        expected, _ = fields_in_full.posterior(
            joint, MODEL, outcomes[:number], targets=targets, hazards=hazards
        )
        np.testing.assert_allclose(estimator.belief.joint, expected, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_three_by_three_cells():
    joint, outcomes = drawn(1, 3, 3, 3)
    targets = Dynamics('changing', 0.07, 0.3)
    estimator = Estimator(Belief(joint), MODEL, target_dynamics=targets)
    for outcome in outcomes:
        estimator.assimilate(outcome)
    expected, _ = fields_in_full.posterior(joint, MODEL, outcomes, targets=targets)
    np.testing.assert_allclose(estimator.belief.joint, expected, rtol=0, atol=1e-12)


@for_each('seed', range(40), every=8)
def test_particles_are_weighed_by_the_evidence_of_their_rates(monkeypatch, seed):
    """A rate of 0 is one of still targets; targets appear at the rate that keeps their number."""
    monkeypatch.setattr(Filters, '_resample', lambda *_: None)
    joint, outcomes = drawn(seed, 3)
    unknowns = Unknowns(lethality=(0.1, 1.0))
    bank = Filters(Belief(joint), MODEL, unknowns, 0, Dynamics(), count=6, targets=LEARN)
    bank.numbers = bank.numbers * (np.arange(6) > 1)[:, None] ** [0, 1]
    weights, joints = [], []
    density = joint[:, :, 1].sum(axis=1).mean()
    for lethality, vanish in bank.numbers.tolist():
        own = SensorModel(lethality, 0.1, 0.1, 0.9, 0.15)
        targets = Dynamics('changing', vanish * density / (1.0 - density), vanish)
        after, chance = fields_in_full.posterior(joint, own, outcomes, targets=targets)
        joints.append(after)
        weights.append(chance)
    for outcome in outcomes:
        bank.take(Evidence.of(outcome, ORDINARY))
    weights = np.array(weights) / np.sum(weights)
    np.testing.assert_allclose(bank.weights, weights, rtol=0, atol=1e-10)
    expected = np.tensordot(weights, joints, 1)
    np.testing.assert_allclose(bank.joint()[0], expected, rtol=0, atol=1e-10)


def test_a_refold_has_the_same_filters(monkeypatch):
    monkeypatch.setattr(Filters, '_resample', lambda *_: None)
    joint, outcomes = drawn(3, 12)
    bank = Filters(Belief(joint), MODEL, Unknowns(), 0, Dynamics(), count=8, targets=RATE)
    evidence = [Evidence.of(outcome, ORDINARY) for outcome in outcomes]
    for counted in evidence:
        bank.take(counted)
    joints, log_likelihood = bank._refold(bank.numbers, evidence)
    np.testing.assert_allclose(bank._joints, joints, rtol=0, atol=1e-12)
    np.testing.assert_allclose(bank._log_likelihood, log_likelihood, rtol=0, atol=1e-10)


GRID = Grid(6, 6)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)
DETECTOR = {'true_positive': Beta(9, 1), 'false_positive': Beta(1, 9)}


def flown(truth, robots=50, **believed):
    world = World.random(GRID, 4, 0.15, 0.8, 0.1)
    return run_mission(
        GRID,
        PRIOR,
        SensorModel(0.3, 0.001),
        world,
        robots,
        2,
        options=SearchOptions('relaxed', 12),
        truth=truth,
        **believed,
    )


@pytest.mark.slow
@for_each('moving', [Dynamics('moving', move=0.05), Dynamics('changing', 0.01, 0.05)])
def test_changing_targets_are_told_from_still_ones(moving):
    learning = Learning(Unknowns(**DETECTOR))
    options = {'target_dynamics': LEARN, 'learning': learning}
    found = flown(Truth(target_dynamics=moving), **options).estimator
    assert found.target_kinds['changing'] > 0.95
    assert found.probable_target_dynamics.kind == 'changing'
    assert 0.0 < found.parameters['target_vanish'].mean < 0.2
    still = flown(Truth(target_dynamics=Dynamics()), **options).estimator
    assert still.target_kinds['changing'] < 0.2
    assert still.probable_target_dynamics == Dynamics()
    assert flown(Truth(target_dynamics=Dynamics())).estimator.target_kinds == {'static': 1.0}


def test_targets_of_worlds_come_go_and_move():
    world = World(np.zeros(36, bool), np.arange(36) % 3 == 0)
    rng, changes = np.random.default_rng(1), GRID.may_be_hazardous

    def after(dynamics):
        path = [0, 1, 0]
        made = Execution().traverse(
            world, GRID, path, MODEL, rng, changing=changes, target_dynamics=dynamics
        )
        assert not made.world.hazard.any()
        return made.world.target

    assert not after(Dynamics('changing', 0.0, 1.0)).any()
    assert after(Dynamics('changing', 1.0, 0.0)).all()
    moved = after(Dynamics('moving', move=1.0))
    assert moved.sum() == 12
    assert (moved & ~world.target).sum() > 6


@for_each('options, why', [
    ({'target_dynamics': Dynamics('used_up')}, 'target_dynamics is used_up: a belief takes'),
    ({'target_dynamics': Dynamics('moving', move=0.1)}, 'learnt as changing ones'),
    ({'target_dynamics': Dynamics('learn', vanish=0.1)}, 'learn with a known rate'),
    ({'target_dynamics': LEARN, 'method': 'kappa_bnitp_sampled'}, 'does not take targets that ch'),
    ({'target_dynamics': LEARN, 'method': 'relaxed_bnitp'}, 'cannot learn target_vanish'),
])  # fmt: skip
def test_target_dynamics_that_a_method_cannot_are_refused(options, why):
    with pytest.raises(ValueError, match=why):
        Estimator(PRIOR, MODEL, **options)


def test_a_world_needs_a_known_kind_of_targets():
    with pytest.raises(ValueError, match="target_dynamics is 'learn', but a world is of a known"):
        flown(Truth(target_dynamics=LEARN))
