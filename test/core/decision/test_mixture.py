# SPDX-License-Identifier: Apache-2.0
"""Decisions by weighted products over hypotheses, their errors, and the numbers they trust."""

from itertools import product
from math import comb

from brute_force import random_path, random_sensors
from kbnitp_ros.core import (
    Area,
    Belief,
    Beta,
    Dynamics,
    Estimator,
    Grid,
    KnownModel,
    Lane,
    Learning,
    Mission,
    Mixture,
    Observation,
    RobotType,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    World,
)
from kbnitp_ros.core.decision import hazard_draws
from kbnitp_ros.core.decision.hazard_draws import highest_confidence, joint_hazards
from kbnitp_ros.core.decision.told import with_told
from kbnitp_ros.core.field.unknowns import ALL_KNOWN
from kbnitp_ros.core.inference import particles
from kbnitp_ros.core.mission import decided
from laws import for_each
import numpy as np
import pytest

SHAPES = ((3, 3), (3, 2), (4, 2))
TWO = Unknowns(lethality=(0.0, 1.0), hazard_density=(0.02, 0.6))


@for_each('seed', range(60), every=3)
def test_probabilities_are_sums_over_hypotheses_and_all_their_states(seed):
    rng = np.random.default_rng([seed, 31])
    width, height = SHAPES[seed % 3]
    cells, members = width * height, int(rng.integers(1, 5))
    hazard, weights = rng.random((members, cells)), rng.dirichlet(np.ones(members))
    rates = {'lethality': rng.random(members), 'malfunction': rng.random(members) * 0.3}
    rates = {name: each for name, each in rates.items() if rng.random() < 0.5}
    model = SensorModel(**random_sensors(rng))
    mixture = Mixture(hazard, weights, rates)
    path = random_path(rng, width, height, 0, int(rng.integers(1, 9)))
    some = rng.choice(cells, int(rng.integers(1, cells)), replace=False)
    free, survived, count = 0.0, 0.0, np.zeros(some.size + 1)
    for state in product((0, 1), repeat=cells):
        here = np.array(state)
        for member, weight in enumerate(weights):
            chance = weight * np.where(here, hazard[member], 1.0 - hazard[member]).prod()
            lethality, malfunction = (
                rates[name][member] if name in rates else getattr(model, name)
                for name in ('lethality', 'malfunction')
            )
            spared = 1.0 - here[path[1:]] * lethality * (1.0 - model.false_negative)
            survived += chance * (spared * (1.0 - malfunction)).prod()
            count[here[some].sum()] += chance
            free += chance * (not here[some].any())
    assert mixture.p_free(some) == pytest.approx(free, abs=1e-12)
    assert mixture.survival(path, model) == pytest.approx(survived, abs=1e-12)
    np.testing.assert_allclose(mixture.hazard_count(some), count, atol=1e-12)
    np.testing.assert_allclose(mixture.p_hazard(), weights @ hazard, atol=1e-12)
    assert (mixture.error(some) > 0.0) == (members > 1)


def test_hazards_of_many_cells_are_counted_under_representative_hypotheses(monkeypatch):
    """Under one of two equally likely hypotheses, a binomial number of hazards."""
    cells, hazard = 30, np.repeat([[0.1], [0.4]], [300, 300], axis=0) * np.ones(30)
    monkeypatch.setattr(hazard_draws, 'MAX_PRODUCTS', 20 * (cells + 1) ** 2)
    count = Mixture(hazard, np.full(600, 1 / 600)).hazard_count(range(cells))
    ways = np.array([comb(cells, n) for n in range(cells + 1)], dtype=float)
    n = np.arange(cells + 1)
    expected = sum(0.5 * ways * p**n * (1 - p) ** (cells - n) for p in (0.1, 0.4))
    np.testing.assert_allclose(count, expected, atol=1e-12)


GRID = Grid(5, 5)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)
NEAR = SearchOptions('relaxed', 12)
MODEL = SensorModel(0.5)
WORLD = World.random(GRID, 5, 0.15, 0.8, 0.1)
SAFE = np.flatnonzero(~WORLD.hazard)[1:4].tolist()


