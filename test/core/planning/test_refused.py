# SPDX-License-Identifier: Apache-2.0
"""What robots keep off when plans are refused."""

from itertools import pairwise, product

from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import Belief, Grid, ORDINARY, SensorModel
from kbnitp_ros.core.planning.regions import keepout_cells, regions_of, without
from laws import for_each
import numpy as np
from rounds import plan_round

GRID = Grid(9, 9)
MODEL = SensorModel(0.5)
# One on which robots go far, and one on which they stay near the base.
FAR, NEAR = Belief.prior(GRID, 0.1, 0.45, 0.8), Belief.prior(GRID, 0.5, 0.45, 0.8)


def test_a_region_is_the_far_half_of_a_path_or_a_part_of_it():
    # On a line of nine cells, to the seventh and back.
    line = Grid(9, 1)
    regions = [[4, 5, 6, 7], [4, 5, 6], [5, 6, 7], [6]]
    there = [0, 1, 2, 3, 4, 5, 6]
    assert [each.tolist() for each in regions_of(line, [*there, *there[-2::-1]])] == regions
    # A robot that stays at the base is sent nowhere.
    assert [each.tolist() for each in regions_of(line, [0, 0])] == [[], [], [1], []]


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
    regions = [set(each.tolist()) for each in regions_of(grid, [*cells, *cells[-2::-1]])]
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
def test_what_is_planned_instead_is_of_another_region_and_no_better(prior, allocation):
    refused, best = [], np.inf
    for number in range(3):
        (plan,), cells = plans(refused, prior, allocation=allocation)
        assert bool(number) == bool(len(cells))
        assert not set(cells) & set(plan.path.tolist())
        assert 0.0 < plan.information <= best + 1e-9
        best = plan.information if not number else best
        refused.append([plan.path])
    paths = [paths[0].tolist() for paths in refused]
    assert paths[0] != paths[1] != paths[2]


def test_robots_that_are_out_may_be_where_others_keep_off():
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
