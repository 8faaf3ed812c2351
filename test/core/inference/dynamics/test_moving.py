# SPDX-License-Identifier: Apache-2.0
"""Hazards that move: the prediction of a filter against draws of the world, and what it keeps."""

import brute_force
from kbnitp_ros.core import Belief, Dynamics, Estimator, Grid, SensorModel, World
from kbnitp_ros.core.field.unknowns import joint_after_moves, neighbors_to_move_to
from laws import for_each
import numpy as np
import pytest

GRID = Grid(3, 3, blocked=(5,))
POSSIBLE = GRID.may_be_hazardous


def drawn(seed):
    """Draw a belief with no hazard at the base and in the blocked cell."""
    joint = brute_force.random_joint(np.random.default_rng(seed), 9, GRID.base)
    joint[5] = [[1.0, 0.0], [0.0, 0.0]]
    return joint


@for_each('seed, move', [(seed, move) for seed in range(4) for move in (0.02, 0.3)], every=2)
def test_a_prediction_is_close_to_what_worlds_do(seed, move):
    dynamics, rng, draws = Dynamics('moving', move=move), np.random.default_rng(seed), 4000
    joint = drawn(seed)
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
    rng, joint = np.random.default_rng(seed), drawn(seed)
    after = joint_after_moves(joint, neighbors_to_move_to(GRID, POSSIBLE), rng.random())
    assert after.min() >= 0.0
    assert after[:, 1].sum() == pytest.approx(joint[:, 1].sum(), abs=1e-12)
    np.testing.assert_allclose(after.sum(axis=1), joint.sum(axis=1), atol=1e-12)
    assert after[[GRID.base, 5], 1].sum() == 0.0


def test_moving_hazards_need_a_grid():
    belief = Belief.from_maps([0.0, 0.5], [0.5, 0.5], [0.5, 0.5])
    with pytest.raises(ValueError, match=r'moving.*no grid.*Belief.prior\(grid'):
        Estimator(belief, SensorModel(0.5), dynamics=Dynamics('moving', move=0.1))


@for_each(
    'rates, message',
    [
        ({'kind': 'changing', 'move': 0.1}, 'move is 0.1 and hazards are changing: only moving'),
        ({'kind': 'moving', 'appear': 0.1}, 'appear is 0.1 and hazards are moving: only changing'),
        ({'kind': 'moving', 'move': 1.5}, 'move is 1.5'),
    ],
)
def test_rates_of_another_kind_are_refused(rates, message):
    with pytest.raises(ValueError, match=message):
        Dynamics(**rates)