def flown(robots=15, true=0.6, believed=0.6, unknowns=ALL_KNOWN, goal=None, **options):
    mission = run_mission(
        GRID, PRIOR, SensorModel(true), WORLD, robots, 3, options=NEAR, goal=goal
    )
    estimator = Estimator(PRIOR, SensorModel(believed), unknowns=unknowns, **options)
    for deployment in mission:
        estimator.assimilate(deployment.observation)
    return estimator


@for_each('options', [
    {}, {'unknowns': TWO}, {'dynamics': Dynamics('learn', vanish=(0.01, 0.1))},
    {'method': 'relaxed_itp', 'unknowns': Unknowns(malfunction=Beta(2, 30))},
])  # fmt: skip
def test_hypotheses_have_the_mean_of_the_belief_and_draws_agree(options):
    estimator = flown(**options)
    mixture, lane = joint_hazards(estimator, 15), [0, 6, 12, 18]
    np.testing.assert_allclose(mixture.p_hazard(), estimator.belief.hazard, rtol=0, atol=1e-12)
    hazardous, _ = estimator.draws(20_000, np.random.default_rng(1))
    expected = 1.0 - hazardous[:, lane].any(axis=1).mean()
    assert mixture.p_free(lane) == pytest.approx(expected, abs=0.02)
    assert (mixture.error(lane) == 0.0) == (options == {})


def test_methods_that_draw_cells_independently_have_one_hypothesis():
    class Own(KnownModel):
        """A method without draws."""

        def assimilate(self, observation, robot_type):
            pass

    mixture = joint_hazards(Estimator(PRIOR, SensorModel(0.5), Own), 0)
    assert mixture.p_free([1, 2]) == pytest.approx(0.85**2, abs=1e-12)
    assert mixture.error([1, 2]) == 0.0
    sampled = Estimator(PRIOR, SensorModel(0.5), 'kappa_bnitp_sampled')
    assert isinstance(joint_hazards(sampled, 0), hazard_draws.HazardDraws)


@pytest.mark.slow
def test_the_error_is_the_spread_over_seeds():
    goal = Area(SAFE)
    decisions = [
        decided(goal, GRID, flown(unknowns=TWO, goal=goal, seed=seed), 15, NEAR)
        for seed in range(12)
    ]
    spread = np.std([each.p_free for each in decisions], ddof=1)
    assert 0.3 * spread < np.mean([each.error for each in decisions]) < 6.0 * spread


def test_a_confidence_that_particles_cannot_tell_is_out_of_reach():
    known, learnt = (Estimator(PRIOR, SensorModel(0.5), unknowns=u) for u in (Unknowns(), TWO))
    sampled = Estimator(PRIOR, SensorModel(0.5), 'kappa_bnitp_sampled')
    assert highest_confidence(known) == 1.0 > highest_confidence(learnt) > 0.999
    assert highest_confidence(sampled) == pytest.approx(0.998, abs=1e-4)
    kinds = Estimator(PRIOR, SensorModel(0.5), dynamics=Dynamics('learn', 0.01, 0.05, 0.2))
    assert highest_confidence(kinds) == 1.0


def own_type(lethality):
    return RobotType(lethality=lethality, false_positive=0.1)


