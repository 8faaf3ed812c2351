# SPDX-License-Identifier: Apache-2.0
"""Beliefs in hazards that change or move follow the dynamics of worlds."""

from itertools import product

import brute_force
import hazards_in_time
from kbnitp_ros.core import (
    Belief,
    Dynamics,
    Estimator,
    Grid,
    METHODS,
    Observation,
    RobotType,
    run_mission,
    SensorModel,
    World,
)
from kbnitp_ros.core.field.sensor import SENSORS
from kbnitp_ros.core.field.unknowns import joint_after_moves, neighbors_to_move_to
from kbnitp_ros.core.inference.filter import hazards_used_up
from kbnitp_ros.core.inference.methods import supported_dynamics
from laws import for_each
import numpy as np
import pytest

CASES = range(300)
SIZES = ((2, 3), (2, 3), (3, 3), (2, 3), (4, 3))
KINDS = ('changing', 'used_up', 'static')
EXACT = ('kappa_bnitp', 'relaxed_itp')

# From the base to the base in one step, a robot learns nothing.
UNEVENTFUL = SensorModel(0.0, malfunction=0.0), [0, 0], [-1], None


def drawn(seed, kind, size=None):
    rng = np.random.default_rng([seed, len(kind)])
    width, height = size or SIZES[seed % len(SIZES)]
    base = int(rng.integers(width * height))
    joint = brute_force.random_joint(rng, width * height, base)
    rates = rng.choice([0.0, 0.01, 0.2, 1.0], 2) if kind == 'changing' else (0.0, 0.0)
    deployments = []
    for _ in range(4):
        model = SensorModel(**brute_force.random_sensors(rng))
        path = brute_force.random_path(rng, width, height, base, int(rng.integers(1, 9)))
        readings = rng.integers(-1, 2, len(path) - 1)
        steps = len(path) - 1
        lost_at = np.ones(steps)
        if rng.random() < 0.6:
            lost_at = rng.random(steps) * (np.arange(steps) >= rng.integers(steps))
        ended = (None, lost_at) if rng.random() < 0.5 else (readings, None)
        deployments.append((model, path, *ended))
    return joint, Dynamics(kind, *rates), deployments


def seen(path, readings, lost_at):
    return Observation(path, readings is not None, readings, lost_at=lost_at)


def is_taken_in(estimator, observation, robot_type):
    """Return False if an estimator refuses an outcome as impossible."""
    try:
        estimator.assimilate(observation, robot_type)
    except ValueError as error:
        if 'impossible' not in str(error):
            raise
        return False
    return True


