# SPDX-License-Identifier: Apache-2.0
"""Hazards that reach into the cells around them: by enumeration, learnt, planned and in worlds."""

from itertools import pairwise, product

import brute_force
import fields_in_full
from kbnitp_ros.core import (
    Belief,
    Beta,
    Dynamics,
    Estimator,
    Execution,
    Grid,
    HazardDraws,
    Lane,
    Learning,
    Mixture,
    Observation,
    ORDINARY,
    path_information,
    Plan,
    plan,
    plan_team,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Truth,
    Unknowns,
    update,
    World,
)
from kbnitp_ros.core.inference.filter import Evidence
from kbnitp_ros.core.inference.particles import Filters
from laws import for_each
import numpy as np
import pytest

SHAPES = ((3, 2), (2, 3), (3, 1), (2, 2))


def around(width, height):
    """List the cells around each cell, at most eight."""
    cells = [divmod(cell, width) for cell in range(width * height)]
    return [
        [b for b, (r, c) in enumerate(cells) if 0 < max(abs(r - row), abs(c - col)) <= 1]
        for row, col in cells
    ]


def case(seed, shape=None, blocked=()):
    """Draw a belief on a grid, a sensor model with reach, and outcomes of robots."""
    rng = np.random.default_rng([seed, 51])
    width, height = shape or SHAPES[seed % len(SHAPES)]
    joint = brute_force.random_joint(rng, width * height, 0)
    belief = Belief(joint, Grid(width, height, blocked=blocked))
    reach = float(rng.choice([0.3, 1.0, rng.random()]))
    model = SensorModel(**brute_force.random_sensors(rng), reach=reach)
    outcomes = []
    for _ in range(3):
        path = brute_force.random_path(rng, width, height, 0, int(rng.integers(1, 8)))
        steps = len(path) - 1
        if rng.random() < 0.5:
            outcomes.append(Observation(path, True, rng.integers(-1, 2, steps)))
        else:
            fits = rng.random(steps) + 0.01 if rng.random() < 0.5 else None
            outcomes.append(Observation(path, False, None, int(rng.integers(steps)), fits))
    return belief, model, outcomes, around(width, height)


@for_each('seed', range(400), every=20)
def test_beliefs_are_those_of_all_states(seed):
    belief, model, outcomes, near = case(seed)
    estimator = Estimator(belief, model)
    for number, outcome in enumerate(outcomes, 1):
        told = outcomes[:number]
        expected, chance = fields_in_full.posterior(belief.joint, model, told, around=near)
        if not chance > 1e-6:
            break
        first = number == 1
        estimator.assimilate(outcome)
        np.testing.assert_allclose(estimator.belief.joint, expected, rtol=0, atol=1e-12)
        if first:
            again = update(belief, model, outcome)
            np.testing.assert_allclose(again.joint, expected, rtol=0, atol=1e-12)


@pytest.mark.slow
@for_each('seed', range(4))
def test_three_by_three_cells(seed):
    belief, model, outcomes, near = case(seed, (3, 3))
    expected, chance = fields_in_full.posterior(belief.joint, model, outcomes[:1], around=near)
    if chance > 1e-6:
        estimator = Estimator(belief, model)
        estimator.assimilate(outcomes[0])
        np.testing.assert_allclose(estimator.belief.joint, expected, rtol=0, atol=1e-12)


@for_each('seed', range(60), every=6)
def test_particles_are_weighed_by_the_evidence_of_their_reach(monkeypatch, seed):
    monkeypatch.setattr(Filters, '_resample', lambda *_: None)
    belief, _, outcomes, near = case(seed)
    model = SensorModel(0.5, 0.1, 0.1, 0.9, 0.15)
    unknowns = Unknowns(lethality=(0.1, 0.9), reach=(0.0, 0.6))
    bank = Filters(belief, model, unknowns, 0, Dynamics(), count=6)
    reach = np.array([0.0, 0.0, 0.1, 0.3, 0.5, 0.6])
    bank.numbers = np.stack([bank.numbers[:, 0], reach], axis=1)
    weights, joints = [], []
    for lethality, reach in bank.numbers.tolist():
        own = SensorModel(lethality, 0.1, 0.1, 0.9, 0.15, reach)
        after, chance = fields_in_full.posterior(belief.joint, own, outcomes, around=near)
        joints.append(after)
        weights.append(chance)
    for outcome in outcomes:
        [predicted, *_] = bank.take(Evidence.of(outcome, ORDINARY), is_predicted=True)
        assert predicted < 0.0
    weights = np.array(weights) / np.sum(weights)
    np.testing.assert_allclose(bank.weights, weights, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        bank.joint()[0], np.tensordot(weights, joints, 1), rtol=0, atol=1e-10
    )


