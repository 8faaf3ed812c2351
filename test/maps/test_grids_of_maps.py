# SPDX-License-Identifier: Apache-2.0
"""The grid of a map keeps robots away from what is occupied."""

from itertools import pairwise, product

from kbnitp_ros.core import (
    Belief,
    Execution,
    plan,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Truth,
    World,
)
from kbnitp_ros.maps import Map, MapError
from laws import for_each
import numpy as np
import pytest


def random_map(rng):
    """Draw a map of up to 30x30 pixels, a fifth of them unknown or occupied, in clumps."""
    coarse = rng.choice([0, 0, 0, 0, 0, 0, 50, 100, -1], rng.integers(1, 11, 2))
    data = coarse.repeat(rng.integers(1, 4), axis=0).repeat(rng.integers(1, 4), axis=1)
    yaw = rng.choice([0.0, rng.uniform(-np.pi, np.pi)])
    return Map(data.astype(np.int8), 0.25, (-3.0, 1.5), yaw)


def turned(points, angle):
    """Return points x, y turned about 0."""
    at = np.exp(1j * angle) * (points @ (1, 1j))
    return np.stack([at.real, at.imag], axis=-1)


def touched_pixels(field, points):
    """Return the values of all pixels that the straight lines between points cross or touch."""
    values = []
    for start, end in pairwise(points):
        along = np.linspace(start, end, 201)
        pixel = turned(along - np.array(field.origin), -field.yaw) / field.resolution
        # A line on the edge of a pixel touches both.
        for nudge in ((-1e-9, -1e-9), (-1e-9, 1e-9), (1e-9, -1e-9), (1e-9, 1e-9)):
            column, row = np.floor(pixel + nudge).astype(int).T
            inside = (row < field.data.shape[0]) & (column < field.data.shape[1])
            values.append(field.data[row[inside], column[inside]])
    return np.concatenate(values)


def random_grid(rng, connectivity, unknown_blocks):
    """Draw a map and the grid of it around a base that is free."""
    side = rng.choice([0.25, 0.5, 0.6, 0.75, 1.0])
    while True:
        field = random_map(rng)
        size = np.array(field.data.shape[::-1]) * field.resolution
        place = turned(rng.uniform(0, 1, 2) * size, field.yaw) + field.origin
        try:
            return field, field.grid(side, tuple(place), connectivity, unknown_blocks)
        except MapError:
            continue


@pytest.mark.slow
@for_each('seed, connectivity', product(range(200), [4, 8]), every=3)
def test_no_walk_touches_an_occupied_pixel(seed, connectivity):
    rng = np.random.default_rng(seed)
    unknown_blocks = bool(rng.integers(2))
    field, free = random_grid(rng, connectivity, unknown_blocks)
    cell, walk = free.base, [free.base]
    for _ in range(60):
        cell = int(rng.choice(free.neighbors(cell)))
        walk.append(cell)
    touched = touched_pixels(field, free.centers(walk))
    assert not (touched == 100).any()
    assert not (unknown_blocks and (touched == -1).any())


@pytest.mark.slow
@for_each('seed', range(200), every=4)
def test_no_robot_of_a_mission_touches_an_occupied_pixel(seed):
    """Neither by its orders nor by the detours that it makes."""
    rng = np.random.default_rng(seed)
    field, grid = random_grid(rng, int(rng.choice([4, 8])), True)
    world = World.random(grid, rng, 0.1, 0.8, 0.3)
    made = run_mission(
        grid,
        Belief.prior(grid, 0.1, 0.35, 0.8),
        SensorModel(0.3, malfunction=0.01),
        world,
        4,
        rng,
        options=SearchOptions('relaxed', max_steps=14),
        team=Team(min(2, int(grid.free.sum()))),
        truth=Truth(execution=Execution(detour=0.3, early_return=0.05)),
    )
    for deployment in made:
        for path in (deployment.plan.path, deployment.observation.path):
            assert (touched_pixels(field, grid.centers(path)) < 100).all()
            assert (touched_pixels(field, grid.centers(path)) >= 0).all()


def test_a_plan_keeps_clear_of_a_wall():
    # A wall with a gap, and nothing to look for on this side of it.
    data = np.zeros((6, 6), dtype=np.int8)
    data[2, 1:] = 100
    field = Map(data, 0.5, (0.0, 0.0))
    grid = field.grid(base_position=(0.75, 0.75))
    target = np.where(np.arange(36) < 12, 0.0, 0.5)
    belief = Belief.from_maps(np.zeros(36), target, target)
    path = plan(grid, belief, SensorModel(lethality=0.5), max_steps=12).path
    assert max(path) > 18
    assert not (touched_pixels(field, grid.centers(path)) == 100).any()


def test_a_cell_is_blocked_by_any_of_its_pixels():
    data = np.array([[0, 0, 0, 0], [0, 0, 0, 100], [0, 0, 0, 0], [-1, 0, 0, 0]], dtype=np.int8)
    field = Map(data, 0.5, (1.0, 2.0))
    assert field.grid(1.0, (1.1, 2.1)).blocked == {1, 2}
    assert field.grid(1.0, (1.1, 2.1), unknown_blocks=False).blocked == {1}
    assert field.grid(base_position=(1.1, 2.1)).blocked == {7, 12}


@for_each('value', [-1, 0, 50, 99, 100])
def test_what_is_neither_occupied_nor_unknown_is_free(value):
    data = np.array([[0, value]], dtype=np.int8)
    assert bool(Map(data, 1.0, (0.0, 0.0)).grid().blocked) == (value in (-1, 100))


def test_cells_that_reach_beyond_the_map_are_unknown_there():
    field = Map(np.zeros((3, 5), dtype=np.int8), 1.0, (0.0, 0.0))
    grid = field.grid(2.0)
    assert (grid.width, grid.height, grid.resolution) == (3, 2, 2.0)
    assert grid.blocked == {2, 3, 4, 5}
    assert not field.grid(2.0, unknown_blocks=False).blocked


def test_resolutions_that_are_not_exact_in_binary_divide_evenly():
    field = Map(np.zeros((60, 90), dtype=np.int8), 0.05, (-1.0, 0.0))
    grid = field.grid(0.15)
    assert (grid.width, grid.height) == (30, 20)
    assert not grid.blocked


def test_a_cell_that_shares_part_of_an_occupied_pixel_is_blocked():
    data = np.zeros((1, 6), dtype=np.int8)
    data[0, 2] = 100
    blocked = Map(data, 1.0, (0.0, 0.0)).grid(1.5, unknown_blocks=False).blocked
    assert blocked == {1}
    data[0, [2, 1]] = 0, 100
    assert Map(data, 1.0, (0.0, 0.0)).grid(1.5, unknown_blocks=False, base=3).blocked == {0, 1}


@for_each('arguments, message', [
    ({'resolution': 0.4}, 'grid resolution is 0.4.*0.5'),
    ({'resolution': float('nan')}, 'grid resolution is nan'),
    ({'base_position': (3.0, 0.2)}, 'outside the grid'),
    ({'base_position': (0.7, 0.2)}, 'base, cell 1 .*blocked'),
    ({'base': 1}, 'base, cell 1 .*blocked'),
    ({'base': 9}, 'base is 9'),
    ({'connectivity': 5}, 'connectivity is 5'),
])  # fmt: skip
def test_what_no_grid_can_be_is_refused(arguments, message):
    data = np.array([[0, 100], [0, 0]], dtype=np.int8)
    with pytest.raises(ValueError, match=message):
        Map(data, 0.5, (0.0, 0.0)).grid(**arguments)