@for_each('name, factor', product(('malfunction', 'kappa', 'false_positive'), (1.5, 2 / 3)))
def test_a_retold_bank_has_the_filters_of_the_other_number(monkeypatch, name, factor):
    """Without resampling it is the bank that was told the other number from the start."""
    monkeypatch.setattr(particles.Filters, '_resample', lambda *_: None)
    seen = [
        (Observation([0, 1, 2, 1, 0], True, [1, 0, -1, 1]), RobotType()),
        (Observation([0, 5, 6, 5, 0], False), own_type(0.9)),
        (Observation([0, 6, 12, 6, 0], True, [0, 1, 1, 0]), own_type(0.9)),
        (Observation([0, 1, 0], False), RobotType()),
    ]
    told = {'malfunction': 0.04, 'false_positive': 0.06}
    changed = {name: told[name] * factor} if name in told else {}
    kappa = 0.8 * factor if name == 'kappa' else 0.8
    # P(X = 1 | Z = 0) stays as it is.
    target = 0.15 * min(kappa, 1.0) + 0.205 - 0.15 * 0.8
    prior = Belief.prior(GRID, 0.15, target, min(kappa, 1.0))
    first = Estimator(PRIOR, SensorModel(0.5, **told), unknowns=TWO)
    second = Estimator(prior, SensorModel(0.5, **told | changed), unknowns=TWO)
    own = {name: min(0.1 * factor, 1.0)} if name == 'false_positive' else {}
    for observation, robot_type in seen:
        first.assimilate(observation, robot_type)
        if robot_type.sensors:
            robot_type = RobotType(**robot_type.sensors | own)
        second.assimilate(observation, robot_type)
    again = first.retold(name, factor)
    np.testing.assert_allclose(again.belief.joint, second.belief.joint, rtol=0, atol=1e-10)
    mine, theirs = (joint_hazards(each, 4).p_free([6, 7]) for each in (again, second))
    assert mine == pytest.approx(theirs, abs=1e-10)


def test_a_retold_sampler_or_known_model_assimilates_again():
    seen = Observation([0, 1, 2, 1, 0], False)
    for method in ('kappa_bnitp', 'kappa_bnitp_sampled'):
        told, other = (Estimator(PRIOR, SensorModel(each), method) for each in (0.4, 0.6))
        told.assimilate(seen)
        other.assimilate(seen)
        again = told.retold('lethality', 1.5)
        np.testing.assert_allclose(again.belief.joint, other.belief.joint, rtol=0, atol=1e-12)


def test_a_decision_names_the_told_numbers_that_it_trusts():
    goal = Area(SAFE, 0.8)
    told = decided(goal, GRID, flown(40, true=0.4, believed=0.8), 40, NEAR)
    assert told.reached
    value, other, p_free, _ = told.told['lethality']
    assert (value, other) == (0.8, pytest.approx(0.8 / 1.5))
    assert p_free < told.p_free - 0.01
    assert told.trusts[[*told.told].index('lethality')] == (
        f'trusts the lethality that you set, 0.8: with 0.53 the probability is {p_free:.2f}'
    )
    # Near 1 a smaller change counts, which doubles the risk or more.
    sure = decided(goal, GRID, flown(60, true=0.4, believed=0.8), 60, NEAR)
    assert sure.p_free - 0.01 < sure.told['lethality'].p_free < sure.p_free - 0.001
    assert sure.trusts == [
        f'trusts the lethality that you set, 0.8: with 0.53 the probability is '
        f'{sure.told["lethality"].p_free:.4f}'
    ]
    learning = flown(40, true=0.4, believed=0.8, unknowns=TWO)
    learnt = with_told(decided(goal, GRID, learning, 40, NEAR), learning, 40)
    assert not {'lethality', 'hazard_density'} & learnt.told.keys()
    lane = Lane(24).decide(GRID, joint_hazards(learning, 40), learning.model, 12)
    assert not lane.told
    trusted = with_told(lane, learning, 40).told['malfunction']
    assert abs(trusted.survival - lane.survival) > 0.01


def test_plans_of_a_mission_state_the_survival_over_all_particles():
    own = RobotType(lethality=0.9)
    mission = Mission(
        GRID, PRIOR, SensorModel(0.5), WORLD, 1, learning=Learning(TWO), truth=Truth(MODEL)
    )
    paths, types = [[0, 1, 2, 1, 0], [0, 6, 12, 6, 0]] * 2, [RobotType(), RobotType(), own, own]
    for path, robot_type in zip(paths, types):
        hazard, weights, rates = mission.estimator.hypotheses
        lethality = np.full(len(weights), 0.9) if robot_type is own else rates['lethality']
        survival = 0.0
        for p, weight, strikes in zip(hazard, weights, lethality):
            counts = np.bincount(path[1:], minlength=25)
            each = 1.0 - p + p * (1.0 - strikes * 0.95) ** counts
            survival += weight * each.prod() * 0.95**4
        mission.send(path, robot_type)
        assert mission[-1].plan.survival == pytest.approx(survival, abs=1e-12)