@for_each('seed', range(60), every=6)
def test_the_probability_of_a_return_is_predicted(seed):
    belief, model, outcomes, near = case(seed)
    bank = Filters(belief, model, Unknowns(), 0, Dynamics())
    path = outcomes[0].path
    read = np.full(path.size - 1, -1)
    states = fields_in_full.enumerate_states(belief.cells, 2)
    weight = fields_in_full.independent_weights(belief.joint, states)
    back = Observation(path, True, read)
    expected = weight @ fields_in_full.likelihood(model, states, back, near)
    if expected > 1e-9:
        _, predicted = bank.take(Evidence.of(back, ORDINARY), is_predicted=True)[:2]
        assert np.exp(predicted) == pytest.approx(expected, abs=1e-12)


def left_open(p):
    return brute_force.binary_entropy(p)


@for_each('seed', range(120), every=8)
def test_information_and_survival_are_those_of_all_states_and_outcomes(seed):
    belief, model, outcomes, near = case(seed)
    path = outcomes[0].path[:5]
    path = np.append(path, path[0]) if path[-1] != path[0] else path
    path = path if len(path) > 1 else np.array([0, 0])
    grid_free = Belief(belief.joint, belief.grid)
    states = fields_in_full.enumerate_states(belief.cells, 2)
    weight = fields_in_full.independent_weights(belief.joint, states)
    steps = len(path) - 1
    likelihoods = [fields_in_full.likelihood(model, states, Observation(path, False), near)]
    for readings in product((0, 1), repeat=steps):
        back = Observation(path, True, readings)
        likelihoods.append(fields_in_full.likelihood(model, states, back, near))
    together = weight[:, None] * np.array(likelihoods).T
    apart = weight[:, None] * together.sum(axis=0)
    seen = together > 0
    expected = (together[seen] * np.log(together[seen] / apart[seen])).sum()
    jumps = any(b not in near[a] and a != b for a, b in pairwise(path))
    if jumps:
        return
    assert path_information(grid_free, model, path) == pytest.approx(expected, abs=1e-9)
    survival = 1.0 - together[:, 0].sum()
    assert Plan.along(path, belief, model).survival == pytest.approx(survival, abs=1e-12)
    mixture = Mixture(belief.hazard[None], [1.0], around=belief.grid.around)
    assert mixture.survival(path, model) == pytest.approx(survival, abs=1e-12)
    hazardous = states[:, :, 0].astype(bool)
    draws = HazardDraws(hazardous, np.inf, weight, belief.grid.around)
    if model.lethality < 1.0:
        assert draws.survival(path, model) == pytest.approx(survival, abs=1e-5)


def test_the_reach_is_geometric_and_over_obstacles():
    grid = Grid(5, 5, blocked=(6, 7), connectivity=4)
    assert grid.around[12].tolist() == [6, 7, 8, 11, 13, 16, 17, 18]
    assert sorted(grid.around[0].tolist()) == [-1, -1, -1, -1, -1, 1, 5, 6]


GRID = Grid(6, 6)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)
REACHING = SensorModel(0.9, 0.001, reach=0.4)
NEAR = SearchOptions('relaxed', 12)


