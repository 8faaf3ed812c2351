# SPDX-License-Identifier: Apache-2.0
"""The hidden world: how it is drawn and what it does to a robot."""

from itertools import product
import math
from types import SimpleNamespace

import brute_force
from kbnitp_ros.core import Grid, SensorModel, World
from laws import for_each
import numpy as np
import pytest

SIGMAS = 5


def assert_share(count, of, probability):
    """Hold a count against the binomial it is drawn from."""
    spread = math.sqrt(of * probability * (1 - probability))
    assert abs(count - of * probability) <= SIGMAS * spread + 1e-9


def draw(grid, rng, **densities):
    return World.random(
        grid, rng, **{'hazard_density': 0.15, 'kappa': 0.8, 'target_background': 0.1, **densities}
    )


def test_random_worlds_have_the_densities_asked_for():
    grid = Grid(100, 100, base=42, blocked=(7, 9))
    world = draw(grid, np.random.default_rng(1))
    free = np.delete(np.arange(10000), [7, 9, 42])
    hazard, target = world.hazard[free], world.target[free]
    assert world.hazard.dtype == world.target.dtype == bool
    assert world.hazard.shape == world.target.shape == (10000,)
    assert_share(hazard.sum(), len(free), 0.15)
    assert_share(target[hazard].sum(), hazard.sum(), 0.8)
    assert_share(target[~hazard].sum(), (~hazard).sum(), 0.1)


def test_no_world_has_a_hazard_at_the_base_or_anything_in_a_blocked_cell():
    grid = Grid(3, 3, base=4, blocked=(0, 8))
    full = {'hazard_density': 1.0, 'kappa': 1.0, 'target_background': 1.0}
    world = draw(grid, np.random.default_rng(0), **full)
    assert world.hazard.tolist() == [False, True, True, True, False, True, True, True, False]
    assert world.target.tolist() == [False] + [True] * 7 + [False]


def test_the_base_holds_a_target_as_any_cell_without_hazard():
    rng = np.random.default_rng(2)
    targets = sum(draw(Grid(1, 1), rng, target_background=0.3).target[0] for _ in range(2000))
    assert_share(targets, 2000, 0.3)


@for_each(
    'field, value',
    product(['hazard_density', 'kappa', 'target_background'], [-0.1, 1.1, math.nan]),
)
def test_densities_are_probabilities(field, value):
    with pytest.raises(ValueError, match=rf'{field} is {value}.*\[0, 1\]'):
        draw(Grid(3, 3), np.random.default_rng(0), **{field: value})


@for_each('hazard, target, message', [
    ([False] * 3, [False] * 4, 'target.*4.*3'),
    ([], [], 'hazard.*shape'),
    ([[False], [True]], [[False], [True]], 'hazard.*shape'),
    ([0.5, 0.0], [False, True], 'hazard.*0.5'),
    ([False, True], [2, 0], 'target.*2'),
    ([math.nan, 0.0], [False, True], 'hazard.*nan'),
])  # fmt: skip
def test_bad_worlds_are_refused(hazard, target, message):
    with pytest.raises(ValueError, match=message):
        World(hazard, target)


@for_each('hazard, target, message', [
    ([0, 0, 0], [0, 0, 0], 'world.*3 cells.*2 x 2'),
    ([0, 1, 0, 0], [0, 0, 0, 0], 'hazard.*base 1'),
    ([0, 0, 0, 1], [0, 0, 0, 0], 'cell 3.*blocked'),
    ([0, 0, 0, 0], [0, 0, 0, 1], 'cell 3.*blocked'),
])  # fmt: skip
def test_worlds_that_do_not_fit_the_grid_are_refused(hazard, target, message):
    world = World(np.array(hazard, bool), np.array(target, bool))
    with pytest.raises(ValueError, match=message):
        world.check(Grid(2, 2, base=1, blocked=(3,)))


def test_worlds_cannot_be_changed():
    world = World([False, True], [True, True])
    with pytest.raises(AttributeError):
        world.hazard = world.target
    for array in (world.hazard, world.target):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = True


HAZARD = [False, True, False, True]
TARGET = [False, True, True, False]


@pytest.mark.slow
@for_each(
    'path, sensors',
    product(
        [[0, 1, 2, 0], [0, 1, 1, 3, 0], [0, 2, 2, 0], [0, 0]],
        [
            {'lethality': 0.3},
            {
                'lethality': 0.6,
                'malfunction': 0.2,
                'false_negative': 0.3,
                'true_positive': 0.7,
                'false_positive': 0.4,
            },
            {'lethality': 0.05, 'malfunction': 0.0},
        ],
    ),
)
def test_robots_return_and_report_as_often_as_predicted(path, sensors):
    world, model, runs = World(HAZARD, TARGET), SensorModel(**sensors), 3000
    rng = np.random.default_rng(7)
    seen = [world.traverse(path, model, rng) for _ in range(runs)]
    assert all(observation.path.tolist() == path for observation in seen)
    returned = [observation.readings for observation in seen if observation.survived]
    s0, s1 = brute_force.step_survival(SimpleNamespace(**vars(model)))
    assert_share(len(returned), runs, math.prod(s1 if HAZARD[cell] else s0 for cell in path[1:]))
    off, on = brute_force.detection(model)
    for step, cell in enumerate(path[1:]):
        positive = sum(bool(readings[step]) for readings in returned)
        assert_share(positive, len(returned), on if TARGET[cell] else off)
    assert all(o.readings is None for o in seen if not o.survived)


def test_readings_of_one_cell_are_drawn_afresh_each_visit():
    model = SensorModel(0.0, malfunction=0.0, true_positive=0.5)
    rng = np.random.default_rng(0)
    world = World([False, False], [False, True])
    pairs = [world.traverse([0, 1, 1, 0], model, rng).readings[:2] for _ in range(2000)]
    assert_share(sum(bool(a) == bool(b) for a, b in pairs), 2000, 0.5)


def test_a_path_outside_the_world_is_refused():
    with pytest.raises(ValueError, match='path.*4.*0 to 3'):
        World(HAZARD, TARGET).traverse([0, 4, 0], SensorModel(0.5), np.random.default_rng(0))
