# SPDX-License-Identifier: Apache-2.0
"""The walk of a robot that is localised where it cannot be."""

from contextlib import suppress

from kbnitp_ros.core import Grid
from kbnitp_ros.robot.way import Walk
from laws import for_each
import numpy as np

GRID = Grid(20, 20)
PATIENCE, TICK = 0.35, 0.1


def follow(walk, places):
    """Have a walk see a robot at these places, one after another."""
    for number, (x, y) in enumerate(places):
        with suppress(ValueError):
            walk.follow(x, y, number * TICK)


@for_each('seed', range(50))
def test_a_walk_is_doubted_by_a_lasting_jump_that_is_faster_than_the_robot(seed):
    rng = np.random.default_rng(seed)
    speed, jump, direction = rng.uniform(0.3, 2.0), rng.uniform(4.0, 8.0), rng.uniform(0, 6.28)
    steps = np.arange(40)[:, None] * TICK * speed * [np.cos(direction), np.sin(direction)]
    places = 10.5 + np.clip(steps, -4, 4)
    jumped = places.copy()
    first, last = 15, 15 + int(rng.integers(1, 20))
    jumped[first:last] -= jump * np.array([np.cos(direction), np.sin(direction)])
    inside = np.clip(jumped, 0.1, 19.9)
    start = int(GRID.cells_at(places[:1])[0])
    for moves, is_doubted in ((places, False), (inside, (last - first - 1) * TICK > PATIENCE)):
        for max_speed in (0.0, 1.1 * speed):
            walk = Walk(GRID, start, PATIENCE, max_speed)
            follow(walk, moves)
            assert bool(walk.doubt) == (is_doubted and max_speed > 0)


def test_a_robot_that_was_not_seen_for_long_enough_has_made_its_way():
    for gap, is_doubted in ((6.0, False), (2.0, True)):
        walk = Walk(GRID, 0, PATIENCE, max_speed=1.0)
        walk.follow(0.5, 0.5, 0.0)
        for time in (gap, gap + 1.0):
            with suppress(ValueError):
                walk.follow(5.5, 0.5, time)
        assert walk.cell == 5
        assert bool(walk.doubt) == is_doubted


@for_each('seed', range(20))
def test_a_walk_in_a_turned_field_is_the_same(seed):
    rng = np.random.default_rng(seed)
    yaw, corner = rng.uniform(-np.pi, np.pi), complex(*rng.uniform(-50, 50, 2))
    steps = rng.uniform(-0.4, 0.4, (200, 2))
    places = np.clip(10.5 + steps.cumsum(axis=0), 0.1, 19.9)
    moved = corner + np.exp(1j * yaw) * (places @ (1, 1j))
    turned = Grid(20, 20, origin=(corner.real, corner.imag), yaw=yaw)
    walks = [Walk(grid, 210, PATIENCE) for grid in (GRID, turned)]
    been = set()
    for number, at in enumerate(moved):
        x, y = places[number]
        ways = [
            walk.follow(*place, number * TICK)
            for walk, place in zip(walks, [(x, y), (at.real, at.imag)])
        ]
        assert ways[0] == ways[1]
        been |= set(ways[0])
        assert walks[0].sees_its_cell(x, y) == walks[1].sees_its_cell(at.real, at.imag)
    assert len(been) > 1