def test_robots_of_worlds_are_struck_from_the_cells_around():
    hazard = np.zeros(36, bool)
    hazard[[7, 9]] = True
    world, runs = World(hazard, np.zeros(36, bool), GRID), 4000
    model, rng = SensorModel(0.6, 0.0, 0.1, reach=0.5), np.random.default_rng(1)
    back = [world.traverse([0, 8, 0], model, rng).survived for _ in range(runs)]
    beside = 1.0 - 0.6 * 0.9 * 0.5
    # Into a cell between both hazards, and home beside one.
    assert np.mean(back) == pytest.approx(beside**3, abs=4.0 / np.sqrt(4 * runs))
    made = Execution().traverse(World(hazard, ~hazard), GRID, [0, 0], model, 1)
    assert made.world.grid == GRID
    with pytest.raises(ValueError, match=r'reach is not 0, and the world has no grid .* World\('):
        World(hazard, ~hazard).traverse([0, 8, 0], model, 1)
    with pytest.raises(ValueError, match='hazards are used up'):
        Execution().traverse(world, GRID, [0, 1, 0], model, 1, Dynamics('used_up'))


def test_plans_keep_away_from_hazards_that_reach():
    hazard = np.full(36, 0.02)
    hazard[[14, 15, 20, 21]] = 0.6
    hazard[0] = 0.0
    belief = Belief.from_maps(hazard, np.full(36, 0.5), np.full(36, 0.5)).on(GRID)
    options = SearchOptions('beam', 12, loss_cost=20.0)
    ignorant, reaching = (
        plan(GRID, belief, SensorModel(0.9, 0.001, reach=reach), options) for reach in (0.0, 0.6)
    )
    model = SensorModel(0.9, 0.001, reach=0.6)
    assert reaching.survival > Plan.along(ignorant.path, belief, model).survival
    assert reaching.information == path_information(belief, model, reaching.path)
    pair = plan_team(GRID, belief, model, Team(2), options)
    assert len({each.path.tobytes() for each in pair}) == 2


def flown(true, robots=50, unknowns=None, seed=3):
    world = World.random(GRID, seed, 0.15, 0.8, 0.1)
    return run_mission(
        GRID,
        PRIOR,
        SensorModel(0.5, 0.001),
        world,
        robots,
        seed,
        options=NEAR,
        truth=Truth(true),
        learning=Learning(unknowns or Unknowns(lethality=(0.0, 1.0), reach=(0.0, 0.6))),
    )


@pytest.mark.slow
def test_the_reach_is_learnt_and_certificates_know_it():
    found = flown(REACHING).estimator
    assert found.parameters['reach'].zero < 0.1
    assert found.parameters['reach'].mean == pytest.approx(0.4, abs=0.2)
    assert found.model.reach == pytest.approx(found.parameters['reach'].mean)
    none = flown(SensorModel(0.9, 0.001)).estimator
    assert none.parameters['reach'].zero > 0.8
    mixture = Mixture(*found.hypotheses, around=GRID.around)
    lane = Lane(35).decide(GRID, mixture, found.model, 12)
    ignoring = Mixture(*found.hypotheses).survival(lane.path, SensorModel(0.5, 0.001))
    assert lane.survival < ignoring


@for_each('make, why', [
    (lambda: Estimator(Belief(PRIOR.joint), REACHING), 'the belief has no grid to reach on'),
    (lambda: Estimator(PRIOR, REACHING, 'kappa_bnitp_sampled'), 'takes no reach: use relaxed_itp'),
    (lambda: Estimator(PRIOR, REACHING, 'kappa_bnitp_published'), 'takes no reach'),
    (lambda: Estimator(PRIOR, REACHING, dynamics=Dynamics('used_up')), 'hazards are used_up'),
    (lambda: Estimator(PRIOR, REACHING, dynamics=Dynamics('learn')), 'hazards are learn'),
    (lambda: path_information(Belief(PRIOR.joint), REACHING, [0, 1, 0]), 'has no grid to reach'),
    (lambda: SensorModel(0.5, reach=1.5), 'reach is 1.5: it must be a probability'),
    (lambda: Unknowns(kappa=Beta(zero=0.5)), 'kappa has a prior with zero = 0.5: only reach'),
    (lambda: update(PRIOR, REACHING, Observation([0, 1, 0], False), 'relaxed_bnitp'), 'takes no'),
])  # fmt: skip
def test_reach_is_refused_where_it_cannot_be(make, why):
    with pytest.raises(ValueError, match=why):
        make()