@pytest.mark.parametrize('method', EXACT)
@for_each('kind, seed', [(kind, seed) for seed in CASES for kind in KINDS], every=10)
def test_each_deployment_is_taken_in_exactly(method, kind, seed):
    """After one change of each cell's prior belief."""
    joint, dynamics, deployments = drawn(seed, kind)
    prior = Belief(joint) if method == 'kappa_bnitp' else Belief(joint).independent()
    estimator = Estimator(prior, SensorModel(0.5), method, dynamics=dynamics)
    possible, done = prior.hazard > 0, []
    for flown in deployments:
        model, *ended = flown
        before = estimator.belief.joint
        changes = [UNEVENTFUL] if done else []
        expected = hazards_in_time.posterior(before, dynamics, *changes, flown, possible=possible)
        outcome = seen(*ended), RobotType(**{name: getattr(model, name) for name in SENSORS})
        if not is_taken_in(estimator, *outcome):
            assert estimator.belief.joint.tobytes() == before.tobytes()
            assert hazards_in_time.posterior(joint, dynamics, *done, flown) is None
            continue
        done.append(flown)
        np.testing.assert_allclose(estimator.belief.joint, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize('method', METHODS)
def test_no_rates_are_static_hazards(method):
    """Bit for bit, for every method."""
    joint, _, deployments = drawn(1, 'changing')
    beliefs = []
    for dynamics in (Dynamics('changing'), Dynamics()):
        estimator = Estimator(Belief(joint), SensorModel(0.5), method, dynamics=dynamics)
        for _, *ended in deployments:
            estimator.assimilate(seen(*ended))
        beliefs.append(estimator.belief.joint.tobytes())
    assert beliefs[0] == beliefs[1]


@for_each('method', METHODS)
def test_a_method_refuses_dynamics_that_it_does_not_support(method):
    prior = Belief.from_maps([0.0, 0.5], [0.5, 0.5], [0.5, 0.5])
    for dynamics in (Dynamics('changing', 0.1, 0.1), Dynamics('used_up')):
        able = [
            name for name, each in METHODS.items() if dynamics.kind in supported_dynamics(each)
        ]
        if method in able:
            Estimator(prior, SensorModel(0.5), method, dynamics=dynamics)
            continue
        with pytest.raises(ValueError, match=f'{method} .* {dynamics.kind}') as refusal:
            Estimator(prior, SensorModel(0.5), method, dynamics=dynamics)
        assert all(name in str(refusal.value) for name in able)


@for_each('lethality, method', product((0.5, 1.0), EXACT))
def test_two_losses_that_one_hazard_alone_explains_are_refused(lethality, method):
    prior = Belief.from_maps([0.0, 0.5, 0.0, 0.0], [0.5] * 4, [0.5] * 4)
    model = SensorModel(lethality, malfunction=0.0, false_negative=0.0)
    estimator = Estimator(prior, model, method, dynamics=Dynamics('used_up'))
    loss = Observation([0, 1, 2, 3, 0], False)
    estimator.assimilate(loss)
    before = estimator.belief.joint.tobytes()
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(loss)
    assert estimator.belief.joint.tobytes() == before
    estimator.assimilate(loss, RobotType(malfunction=0.1))


@pytest.mark.slow
def test_worlds_change_by_the_stated_dynamics():
    """A hazard is gone once it struck; only chance adds hazards, and only where allowed."""
    grid = Grid(4, 3, base=5, blocked=(0,))
    prior, model = Belief.prior(grid, 0.5, 0.4, 0.8), SensorModel(0.5, 0.05, 0.3)
    rng = np.random.default_rng(5)
    used_up, changing = Dynamics('used_up'), Dynamics('changing', 0.3, 0.6)
    for dynamics in (used_up, changing):
        world = World.random(grid, rng, 0.5, 0.8, 0.1)
        made = run_mission(grid, prior, model, world, 60, rng, dynamics=dynamics)
        fields = np.array([world.hazard, *(each.world.hazard for each in made)])
        assert not fields[:, [0, 5]].any()
        assert all(np.array_equal(deployment.world.target, world.target) for deployment in made)
        came, went = ~fields[:-1] & fields[1:], fields[:-1] & ~fields[1:]
        if dynamics is used_up:
            assert went.any()
            assert not came.any()
            for each, gone in zip(made, went):
                assert set(np.flatnonzero(gone)) <= set(each.observation.path.tolist())
        else:
            # Before each robot but the first.
            assert np.array_equal(fields[0], fields[1])
            may = grid.may_be_hazardous
            for share, of, rate in ((came, ~fields, 0.3), (went, fields, 0.6)):
                times = of[1:-1, may].sum()
                spread = np.sqrt(times * rate * (1 - rate))
                assert abs(share[1:, may].sum() - times * rate) < 5 * spread


GRID = Grid(3, 3, blocked=(5,))
POSSIBLE = GRID.may_be_hazardous


def drawn_belief(seed):
    """Draw a belief with no hazard at the base and in the blocked cell."""
    joint = brute_force.random_joint(np.random.default_rng(seed), 9, GRID.base)
    joint[5] = [[1.0, 0.0], [0.0, 0.0]]
    return joint


@pytest.mark.slow
@for_each('seed, move', [(seed, move) for seed in range(4) for move in (0.02, 0.3)], every=2)
def test_a_prediction_is_close_to_drawn_worlds(seed, move):
    dynamics, rng, draws = Dynamics('moving', move=move), np.random.default_rng(seed), 4000
    joint = drawn_belief(seed)
    hazard = joint[:, 1].sum(axis=1)
    after = np.zeros(9)
    for _ in range(draws):
        world = World(rng.random(9) < hazard, np.zeros(9, bool))
        moved = world.after_change(dynamics, GRID, POSSIBLE, rng)
        assert moved.hazard.sum() == world.hazard.sum()
        after += moved.hazard
    predicted = joint_after_moves(joint, neighbors_to_move_to(GRID, POSSIBLE), move)
    error = np.sqrt(0.25 / draws)
    np.testing.assert_allclose(
        predicted[:, 1].sum(axis=1), after / draws, atol=4 * error + move / 5
    )


@for_each('seed', range(30))
def test_a_prediction_keeps_targets_and_the_number_of_hazards(seed):
    rng, joint = np.random.default_rng(seed), drawn_belief(seed)
    after = joint_after_moves(joint, neighbors_to_move_to(GRID, POSSIBLE), rng.random())
    assert after.min() >= 0.0
    assert after[:, 1].sum() == pytest.approx(joint[:, 1].sum(), abs=1e-12)
    np.testing.assert_allclose(after.sum(axis=1), joint.sum(axis=1), atol=1e-12)
    assert after[[GRID.base, 5], 1].sum() == 0.0


def test_a_return_without_a_vouched_step_uses_up_no_hazard():
    belief, model = Belief.prior(Grid(3, 3), 0.3, 0.4, 0.8), SensorModel(0.5)
    outcome = Observation([0, 1, 0], True, [-1, -1], entered=[False, False])
    assert not hazards_used_up(belief, model, outcome).any()
