# SPDX-License-Identifier: Apache-2.0
"""Paths of limited length, against all paths of small fields, and refusals."""

from dataclasses import replace
from functools import cache
from heapq import heappop, heappush
from itertools import pairwise
from math import hypot, inf, sqrt

import brute_force
from kbnitp_ros.core import (
    Belief,
    Grid,
    PathFinder,
    plan,
    plan_team,
    RobotType,
    SearchOptions,
    SensorModel,
    Team,
)
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.regions import keepout_cells
from laws import for_each
import numpy as np
import pytest

FIELDS = [
    (Grid(3, 3), 5, 2),
    (Grid(3, 3, base=4, resolution=0.1), 4, 3),
    (Grid(3, 3, base=5, blocked=(4,), resolution=2.5), 6, 2),
    (Grid(3, 3, base=8, connectivity=4), 6, 3),
    (Grid(3, 3, base=1, blocked=(3, 7), through_corners=False), 6, 1),
    (Grid(4, 3, blocked=(5,), resolution=0.3), 5, 2),
    (Grid(4, 3, base=6, connectivity=4), 6, 2),
    (Grid(4, 3, base=7), 4, 3),
    (Grid(4, 3, base=2, blocked=(1, 3, 6)), 5, 3),
    (Grid(4, 3, base=2, blocked=(1, 3, 6)), 6, 2),
]


def step_length(grid, one, other):
    (row, col), (to_row, to_col) = divmod(one, grid.width), divmod(other, grid.width)
    return hypot(to_row - row, to_col - col) * grid.resolution


def kind_of_step(grid, one, other):
    """Return the number of coordinates that a step changes: 0 for a stay, 2 for a diagonal."""
    (row, col), (to_row, to_col) = divmod(one, grid.width), divmod(other, grid.width)
    return (row != to_row) + (col != to_col)


@cache
def every_path(grid, most_steps, max_visits):
    """Return visits and lengths of all closed paths, and the most labels of a cell."""
    # Straight and diagonal steps are counted, so no sum is rounded.
    ends, closed, needed = {(grid.base, (0,) * grid.cells, 0, 0)}, set(), 1
    for _ in range(most_steps):
        ends = {
            (
                int(cell),
                tuple(n + (each == cell) for each, n in enumerate(visits)),
                straight + (kind_of_step(grid, end, int(cell)) == 1),
                diagonal + (kind_of_step(grid, end, int(cell)) == 2),
            )
            for end, visits, straight, diagonal in ends
            for cell in grid.neighbors(end)
            if visits[cell] < max_visits
        }
        closed |= {each[1:] for each in ends if each[0] == grid.base}
        labels = {each[:2] for each in ends}
        needed = max(needed, np.bincount([end for end, _ in labels]).max())
    visits, straight, diagonal = map(np.array, zip(*sorted(closed)))
    return visits, (straight + diagonal * sqrt(2.0)) * grid.resolution, needed


