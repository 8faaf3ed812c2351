# SPDX-License-Identifier: Apache-2.0
"""Plans after refusals, and planners without an objective."""

from itertools import pairwise, product

from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import Belief, Grid, ORDINARY, plan, SearchOptions, SensorModel
from kbnitp_ros.core.planning.labels import find_reach
from kbnitp_ros.core.planning.planners import count_visits, random_walk
from kbnitp_ros.core.planning.regions import keepout_cells, nested_regions, without
from laws import for_each
import numpy as np
import pytest
from rounds import plan_round

GRID = Grid(9, 9)
MODEL = SensorModel(0.5)
# A belief on which robots go far, and one on which they stay near the base.
FAR, NEAR = Belief.prior(GRID, 0.1, 0.45, 0.8), Belief.prior(GRID, 0.5, 0.45, 0.8)


def test_a_region_is_the_far_half_of_a_path_or_a_part_of_it():
    # On a line of nine cells, to the seventh and back.
    line = Grid(9, 1)
    regions = [[4, 5, 6, 7], [4, 5, 6], [5, 6, 7], [6]]
    there = [0, 1, 2, 3, 4, 5, 6]
    assert [each.tolist() for each in nested_regions(line, [*there, *there[-2::-1]])] == regions
    # A path that stays at the base has no region.
    assert [each.tolist() for each in nested_regions(line, [0, 0])] == [[], [], [1], []]


@settings(deadline=None, max_examples=50)
@given(st.data())
def test_the_near_half_stays_open(data):
    blocked = data.draw(st.sets(st.integers(1, 24), max_size=6))
    grid = Grid(5, 5, blocked=tuple(blocked))
    cells = [0]
    for _ in range(data.draw(st.integers(1, 6))):
        cells.append(int(data.draw(st.sampled_from(sorted(grid.neighbors(cells[-1]))))))
    steps = grid.steps_to_base
    farthest = steps[cells].max()
    regions = [set(each.tolist()) for each in nested_regions(grid, [*cells, *cells[-2::-1]])]
    assert all(2 * steps[cell] > farthest for region in regions for cell in region)
    whole, half, end, cell = regions
    assert half == {each for each in cells if each and 2 * steps[each] > farthest}
    assert whole >= half >= cell
    assert whole >= end >= cell or not farthest
    assert {steps[each] for each in cell} <= {farthest}


def plans(refused, prior=FAR, agents=1, **options):
    cells = keepout_cells(GRID, 18, [None] * agents, refused)
    return plan_round(GRID, prior, MODEL, 18, agents, keepout=cells, **options), cells


@for_each('allocation, prior', product(['greedy', 'voronoi', 'independent'], [FAR, NEAR]))
def test_the_plan_after_a_refusal_is_of_another_region_and_hardly_better(prior, allocation):
    refused, best = [], np.inf
    for number in range(3):
        (plan,), cells = plans(refused, prior, allocation=allocation)
        assert bool(number) == bool(len(cells))
        assert not set(cells) & set(plan.path.tolist())
        assert 0.0 < plan.information <= 1.02 * best
        best = plan.information if not number else best
        refused.append([plan.path])
    paths = [paths[0].tolist() for paths in refused]
    assert paths[0] != paths[1] != paths[2]


def test_robots_in_flight_may_be_in_refused_regions():
    (first,), _ = plans([])
    (other,), cells = plans([[first.path]], in_flight=[(first.path, ORDINARY)])
    assert not set(cells) & set(other.path.tolist())


def test_when_all_regions_are_refused_the_earlier_ones_are_forgotten():
    refused = []
    for _ in range(30):
        (plan,), cells = plans(refused)
        assert without(GRID, cells).in_reach(18).sum() > 1
        refused.append([plan.path])
    assert len({tuple(path.tolist()) for (path,) in refused}) < len(refused)


def test_each_robot_of_a_round_has_a_cell_to_go_to():
    grid = Grid(2, 2)
    paths = [[0, 1, 0], [0, 2, 0], [0, 3, 0]]
    assert keepout_cells(grid, 4, [None] * 3, [paths]).tolist() == []
    assert keepout_cells(grid, 4, [None], [paths[:1]]).tolist() == [1]


@for_each('size, max_steps', [(5, 8), (7, 10), (8, 12)])
def test_a_round_is_not_proposed_twice_in_a_row(size, max_steps):
    grid = Grid(size, size)
    prior, refused = Belief.prior(grid, 0.1, 0.45, 0.8), []
    for _ in range(4):
        cells = keepout_cells(grid, max_steps, [None] * 2, refused)
        team = plan_round(grid, prior, MODEL, max_steps, 2, keepout=cells)
        refused.append([plan.path for plan in team])
    ways = [[path.tolist() for path in paths] for paths in refused]
    assert all(one != other for one, other in pairwise(ways))


# Planners without an information objective: distributions and values.


TOURS = ('coverage', 'shortest_unvisited')
WALLED = Grid(6, 5, base=7, blocked=(8, 14, 20, 26))


def prior(grid):
    return Belief.prior(grid, 0.2, 0.3, 0.5)


def sent(grid, planner, robots, max_steps, max_visits=3):
    """Return the paths of robots that leave one after another."""
    paths = []
    for _ in range(robots):
        options = SearchOptions(planner, max_steps, max_visits=max_visits)
        found = plan(grid, prior(grid), MODEL, options, visited=count_visits(grid, paths))
        paths.append(grid.check_path(found.path, max_steps))
    return paths


