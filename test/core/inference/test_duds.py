# SPDX-License-Identifier: Apache-2.0
"""Hazards that never strike: by enumeration of three states, learnt, planned for and in worlds."""

from itertools import product

import brute_force
import fields_in_full
from kbnitp_ros.core import (
    Area,
    Belief,
    Beta,
    Dynamics,
    Estimator,
    forecast,
    Grid,
    HazardDraws,
    Learning,
    Observation,
    ORDINARY,
    path_information,
    Plan,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    update,
    World,
)
from kbnitp_ros.core.decision.hazard_draws import joint_hazards
from kbnitp_ros.core.inference.filter import Evidence
from kbnitp_ros.core.inference.particles import Filters
from laws import for_each
import numpy as np
import pytest


def case(seed, width=3, height=2):
    """Draw a joint, a sensor model with duds, and outcomes of robots."""
    rng = np.random.default_rng([seed, 61])
    joint = brute_force.random_joint(rng, width * height, 0)
    share = float(rng.choice([0.5, rng.random()]))
    model = SensorModel(**brute_force.random_sensors(rng), duds=share)
    outcomes = []
    for _ in range(3):
        path = brute_force.random_path(rng, width, height, 0, int(rng.integers(1, 7)))
        steps = len(path) - 1
        if rng.random() < 0.5:
            outcomes.append(Observation(path, True, rng.integers(-1, 2, steps)))
        else:
            fits = rng.random(steps) + 0.01 if rng.random() < 0.5 else None
            outcomes.append(Observation(path, False, None, int(rng.integers(steps)), fits))
    return joint, model, outcomes


def whole(three):
    """Return the joints of no hazard and any hazard, and the part of duds."""
    return np.stack([three[:, 0], three[:, 1] + three[:, 2]], axis=1), three[:, 2]


@for_each('seed', range(200), every=10)
def test_beliefs_are_those_of_three_states(seed):
    joint, model, outcomes = case(seed)
    estimator, again = Estimator(Belief(joint), model), Belief(joint)
    for number, outcome in enumerate(outcomes, 1):
        told = outcomes[:number]
        three, chance = fields_in_full.posterior(joint, model, told, duds=model.duds)
        if not chance > 1e-6:
            break
        estimator.assimilate(outcome)
        again = update(again, model, outcome)
        expected, duds = whole(three)
        for belief in (estimator.belief, again):
            np.testing.assert_allclose(belief.joint, expected, rtol=0, atol=1e-12)
            np.testing.assert_allclose(belief.duds, duds, rtol=0, atol=1e-12)
            live = belief.live().hazard
            np.testing.assert_allclose(live, three[:, 1].sum(axis=1), rtol=0, atol=1e-12)


@for_each('seed', range(40), every=4)
def test_particles_are_weighed_by_the_evidence_of_their_duds(monkeypatch, seed):
    monkeypatch.setattr(Filters, '_resample', lambda *_: None)
    joint, _, outcomes = case(seed)
    model = SensorModel(0.5, 0.1, 0.1, 0.9, 0.15)
    unknowns = Unknowns(lethality=(0.1, 0.9), duds=(0.0, 1.0))
    bank = Filters(Belief(joint), model, unknowns, 0, Dynamics(), count=5)
    duds = np.array([0.0, 0.2, 0.5, 0.8, 0.99])
    bank.numbers = np.stack([bank.numbers[:, 0], duds], axis=1)
    bank._joints = bank._first_joints(bank.numbers)
    weights, joints, lives = [], [], []
    for lethality, share in bank.numbers.tolist():
        own = SensorModel(lethality, 0.1, 0.1, 0.9, 0.15, duds=share)
        three, chance = fields_in_full.posterior(joint, own, outcomes, duds=share or 1e-300)
        joints.append(three)
        lives.append(three[:, 1].sum(axis=1))
        weights.append(chance)
    for outcome in outcomes:
        bank.take(Evidence.of(outcome, ORDINARY))
    weights = np.array(weights) / np.sum(weights)
    np.testing.assert_allclose(bank.weights, weights, rtol=0, atol=1e-10)
    expected, duds = whole(np.tensordot(weights, joints, 1))
    found, found_duds = bank.joint()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found_duds, duds, rtol=0, atol=1e-10)
    np.testing.assert_allclose(bank.live(), lives, rtol=0, atol=1e-10)
    assert (bank.hazard() >= bank.live() - 1e-12).all()


