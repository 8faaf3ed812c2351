# SPDX-License-Identifier: Apache-2.0
"""The label search: what its numbers mean, what it costs, and the same bits on every way."""

import itertools
import os
from pathlib import Path
import subprocess
import sys

import brute_force
from kbnitp_ros.core import (
    Belief,
    Grid,
    path_information,
    PathFinder,
    plan,
    SearchOptions,
    SensorModel,
)
from kbnitp_ros.core.planning.objective.moments import ERROR, EXPONENTS, WEIGHTS
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.search import labels, planners
from kbnitp_ros.core.planning.search.improvement_kernels import improve, Seen, take
from kbnitp_ros.core.planning.search.label_kernels import label_value, new_products
from laws import for_each
import numpy as np
import pytest
from rounds import plan_round

# Seeds, and what a path may have: steps, visits to a cell, and metres.
LASSO_CASES = [
    (0, 3, 9, 0.0),
    (1, 5, 9, 0.0),
    (2, 6, 9, 0.0),
    (3, 6, 2, 0.0),
    (4, 6, 3, 0.0),
    (5, 6, 9, 5.0),
    (6, 6, 2, 4.0),
]

PLANS = """
import sys
{before}
import numpy as np
import brute_force
from kbnitp_ros.core import (
    ALLOCATIONS, Belief, Grid, plan, plan_team, SearchOptions, SensorModel, Team
)

for seed, lethality in enumerate((0.0, 0.5, 1.0)):
    grid = Grid(4, 3, base=5, blocked=(7,))
    rng = np.random.default_rng(seed)
    belief, model = Belief(brute_force.random_joint(rng, 12, 5)), SensorModel(lethality)
    for planner, width in (('relaxed', 1), ('beam', 4)):
        found = plan(grid, belief, model, 5, planner, width=width)
        print(found.path.tolist(), found.information.hex(), found.survival.hex())
for allocation in ('greedy', 'voronoi'):
    options = SearchOptions(max_steps=4, width=3, loss_cost=0.2)
    team = plan_team(grid, belief, model, Team(3, allocation), options)
    print([planned.path.tolist() for planned in team.plans], team.information.hex())
print('numba' in sys.modules and sys.modules['numba'] is not None, file=sys.stderr)
"""