def test_random_walks_are_uniform():
    """All closed walks of four steps on 3x2 cells with an obstacle, against enumeration."""
    grid = Grid(3, 2, base=1, blocked=(5,))
    walks = [
        walk
        for walk in product(range(grid.cells), repeat=3)
        if all(b in grid.neighbors(a) for a, b in pairwise((1, *walk, 1)))
    ]
    rng = np.random.default_rng(1)
    reach, draws = find_reach(grid, 4), 100 * len(walks)
    drawn = [tuple(random_walk(reach, 4, rng)[1:-1].tolist()) for _ in range(draws)]
    counts = np.array([drawn.count(walk) for walk in walks])
    assert counts.sum() == draws
    # Chi-square has its degrees of freedom as mean and twice that as variance.
    freedom = len(walks) - 1
    assert ((counts - 100) ** 2 / 100).sum() < freedom + 4 * np.sqrt(2 * freedom)


@for_each('max_visits', [1, 2])
def test_random_walks_enter_no_cell_too_often(max_visits):
    reach = find_reach(WALLED, 12)
    rng = np.random.default_rng(2)
    for _ in range(20):
        walk = WALLED.check_path(random_walk(reach, max_visits, rng), 12)
        assert np.bincount(walk[1:]).max() <= max_visits


def test_where_only_the_base_is_free_a_robot_stays_there():
    grid = Grid(2, 2, blocked=(1, 2, 3))
    for planner in ('random', *TOURS):
        found = plan(grid, prior(grid), MODEL, SearchOptions(planner, 5, max_visits=1))
        assert found.path.tolist() == [0, 0]


def test_the_random_planner_draws_the_same_for_the_same_belief_and_visits():
    grid = Grid(9, 9)
    paths = {tuple(path.tolist()) for path in sent(grid, 'random', 5, 18)}
    assert len(paths) == 5
    assert paths == {tuple(path.tolist()) for path in sent(grid, 'random', 5, 18)}


@pytest.mark.slow
@for_each(
    'planner, max_visits, grid',
    product(TOURS, [1, 3], [Grid(7, 7), Grid(9, 4, base=20, connectivity=4), WALLED]),
)
def test_tours_enter_every_cell_in_reach_before_they_start_over(grid, planner, max_visits):
    paths = sent(grid, planner, 40, 14, max_visits)
    for path in paths:
        assert np.bincount(path[1:]).max() <= max_visits
    reach = grid.in_reach(14) & (np.arange(grid.cells) != grid.base)
    if max_visits == 1:
        # The only way back may be the way there.
        reach &= [any(cell in path for path in paths) for cell in range(grid.cells)]
        assert reach.sum() > 5
    first = next(n for n in range(41) if count_visits(grid, paths[:n])[reach].all())
    # While cells are new, each tour reaches one.
    for number in range(first):
        seen = count_visits(grid, paths[:number])
        assert (seen[paths[number]] == 0).any()


def test_coverage_goes_row_by_row():
    grid = Grid(4, 3)
    assert plan(grid, prior(grid), MODEL, SearchOptions('coverage', 20)).path.tolist()[:12] == [
        *(0, 1, 2, 3),
        *(7, 6, 5, 4),
        *(8, 9, 10, 11),
    ]


def test_the_nearest_cell_comes_next():
    """On an open field with the base in a corner a path is as long as its longer side."""
    grid = Grid(5, 5)
    (path,) = sent(grid, 'shortest_unvisited', 1, 16)
    row, col = np.divmod(np.arange(25), 5)
    steps = np.maximum(abs(row[:, None] - row), abs(col[:, None] - col))
    here, made, new = 0, 0, set(range(1, 25))
    while near := [cell for cell in new if made + steps[here, cell] + steps[cell, 0] <= 16]:
        target = min(near, key=lambda cell: (steps[here, cell], cell))
        made += steps[here, target]
        new -= set(path[: made + 1].tolist())
        assert path[made] == target
        here = target
    assert made + steps[here, 0] == path.size - 1


@for_each('planner', TOURS)
def test_robots_of_a_round_continue_the_same_tour(planner):
    grid = Grid(7, 7)
    team = plan_round(grid, prior(grid), MODEL, 14, 3, 'greedy', planner)
    alone = sent(grid, planner, 3, 14)
    assert [planned.path.tolist() for planned in team] == [path.tolist() for path in alone]


@pytest.mark.slow
def test_walks_beyond_memory_are_refused():
    grid = Grid(1000, 1000)
    with pytest.raises(ValueError, match=r'max_steps = 1000 take about .* GB, and 1.1 GB'):
        plan(grid, prior(grid), MODEL, SearchOptions('random', 1000))


@for_each('planner', ['coverage', 'shortest_unvisited'])
def test_a_tour_with_more_steps_than_cells_ends(planner):
    """A cell at its visit limit is not taken for the farthest cell."""
    grid = Grid(3, 2, base=0, blocked=(4,))
    belief = Belief.prior(grid, 0.3, 0.4, 0.8)
    path = plan(grid, belief, SensorModel(0.5), SearchOptions(planner, 12, max_visits=1)).path
    assert grid.check_path(path, 12) is not None
