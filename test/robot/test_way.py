# SPDX-License-Identifier: Apache-2.0
"""How a robot is driven, where it is, and the walk that it reports."""

from contextlib import suppress
from itertools import pairwise

from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import Grid
from kbnitp_ros.robot.way import (
    Itinerary,
    shortest_way,
    split_legs,
    steps_within,
    Walk,
    without_loops,
)
from kbnitp_ros.robot.whereabouts import Whereabouts
from laws import for_each
import numpy as np
import pytest

GRID = Grid(6, 5, base=7, resolution=0.5, origin=(-1.0, 2.0), blocked=[2, 9, 14, 15, 21])


def wander(data, grid, steps, start=None):
    way = [grid.base if start is None else start]
    for _ in range(steps):
        way.append(data.draw(st.sampled_from(grid.neighbors(way[-1]).tolist())))
    return way


def home(grid, way):
    return [*way, *shortest_way(grid, way[-1], grid.base)[1:]]


@given(data=st.data(), steps=st.integers(1, 20))
def test_legs_make_the_orders_and_none_closes_or_crosses_itself(data, steps):
    orders = home(GRID, wander(data, GRID, steps))
    legs = split_legs(orders)
    made = [orders[0]]
    for leg in legs:
        assert leg[0] == made[-1]
        made += leg[1:]
        assert len(set(leg)) == len(leg) or (len(leg) == 2 and leg[0] == leg[1])
    assert made == orders


def test_legs_of_a_path_there_and_back_and_round():
    assert split_legs([0, 1, 2, 1, 0]) == [(0, 1, 2), (2, 1, 0)]
    assert split_legs([0, 1, 7, 6, 0]) == [(0, 1, 7, 6), (6, 0)]
    assert split_legs([0, 0, 1, 1, 1, 0, 0]) == [(0, 0), (0, 1), (1, 1), (1, 1), (1, 0), (0, 0)]
    assert split_legs([0, 0]) == [(0, 0)]


@given(data=st.data(), steps=st.integers(0, 25))
def test_a_way_without_loops_goes_where_the_way_went(data, steps):
    way = wander(data, GRID, steps)
    cut = without_loops(reversed(way))
    assert cut[0] == way[-1]
    assert cut[-1] == GRID.base
    assert len(set(cut)) == len(cut)
    assert set(cut) <= set(way)
    assert all(after in GRID.neighbors(before) for before, after in pairwise(cut))


@given(data=st.data(), steps=st.integers(0, 40), most=st.integers(1, 45))
def test_a_long_walk_is_reported_as_a_shorter_true_walk(data, steps, most):
    cells = home(GRID, wander(data, GRID, steps))
    told = steps_within(cells, most)
    if len(cells) - 1 <= most:
        assert told == list(range(1, len(cells)))
        return
    assert len(told) <= most
    assert all(before < after for before, after in pairwise(told))
    walk = [GRID.base, *(cells[number] for number in told)]
    # Each step starts at its true cell, and the last one ends at the base.
    assert [cells[number - 1] for number in told] == walk[:-1]
    assert walk[-1] == GRID.base
    # As many as possible: no walk of more first steps has a later way home.
    first = sum(number == place for place, number in enumerate(told, 1))
    for further in range(first + 1, most + 1):
        assert further + shortest_of_later_steps(cells, further) > most


def shortest_of_later_steps(cells, start):
    """Return the number of steps of the last ways out of the cells until home."""
    steps, cell = 0, cells[start]
    while cell != GRID.base:
        last = max(number for number, each in enumerate(cells) if each == cell)
        cell, steps = cells[last + 1], steps + 1
    return steps


def test_the_shortest_way_is_as_long_as_the_grid_says():
    for cell in np.flatnonzero(GRID.free).tolist():
        way = shortest_way(GRID, cell, GRID.base)
        assert len(way) - 1 == GRID.steps_to_base[cell]
    with pytest.raises(ValueError, match='no way leads'):
        shortest_way(GRID, 0, 9)


@given(data=st.data(), steps=st.integers(1, 30), connectivity=st.sampled_from([4, 8]))
@settings(max_examples=100 if FULL else 30)
def test_any_positions_make_a_walk(data, steps, connectivity):
    grid = Grid(
        6, 5, base=7, resolution=0.5, origin=(-1.0, 2.0), blocked=[2, 9], connectivity=connectivity
    )
    walk = Walk(grid, grid.base, patience=1.0)
    cells = [grid.base]
    for time in range(steps):
        x, y = data.draw(st.tuples(st.floats(-3, 4), st.floats(0, 6)))
        with suppress(ValueError):
            cells += walk.follow(x, y, float(time))
        assert cells[-1] == walk.cell
    grid.check_path([*home(grid, cells), grid.base])


@given(data=st.data(), steps=st.integers(0, 12), noise=st.floats(0, 0.045))
@settings(max_examples=100 if FULL else 30)
def test_a_robot_on_its_orders_walks_them(data, steps, noise):
    """Positions on straight lines between centres of cells, with noise."""
    orders = home(GRID, wander(data, GRID, steps))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    walk, cells = Walk(GRID, GRID.base, patience=1.0), [GRID.base]
    centers = GRID.centers(orders)
    for number, (start, end) in enumerate(pairwise(centers)):
        for part in np.linspace(0, 1, 21):
            x, y = start + part * (end - start) + rng.uniform(-noise, noise, 2)
            cells += walk.follow(x, y, number + part)
    moves = [cell for before, cell in zip([None, *orders], orders) if cell != before]
    assert cells == moves