def plans(before='', **environment):
    """Return what a process of its own prints of its plans, and whether it has numba."""
    done = subprocess.run(
        [sys.executable, '-W', 'ignore', '-c', PLANS.format(before=before)],
        env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    # Before it, a compilation may be told of.
    return done.stdout, done.stderr.splitlines()[-1] == 'True'


@pytest.mark.processes
def test_plans_have_the_same_bits_compiled_and_interpreted_with_one_thread_and_many():
    printed, has_numba = plans(NUMBA_NUM_THREADS='2', OMP_NUM_THREADS='2')
    assert has_numba
    assert len(printed.splitlines()) == 8
    assert plans(NUMBA_NUM_THREADS='1', OMP_NUM_THREADS='1') == (printed, True)
    assert plans(NUMBA_DISABLE_JIT='1') == (printed, True)
    # A module that is None in sys.modules cannot be imported.
    assert plans("sys.modules['numba'] = None") == (printed, False)


@for_each('seed', range(60))
def test_labels_are_worth_what_their_paths_are(seed):
    """By moments but for what these miss, and ranked at the base by the exact information."""
    rng = np.random.default_rng(seed)
    grid = Grid(4, 3, base=5)
    belief = Belief(brute_force.random_joint(rng, 12, 5))
    model = SensorModel(**brute_force.random_sensors(rng))
    options = SearchOptions('relaxed', max_steps=8, max_visits=8)
    search = labels.LabelSearch(grid, Objective.alone(grid, belief, model, options), options, 1)
    rank = np.argsort(search.reach.cells)
    products = new_products(1, search.problem.gains)
    visits = np.empty(12, dtype=np.int64)
    for _ in range(10):
        path = brute_force.random_path(rng, 4, 3, 5, int(rng.integers(1, 9)))
        information = path_information(belief, model, path)
        assert search.exact([rank[path]])[0] == pytest.approx(information, abs=2e-9)
        take(rank[path], search.problem.gains, visits, products)
        value = label_value(products, 0, search.problem.objective._replace(units=1e15)) / 1e15
        missed = missed_by_moments(belief, model, path)
        assert abs(missed) <= ERROR
        assert value == pytest.approx(information + missed, abs=1e-11)
        assert visits.sum() == len(path) - 1


def missed_by_moments(belief, model, path):
    """Return how far the sum of powers is off the mean of -(1 - p) ln(1 - p), nats."""
    cells, visits = np.unique(path[1:], return_counts=True)
    states = np.array(list(itertools.product((0, 1), repeat=cells.size)))
    hazard = belief.hazard[cells]
    weight = np.where(states, hazard, 1.0 - hazard).prod(axis=1)
    survival = np.array(brute_force.step_survival(model))[states]
    p = (survival**visits).prod(axis=1)
    lost = 1.0 - p
    exact = -lost * np.log(lost, where=lost > 0.0, out=np.zeros_like(lost))
    return weight @ (exact - p[:, None] ** EXPONENTS @ WEIGHTS)


@for_each('seed, max_steps, max_visits, max_distance', LASSO_CASES)
def test_the_best_lassos_are_found(monkeypatch, seed, max_steps, max_visits, max_distance):
    """Of all paths out, around a loop and back the way out; where all labels are kept."""
    monkeypatch.setattr(labels, 'STEMS', 500)
    rng = np.random.default_rng(seed)
    grid = Grid(3, 3, base=seed % 9, connectivity=(4, 8)[seed % 2])
    belief = Belief(brute_force.random_joint(rng, 9, grid.base))
    model = SensorModel(**brute_force.random_sensors(rng))
    options = SearchOptions(max_steps=max_steps, max_visits=max_visits, max_distance=max_distance)
    objective = Objective.alone(grid, belief, model, options)
    search = labels.LabelSearch(grid, objective, options, 2000)
    rank = np.zeros(9, dtype=np.intp)
    rank[search.reach.cells] = np.arange(search.reach.cells.size)
    values = {}
    for path in lassos(grid, max_steps):
        is_short = not max_distance or grid.path_length(path) <= max_distance
        if is_short and np.bincount(path[1:]).max() <= max_visits:
            values[tuple(path)] = search.exact([rank[path]])[0]
    found = [values[tuple(search.reach.cells[path])] for path in search.lassos()]
    assert max(found) == pytest.approx(max(values.values()), abs=2 * ERROR)


def lassos(grid, max_steps):
    """Yield all lassos; their stems have one step at least."""

    def walks(walk, steps):
        yield walk
        if steps:
            for cell in grid.neighbors(walk[-1]).tolist():
                yield from walks([*walk, cell], steps - 1)

    for stem in walks([grid.base], (max_steps - 1) // 2):
        if len(stem) == 1 or grid.base in stem[1:]:
            continue
        for loop in walks(stem[-1:], max_steps - 2 * (len(stem) - 1)):
            if len(loop) > 1 and loop[-1] == stem[-1] and stem[-1] not in loop[1:-1]:
                yield np.array([*stem, *loop[1:], *stem[-2::-1]])


@pytest.mark.slow
@for_each('seed, ways, by_labels', itertools.product(range(20), (1, 2), (False, True)))
def test_an_improved_path_is_better_than_all_around_it(seed, ways, by_labels):
    """
    With one stretch replaced, on one way or on both ways of a stem, and as long as allowed.

    Of two cells in a row a label for each is all that may be the best.
    """
    rng = np.random.default_rng(seed)
    grid = Grid(3, 3, base=seed % 9, connectivity=(4, 8)[seed // 2 % 2])
    belief = Belief(brute_force.random_joint(rng, 9, grid.base))
    model = SensorModel(**brute_force.random_sensors(rng))
    options = SearchOptions(
        max_steps=8, max_visits=(2, 4, 4)[seed % 3], max_distance=(0.0, 8.5)[seed % 2]
    )
    search = labels.LabelSearch(grid, Objective.alone(grid, belief, model, options), options, 2)
    rank = np.zeros(9, dtype=np.intp)
    rank[search.reach.cells] = np.arange(search.reach.cells.size)

    near = [set(grid.neighbors(cell).tolist()) for cell in range(9)]

    def is_allowed(path):
        steps = len(path) - 1
        return (
            steps <= options.max_steps
            and all(b in near[a] for a, b in itertools.pairwise(path))
            and np.bincount(path[1:]).max() <= options.max_visits
            and (not options.max_distance or grid.path_length(path) <= options.max_distance)
        )

    starts = [each for each in lassos(grid, 6) if is_allowed(each)]
    for before in (starts[k] for k in rng.integers(len(starts), size=5)):
        room = np.zeros(options.max_steps + 1, dtype=np.intp)
        room[: before.size] = rank[before]
        seen = Seen(np.zeros(100, np.int64), np.zeros(1, np.int64))
        steps, is_new = improve(search.problem, room, before.size - 1, 2, ways, by_labels, seen)
        assert is_new
        best = search.exact([room[: steps + 1]])[0]
        assert best >= search.exact([rank[before]])[0] - 2 * ERROR
        improved = search.reach.cells[room[: steps + 1]].tolist()
        assert is_allowed(improved)
        around_it = filter(is_allowed, around(improved, 2, ways, by_labels))
        assert max(search.exact([rank[each] for each in around_it])) <= best + 2 * ERROR


def around(path, most, ways, is_long):
    """
    Yield a path with each stretch of so few cells replaced, whether or not the others fit.

    If `is_long`, these are the longest from each place.
    """
    steps = end = len(path) - 1
    if ways == 2:
        # Up to the cell after those on which the way back is the way out.
        same = itertools.takewhile(lambda k: path[k] == path[steps - k], range(1, steps // 2 + 1))
        end = min(len([*same]) + 1, steps // 2)
    for first in range(end):
        longest = min(first + most + 1, end)
        for last in range(longest if is_long else first + 1, longest + 1):
            for count in range(most + 1):
                for cells in itertools.product(range(9), repeat=count):
                    out = [*path[: first + 1], *cells]
                    stop = steps - last + 1
                    yield (
                        [*out, *path[last:stop], *out[::-1]] if ways == 2 else [*out, *path[last:]]
                    )


def test_a_plan_is_the_same_in_a_larger_field():
    """What is out of reach changes nothing, and nothing is searched there."""
    rng = np.random.default_rng(1)
    small, large = Grid(13, 13, base=84), Grid(40, 50, base=25 * 40 + 20)
    inside = (np.arange(19, 32)[:, None] * 40 + np.arange(14, 27)).ravel()
    joint = brute_force.random_joint(rng, 169, 84)
    wide = brute_force.random_joint(rng, 2000, large.base)
    wide[inside] = joint
    near = plan(small, Belief(joint), SensorModel(0.5), 12)
    far = plan(large, Belief(wide), SensorModel(0.5), 12)
    assert far.path.tolist() == inside[near.path].tolist()
    assert far.information == near.information


@for_each(
    'size, arguments',
    [
        (600, {'max_steps': 1200}),
        (100, {'max_steps': 200, 'width': 4096}),
        (300, {'max_steps': 600, 'max_visits': 600}),
        (9, {'max_steps': 10_000, 'max_visits': 10_000}),
    ],
)
def test_what_takes_too_much_memory_is_refused_with_an_estimate(size, arguments):
    grid = Grid(size, size)
    belief, steps = Belief.prior(grid, 0.3, 0.4, 0.8), arguments['max_steps']
    with pytest.raises(ValueError, match=rf'max_steps = {steps}.*width.*max_visits.* GB.*lower'):
        plan(grid, belief, SensorModel(0.5), **arguments)


@pytest.mark.slow
@for_each(
    'planner, side, max_steps, width, max_visits, robots',
    [
        ('beam', 600, 1200, 16, 3, 1),
        ('relaxed', 1000, 2000, 16, 3, 1),
        ('beam', 9, 10_000, 16, 10_000, 1),
        ('beam', 100, 200, 16, 3, 2000),
    ],
)
def test_memory_can_be_asked_for_before_there_is_a_belief(
    planner, side, max_steps, width, max_visits, robots
):
    finder = PathFinder(Grid(side, side), SearchOptions(planner, max_steps, width, max_visits))
    with pytest.raises(ValueError, match=f'max_steps = {max_steps}.* GB'):
        finder.check_memory(robots)


@for_each(
    'planner, side, max_steps, width, max_visits, robots',
    [
        ('beam', 9, 18, 10_000, 10_000, 1),
        ('beam', 9, 1000, 16, 3, 81),
        ('beam', 1000, 60, 16, 3, 100),
        ('relaxed', 300, 600, 10_000, 3, 1),
    ],
)
def test_what_is_allowed_needs_no_more_memory_than_there_may_be(
    planner, side, max_steps, width, max_visits, robots
):
    PathFinder(
        Grid(side, side), SearchOptions(planner, max_steps, width, max_visits)
    ).check_memory(robots)


@for_each('allocation', ['independent', 'voronoi', 'greedy'])
def test_a_search_asks_for_no_more_than_was_asked_for_before(monkeypatch, allocation):
    """Whatever became of the robots before: a mission that has begun is not refused later."""
    grid, model, robots = Grid(5, 5), SensorModel(0.5), 7
    belief = Belief.prior(grid, 0.3, 0.4, 0.8)
    finder = PathFinder(grid, SearchOptions('beam', 10, 4, 3))
    asked = []
    check = labels.check_memory

    def spy(reach, options, width, outcomes, earlier, further, powers):
        asked.append((options.max_steps, width, outcomes, earlier, further, powers))
        check(reach, options, width, outcomes, earlier, further, powers)

    monkeypatch.setattr(labels, 'check_memory', spy)
    monkeypatch.setattr(planners, 'check_memory', spy)
    finder.check_memory(robots)
    plan_round(grid, belief, model, 10, robots, allocation, width=4)
    most, *later = asked
    assert later
    assert all(np.all(np.array(sizes) <= most) for sizes in later)


@pytest.mark.slow
def test_the_best_of_a_wide_search_is_found():
    """On beliefs of a mission: most is known near the base, and little beyond."""
    grid = Grid(9, 9)
    near = np.clip(1.3 - grid.steps_to_base / 6, 0.02, 1.0)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        known = rng.random(81) < near
        hazard = np.where(known, np.where(rng.random(81) < 0.15, 0.8, 0.1), 0.5)
        target = np.where(known, np.where(rng.random(81) < 0.2, 0.9, 0.04), 0.45)
        hazard[0] = 0.0
        belief, model = Belief.from_maps(hazard, target, target), SensorModel(0.3)
        found, best = (plan(grid, belief, model, 18, width=w).information for w in (16, 128))
        assert found >= 0.99 * best


def test_the_best_of_a_wide_search_is_found_late_in_missions():
    """
    On beliefs of which simpler searches find 0.963 to 0.9989 of what width 512 finds.

    Those had no lassos, or replaced no stretches by label searches. The beliefs are of missions on
    9x9 cells at some lethality; `best` is what width 512 found.
    """
    late = np.load(Path(__file__).with_name('beliefs_of_missions.npz'))
    for joint, lethality, best in zip(late['joint'], late['lethality'], late['best']):
        found = plan(Grid(9, 9), Belief(joint), SensorModel(lethality), 18, width=16)
        assert found.information >= 0.999 * best