def problem(seed):
    """Draw a field, a length limit that some paths exceed, and a belief."""
    rng = np.random.default_rng(seed)
    grid, most_steps, max_visits = FIELDS[seed % len(FIELDS)]
    visits, lengths, needed = every_path(grid, most_steps, max_visits)
    allowed = np.unique(lengths[lengths > 0.0])
    allowed = allowed[: max(1, 2 * allowed.size // 3)]
    options = SearchOptions(
        max_steps=most_steps,
        max_visits=max_visits,
        # Sometimes exactly the length of a path, which its sum of steps may exceed by rounding.
        max_distance=float(rng.choice(allowed) * rng.choice([1.0, 1.0, rng.uniform(1.0, 1.4)])),
        loss_cost=float(rng.choice([0.0, 0.0, 0.5])),
        width=2 * int(needed) + 2,
    )
    belief = Belief(brute_force.random_joint(rng, grid.cells, grid.base))
    model = SensorModel(0.6 * float(rng.random()), malfunction=float(rng.choice([0.0, 0.05, 0.3])))
    keeps = visits[(lengths <= options.max_distance + 1e-8) & (lengths > 0.0)]
    returns = brute_force.survival_of_visits(belief.joint, model, keeps)
    information = brute_force.information_of_visits(belief.joint, model, keeps)
    best = (information - options.loss_cost * (1.0 - returns)).max()
    return grid, belief, model, options, best


def path_length(grid, path):
    return sum(step_length(grid, int(a), int(b)) for a, b in pairwise(path))


def found_by(grid, belief, model, options):
    found = plan(grid, belief, model, options)
    assert path_length(grid, grid.check_path(found.path, options.max_steps)) <= (
        options.max_distance * (1.0 + 1e-8)
    )
    return found, found.information - options.loss_cost * (1.0 - found.survival)


@for_each('seed', range(300), every=6)
def test_paths_keep_to_the_length(seed):
    """All labels find the best path; a narrow search finds none longer or better."""
    grid, belief, model, options, best = problem(seed)
    assert found_by(grid, belief, model, options)[1] == pytest.approx(best, abs=1e-8)
    for width, planner in ((1, 'relaxed'), (2, 'beam'), (5, 'beam'), (16, 'beam')):
        own = replace(options, width=width, planner=planner)
        candidates = PathFinder(grid, own).candidates(Objective.of(belief, model, own))
        assert candidates
        for candidate in candidates:
            assert path_length(grid, candidate.path) <= options.max_distance * (1.0 + 1e-8)
            assert candidate.value <= best + 1e-8


@pytest.mark.slow
@for_each('seed', range(20), every=7)
def test_robots_of_a_team_keep_their_own_lengths(seed):
    rng = np.random.default_rng(seed)
    grid = Grid(7, 6, base=int(rng.integers(42)), resolution=0.5)
    belief = Belief(brute_force.random_joint(rng, grid.cells, grid.base))
    types = (RobotType(max_distance=2.5), RobotType(max_distance=0.0), RobotType())
    options = SearchOptions(max_steps=12, width=4, max_distance=5.0)
    for allocation in ('greedy', 'voronoi', 'independent'):
        team = plan_team(grid, belief, SensorModel(0.3), Team(3, allocation, types), options)
        short, free, common = (path_length(grid, planned.path) for planned in team)
        assert 0.0 < short <= 2.5 + 1e-8
        assert 0.0 < common <= 5.0 + 1e-8
        if allocation == 'independent':
            alone = plan(grid, belief, SensorModel(0.3), SearchOptions(max_steps=12, width=4))
            assert free == path_length(grid, alone.path)


def distances(grid):
    distance, queue = np.full(grid.cells, inf), [(0.0, grid.base)]
    while queue:
        length, cell = heappop(queue)
        if length < distance[cell]:
            distance[cell] = length
            for other in grid.neighbors(cell).tolist():
                heappush(queue, (length + step_length(grid, cell, other), other))
    return distance


@for_each('seed', range(40))
def test_distances_and_reach(seed):
    rng = np.random.default_rng(seed)
    width, height = (int(side) for side in rng.integers(1, 12, 2))
    blocked = np.flatnonzero(rng.random(width * height) < 0.3)
    blocked = blocked[blocked > 0]
    grid = Grid(
        width,
        height,
        resolution=float(rng.choice([1.0, 0.1, 3.7])),
        blocked=blocked.tolist(),
        connectivity=int(rng.choice([4, 8])),
        through_corners=bool(rng.integers(2)),
    )
    expected = distances(grid)
    np.testing.assert_allclose(grid.distance_to_base, expected, rtol=1e-9)
    limit = float(rng.uniform(0.0, 20.0)) * grid.resolution
    assert (grid.in_reach(9, 0.0) == grid.in_reach(9)).all()
    # A way with few steps and a short way may be two ways.
    assert not (grid.in_reach(9, limit) & ~(grid.in_reach(9) & (2.0 * expected <= limit))).any()


def visited_by_paths(grid, max_steps, limit):
    """Return the cells of all closed paths within both limits, by their lengths from the base."""
    ways = [{grid.base: {0.0}}]
    for _ in range(max_steps):
        onward = {}
        for cell, lengths in ways[-1].items():
            for other in grid.neighbors(cell).tolist():
                step = step_length(grid, cell, other)
                onward.setdefault(other, set()).update(round(each + step, 9) for each in lengths)
        ways.append(onward)
    return {
        cell
        for there, out in enumerate(ways)
        for cell, lengths in out.items()
        for back in ways[: max_steps - there + 1]
        if cell in back and min(lengths) + min(back[cell]) <= limit + 1e-6
    }


@pytest.mark.slow
@for_each('seed', range(200), every=4)
def test_reach_by_steps_and_distance_is_that_of_all_paths(seed):
    rng = np.random.default_rng(seed)
    width, height = (int(side) for side in rng.integers(5, 10, 2))
    blocked = np.flatnonzero(rng.random(width * height) < 0.25)
    grid = Grid(
        width,
        height,
        blocked=blocked[blocked > 0].tolist(),
        through_corners=bool(seed % 4),
    )
    steps, metres = grid.steps_to_base, grid.distance_to_base
    # Limits that just allow some cell, each by itself.
    for cell in rng.permutation(np.flatnonzero((metres > 0.0) & np.isfinite(metres)))[:6]:
        max_steps, limit = 2 * int(steps[cell]), 2.0 * float(metres[cell])
        found = np.flatnonzero(grid.in_reach(max_steps, limit)).tolist()
        assert set(found) == visited_by_paths(grid, max_steps, limit)


def test_a_distance_is_kept_to_the_rounding_of_its_sum():
    grid = Grid(9, 1, resolution=0.1)
    there_and_back = [0, 1, 2, 3, 2, 1, 0]
    assert grid.path_length(np.array(there_and_back)) == pytest.approx(0.6)
    # Three times 0.1 is more than 0.3.
    assert grid.in_reach(8, 0.6)[3]
    grid.check_path(there_and_back, 6, 0.6)
    with pytest.raises(ValueError, match=r'path is 0.6 m long: at most max_distance = 0.59 m'):
        grid.check_path(there_and_back, 6, 0.59)
    square = Grid(2, 2)
    assert square.path_length(np.array([0, 3, 3, 0])) == pytest.approx(2.0 * sqrt(2.0))


def test_cells_that_refused_plans_led_to_leave_some_within_the_distance():
    grid = Grid(9, 1)
    refused = [[[0, 1, 2, 1, 0]]]
    # Without these cells robots reach two of nine cells, and two of three within 4 m.
    assert keepout_cells(grid, 18, [None], refused).tolist() == []
    assert keepout_cells(grid, 18, [None], refused, 4.0).tolist() == [2, 3]


BELIEF = Belief.prior(Grid(3, 3), 0.2, 0.4, 0.8)


def test_a_distance_that_allows_no_step_is_refused_with_the_least():
    for grid, needed in (
        (Grid(3, 3), '2 m'),
        (Grid(3, 3, blocked=(1, 3)), '2.829 m'),
        (Grid(3, 3, resolution=0.1), '0.2 m'),
    ):
        least = float(needed.split()[0])
        options = SearchOptions(max_steps=6, max_distance=least)
        plan(grid, BELIEF, SensorModel(0.5), options)
        options = replace(options, max_distance=0.99 * least)
        for planner in ('beam', 'relaxed'):
            with pytest.raises(ValueError, match=f'no step .* it must be at least {needed}, or 0'):
                plan(grid, BELIEF, SensorModel(0.5), replace(options, planner=planner))
    # No number of steps allows it either.
    plan(Grid(3, 3), BELIEF, SensorModel(0.5), SearchOptions(max_steps=1, max_distance=0.5))
    with pytest.raises(ValueError, match='max_distance is 1.5 m, which allows no step'):
        plan_team(
            Grid(3, 3),
            BELIEF,
            SensorModel(0.5),
            Team(2, types=(RobotType(), RobotType(max_distance=1.5))),
            SearchOptions(max_steps=6),
        )