def test_a_jump_counts_when_it_lasts():
    walk = Walk(Grid(9, 9), 0, patience=2.0)
    with pytest.raises(ValueError, match='jumped from cell 0 to cell 40'):
        walk.follow(4.5, 4.5, 0.0)
    assert walk.follow(0.6, 0.5, 1.0) == []
    for time in (2.0, 3.9):
        with pytest.raises(ValueError, match='jumped'):
            walk.follow(4.5, 4.5, time)
    assert walk.follow(4.5, 4.5, 4.0) == [10, 20, 30, 40]
    with pytest.raises(ValueError, match='outside the grid'):
        walk.follow(-1.0, 4.5, 5.0)
    assert walk.cell == 40


def test_along_an_edge_a_robot_stays_in_its_cell_until_it_has_come_to_rest():
    walk = Walk(Grid(9, 9), 0, patience=2.0)
    for time in range(20):
        assert walk.follow(1.0 + 0.19 * (-1) ** time, 0.5, time) == []
    assert walk.follow(1.21, 0.5, 20) == [1]
    assert walk.settle(0.99, 0.5) == [0]


def test_a_leg_is_tried_again_from_where_the_robot_is_then_it_goes_home_as_it_came():
    grid = Grid(9, 9)
    itinerary = Itinerary(grid, [0, 1, 2, 3, 12, 11, 10, 0], attempts=2)
    walk = [0]

    def enter(cell):
        walk.append(cell)
        itinerary.enter(cell)

    assert itinerary.next_leg(walk) == (0, 1, 2, 3, 12, 11, 10)
    enter(1)
    itinerary.fail()
    assert itinerary.next_leg(walk) == (1, 2, 3, 12, 11, 10)
    # From beside its path the robot heads for the same cells; progress resets the attempts.
    enter(10)
    enter(2)
    itinerary.fail()
    assert not itinerary.heads_home
    assert itinerary.next_leg(walk) == (2, 3, 12, 11, 10)
    itinerary.fail()
    assert itinerary.heads_home
    assert itinerary.destination == 0
    assert itinerary.next_leg(walk) == (2, 10, 1, 0)
    for number in range(6):
        itinerary.fail()
        # The shortest way and the way it came, in turns.
        expected = [(2, 10, 1, 0), (2, 1, 0)][(number + 1) // 2 % 2]
        assert itinerary.next_leg(walk) == expected


def test_stays_and_legs_follow_each_other_until_the_robot_goes_home():
    itinerary = Itinerary(Grid(9, 9), [0, 1, 1, 0], attempts=1)
    legs = []
    walk = [0]
    while not itinerary.heads_home:
        leg = itinerary.next_leg(walk)
        legs.append((leg, itinerary.is_stay))
        for cell in leg[1:]:
            walk.append(cell)
            itinerary.enter(cell)
        itinerary.succeed()
    assert legs == [((0, 1), False), ((1, 1), True), ((1, 0), False)]
    assert itinerary.next_leg(walk) == (0,)


WALKED = Grid(20, 20)
PATIENCE, TICK = 0.35, 0.1


@for_each('seed', range(20))
def test_a_walk_in_a_turned_field_is_the_same(seed):
    rng = np.random.default_rng(seed)
    yaw, corner = rng.uniform(-np.pi, np.pi), complex(*rng.uniform(-50, 50, 2))
    steps = rng.uniform(-0.4, 0.4, (200, 2))
    places = np.clip(10.5 + steps.cumsum(axis=0), 0.1, 19.9)
    moved = corner + np.exp(1j * yaw) * (places @ (1, 1j))
    turned = Grid(20, 20, origin=(corner.real, corner.imag), yaw=yaw)
    walks = [Walk(grid, 210, PATIENCE) for grid in (WALKED, turned)]
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


times = st.integers(0, 60)


@given(
    st.lists(st.tuples(st.integers(1, 9), st.integers(0, 2)), min_size=1),
    st.integers(1, 9),
    times,
    times,
)
def test_a_time_is_in_a_step_if_the_robot_was_seen_there_before_after_and_often(
    sights, gap, one, other
):
    since, until = sorted((one, other))
    whereabouts = Whereabouts(10**9, gap)
    time, seen = 0, []
    for later, step in sights:
        time += later
        seen.append((time, step))
        whereabouts.note(time, step)
    first = max((number for number, (at, _) in enumerate(seen) if at <= since), default=None)
    after = min((number for number, (at, _) in enumerate(seen, 1) if at >= until), default=None)
    expected = None if after is None else 0
    if first is not None and after is not None:
        between = seen[first:after]
        is_one = len({step for _, step in between}) == 1
        if is_one and all(b - a <= gap for (a, _), (b, _) in pairwise(between)):
            expected = between[0][1]
    assert whereabouts.step_within(since, until) == expected


def test_old_positions_are_forgotten():
    whereabouts = Whereabouts(10, 10)
    for time in range(100):
        whereabouts.note(time, 1 + time // 4)
    assert whereabouts.step_within(95, 95) == 24
    assert whereabouts.step_within(50, 50) == 0


def test_a_clock_that_is_set_back_does_not_mix_two_times():
    whereabouts = Whereabouts(1000, 1000)
    whereabouts.note(500, 1)
    whereabouts.note(520, 1)
    whereabouts.note(100, 2)
    whereabouts.note(120, 2)
    assert whereabouts.step_within(110, 110) == 2
    assert whereabouts.step_within(50, 50) == 0