@for_each('seed', range(40), every=4)
def test_information_and_survival_are_those_of_live_hazards(seed):
    """Over all states and outcomes, of a prior and of a belief with duds."""
    joint, model, outcomes = case(seed)
    path = outcomes[0].path[:5]
    path = path if path[-1] == path[0] and len(path) > 1 else np.array([0, 1, 0])
    states = fields_in_full.enumerate_states(6, 3)
    estimator = Estimator(Belief(joint), model)
    for belief, three in _beliefs(estimator, joint, model, outcomes[1]):
        weight = fields_in_full.independent_weights(three, states)
        likelihoods = [
            fields_in_full.likelihood(model, states, Observation(path, False), [()] * 6)
        ]
        for readings in product((0, 1), repeat=len(path) - 1):
            back = Observation(path, True, readings)
            likelihoods.append(fields_in_full.likelihood(model, states, back, [()] * 6))
        together = weight[:, None] * np.array(likelihoods).T
        # Of the live hazards and targets: evidence does not tell duds from no hazard.
        apart = weight[:, None] * together.sum(axis=0)
        seen = together > 0
        expected = (together[seen] * np.log(together[seen] / apart[seen])).sum()
        assert path_information(belief, model, path) == pytest.approx(expected, abs=1e-9)
        survival = 1.0 - together[:, 0].sum()
        assert Plan.along(path, belief, model).survival == pytest.approx(survival, abs=1e-12)


def _beliefs(estimator, joint, model, outcome):
    share = model.duds
    yield (
        estimator.belief,
        np.stack([joint[:, 0], joint[:, 1] * (1 - share), joint[:, 1] * share], 1),
    )
    three, chance = fields_in_full.posterior(joint, model, [outcome], duds=share)
    if chance > 1e-6:
        estimator.assimilate(outcome)
        yield estimator.belief, three


GRID = Grid(6, 6)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)
NEAR = SearchOptions('relaxed', 12)
HALF = SensorModel(0.9, 0.001, duds=0.5)
LEARN = Unknowns(lethality=(0.0, 1.0), kappa=Beta(4, 1.5), duds=Beta(1, 1))


def field(seed=3):
    return World.random(GRID, seed, 0.15, 0.8, 0.1).with_duds(0.5, seed)


def test_duds_of_worlds_never_strike_and_are_hazards():
    world = World(np.array([False, True, True]), np.zeros(3, bool), Grid(3, 1))
    world = world.with_duds(1.0, 1)
    sure = SensorModel(1.0, 0.0, 0.0, duds=0.5)
    assert world.duds.tolist() == [False, True, True]
    assert all(world.traverse([0, 1, 2, 1, 0], sure, seed).survived for seed in range(20))
    assert not world.with_duds(0.0, 1).traverse([0, 1, 0], sure, 1).survived
    # Also by the seed that drew the hazards.
    drawn = field()
    assert 0 < drawn.duds.sum() < drawn.hazard.sum()
    with pytest.raises(ValueError, match='which hazards are duds: make it with World.with_duds'):
        World(world.hazard, world.target).traverse([0, 1, 0], sure, 1)


@pytest.mark.slow
def test_missions_certificates_and_forecasts_count_duds():
    goal = Area([7, 8])
    options = {'truth': Truth(HALF), 'learning': Learning(LEARN), 'goal': goal, 'options': NEAR}
    mission = run_mission(GRID, PRIOR, SensorModel(0.5, 0.001), field(), 30, 3, **options)
    estimator = mission.estimator
    assert estimator.model.duds == pytest.approx(estimator.parameters['duds'].mean)
    mixture, belief = joint_hazards(estimator, 30), estimator.belief
    np.testing.assert_allclose(mixture.p_hazard(), belief.hazard, rtol=0, atol=1e-12)
    live = mixture.weights @ mixture.rates['live']
    np.testing.assert_allclose(live, belief.live().hazard, rtol=0, atol=1e-12)
    path = [0, 7, 8, 7, 0]
    whole = type(mixture)(mixture.hazard, mixture.weights).survival(path, estimator.model)
    assert mixture.survival(path, estimator.model) > whole
    draws = HazardDraws.of(estimator, 30)
    assert (draws.live <= draws.hazardous).all()
    assert draws.live.mean(axis=0) == pytest.approx(belief.live().hazard, abs=0.06)
    for world, _ in estimator.worlds(20, np.random.default_rng(1)):
        assert (world.duds <= world.hazard).all()
    told = forecast(GRID, estimator, 3, 2, 1, NEAR)
    assert told.sent.tolist() == [3, 3]


@for_each('make, why', [
    (lambda: Estimator(PRIOR, HALF, 'kappa_bnitp_sampled'), 'takes no duds: use'),
    (lambda: Estimator(PRIOR, HALF, dynamics=Dynamics('used_up')), 'hazards are used_up: duds'),
    (lambda: Estimator(PRIOR, HALF, target_dynamics=Dynamics('learn')), 'targets are learn: duds'),
    (lambda: run_mission(GRID, PRIOR, HALF, World.random(GRID, 1, 0.2, 0.8, 0.1), 1, 1),
     'does not say which hazards are duds'),
    (lambda: SensorModel(0.5, duds=-0.1), 'duds is -0.1: it must be a probability'),
    (lambda: update(PRIOR, HALF, Observation([0, 1, 0], False), 'relaxed_bnitp'), 'takes none'),
])  # fmt: skip
def test_duds_are_refused_where_they_cannot_be(make, why):
    with pytest.raises(ValueError, match=why):
        make()
