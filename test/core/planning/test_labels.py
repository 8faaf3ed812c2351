# SPDX-License-Identifier: Apache-2.0
"""The search against all closed paths of small fields; values of labels and moments."""

from contextlib import nullcontext
from dataclasses import replace
import itertools
import os
import subprocess
import sys

import brute_force
from extent import FULL
from kbnitp_ros.core import (
    Belief,
    Grid,
    ORDINARY,
    path_information,
    PathFinder,
    plan,
    run_mission,
    SearchOptions,
    SensorModel,
    World,
)
from kbnitp_ros.core.planning import labels
from kbnitp_ros.core.planning.information_kernels import take
from kbnitp_ros.core.planning.label_kernels import hoped_value, label_value, new_labels
from kbnitp_ros.core.planning.objective import (
    after_deployment,
    ERROR,
    EXPONENTS,
    nobody_deployed,
    Objective,
    WEIGHTS,
)
from kbnitp_ros.core.planning.plans import check_team
from laws import for_each
import numpy as np
import pytest

# Plans without numba take seconds.
LETHALITIES = (0.0, 0.5, 1.0) if FULL else (0.5,)

PLANS = """
import sys
{before}
import numpy as np
import brute_force
from kbnitp_ros.core import (
    ALLOCATIONS, Belief, Grid, plan, plan_team, SearchOptions, SensorModel, Team
)

for seed, lethality in enumerate({lethalities}):
    grid = Grid(4, 3, base=5, blocked=(7,))
    rng = np.random.default_rng(seed)
    belief, model = Belief(brute_force.random_joint(rng, 12, 5)), SensorModel(lethality)
    for planner, width in (('relaxed', 1), ('beam', 4)):
        found = plan(grid, belief, model, SearchOptions(planner, 5, width))
        print(found.path.tolist(), found.information.hex(), found.survival.hex())
for allocation in ('greedy', 'voronoi'):
    options = SearchOptions(max_steps=4, width=3, loss_cost=0.2)
    team = plan_team(grid, belief, model, Team(3, allocation), options)
    print([(planned.path.tolist(), planned.information.hex()) for planned in team])
print('numba' in sys.modules and sys.modules['numba'] is not None, file=sys.stderr)
"""


def plans(before='', **environment):
    """Return the plans of another process as text, and whether it has numba."""
    done = subprocess.run(
        [
            sys.executable,
            '-W',
            'ignore',
            '-c',
            PLANS.format(before=before, lethalities=LETHALITIES),
        ],
        env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    # A notice of compilation may come before.
    return done.stdout, done.stderr.splitlines()[-1] == 'True'


@pytest.mark.processes
def test_plans_have_the_same_bits_compiled_and_interpreted_with_one_thread_and_many():
    printed, has_numba = plans(NUMBA_NUM_THREADS='2', OMP_NUM_THREADS='2')
    assert has_numba
    assert len(printed.splitlines()) == 2 + 2 * len(LETHALITIES)
    # None in sys.modules: the module cannot be imported.
    without = plans("sys.modules['numba'] = None", NUMBA_NUM_THREADS='1', OMP_NUM_THREADS='1')
    assert without == (printed, False)
    if FULL:
        assert plans(NUMBA_NUM_THREADS='1', OMP_NUM_THREADS='1') == (printed, True)
        assert plans(NUMBA_DISABLE_JIT='1') == (printed, True)


@for_each('seed', range(60))
def test_labels_have_the_values_of_their_paths(seed):
    """By moments up to their error; at the base by the exact information."""
    rng = np.random.default_rng(seed)
    grid = Grid(4, 3, base=5)
    belief = Belief(brute_force.random_joint(rng, 12, 5))
    model = SensorModel(**brute_force.random_sensors(rng))
    options = SearchOptions('relaxed', max_steps=8, max_visits=8)
    objective = Objective.of(belief, model, options)
    problem = labels.label_problem(grid, objective, options)
    rank = np.argsort(problem.reach.cells)
    products = new_labels(1, 1, problem.gains)
    visits = np.empty(12, dtype=np.int64)
    for _ in range(10):
        path = brute_force.random_path(rng, 4, 3, 5, int(rng.integers(1, 9)))
        information = path_information(belief, model, path)
        ranks, steps = rank[np.array(path)][None], np.array([len(path) - 1])
        (exact,) = labels.rounded_values(problem, objective, ranks, steps)
        assert exact == pytest.approx(information, abs=2e-9)
        take(rank[path], problem.gains, visits, products)
        value = label_value(products, 0, problem._replace(units=1e15)) / 1e15
        missed = missed_by_moments(belief, model, path)
        assert abs(missed) <= ERROR
        assert value == pytest.approx(information + missed, abs=1e-11)
        assert visits.sum() == len(path) - 1


def missed_by_moments(belief, model, path):
    """Return the error of the sum of powers for the mean of -(1 - p) ln(1 - p), nats."""
    cells, visits = np.unique(path[1:], return_counts=True)
    states = np.array(list(itertools.product((0, 1), repeat=cells.size)))
    hazard = belief.hazard[cells]
    weight = np.where(states, hazard, 1.0 - hazard).prod(axis=1)
    survival = np.array(brute_force.step_survival(model))[states]
    p = (survival**visits).prod(axis=1)
    lost = 1.0 - p
    exact = -lost * np.log(lost, where=lost > 0.0, out=np.zeros_like(lost))
    return weight @ (exact - p[:, None] ** EXPONENTS @ WEIGHTS)


def small_problem(seed, max_steps, width, **options):
    """Draw a field of 3x3 cells and a search in it, sometimes with robots in flight."""
    rng = np.random.default_rng(seed)
    grid = Grid(3, 3, base=seed % 9, connectivity=(4, 8)[seed // 2 % 2])
    belief = Belief(brute_force.random_joint(rng, 9, grid.base))
    model = SensorModel(**brute_force.random_sensors(rng))
    options = SearchOptions(max_steps=max_steps, width=width, **options)
    objective = Objective.of(belief, model, options)
    if seed % 3 == 0:
        path = brute_force.random_path(rng, 3, 3, grid.base, 4)
        outcomes = after_deployment(nobody_deployed(belief), model, path)
        objective = replace(objective, outcomes=outcomes)
    return grid, objective, labels.label_problem(grid, objective, options)


def ranks(problem):
    """Return the rank of each cell, 0 out of reach."""
    rank = np.zeros(9, dtype=np.intp)
    rank[problem.reach.cells] = np.arange(problem.reach.cells.size)
    return rank


def valued(problem, objective, paths):
    rank = ranks(problem)
    rows = np.zeros((len(paths), problem.reach.within.size), dtype=np.intp)
    for row, path in zip(rows, paths):
        row[: len(path)] = rank[path]
    steps = np.array([len(path) - 1 for path in paths])
    return labels.rounded_values(problem, objective, rows, steps)


def walks(grid, steps):
    def extended(walk):
        yield walk
        if len(walk) <= steps:
            for cell in grid.neighbors(walk[-1]).tolist():
                yield from extended([*walk, cell])

    yield from extended([grid.base])


@pytest.mark.slow
@for_each('seed', range(60), every=3)
def test_no_path_exceeds_the_bound_of_its_first_cells(seed):
    """So dropping hopeless labels drops no best path."""
    loss_cost = (0.0, 0.1, 3.0)[seed // 3 % 3]
    grid, objective, problem = small_problem(seed, 5, 8, loss_cost=loss_cost, max_visits=2)
    paths = [path for path in walks(grid, 5) if len(path) > 1 and np.bincount(path[1:]).max() <= 2]
    closed = [path for path in paths if path[-1] == grid.base]
    best = {}
    for path, value in zip(closed, valued(problem, objective, closed)):
        for steps in range(1, len(path)):
            begun = tuple(path[: steps + 1])
            best[begun] = max(value, best.get(begun, value))
    rank = ranks(problem)
    products, visits = new_labels(1, 1, problem.gains), np.empty(9, dtype=np.int64)
    powers = problem.weight.size
    survival, term = products.factor[0, powers:], products.term[0, 1:]
    for begun, value in best.items():
        take(rank[list(begun)], problem.gains, visits, products)
        lost = problem.chance @ (1.0 - survival)
        brought = problem.chance @ (survival * term)
        unread = problem.unread[len(begun) - 1]
        hoped = hoped_value(brought, lost, survival.max(), loss_cost, unread)
        assert hoped >= value - 2e-9


def test_the_bound_is_reached_where_only_readings_inform():
    """Without hazards and malfunctions each step brings as much as the bound allows it."""
    grid = Grid(3, 3, base=4)
    belief = Belief.prior(grid, 0.0, 0.5, 0.5)
    model = SensorModel(0.5, malfunction=0.0)
    options = SearchOptions(max_steps=5, max_visits=2, width=8)
    objective = Objective.of(belief, model, options)
    problem = labels.label_problem(grid, objective, options)
    rank = ranks(problem)
    products, visits = new_labels(1, 1, problem.gains), np.empty(9, dtype=np.int64)
    powers = problem.weight.size
    (value,) = valued(problem, objective, [[4, 0, 1, 2, 5, 4]])
    for begun in ([4, 0], [4, 0, 1], [4, 0, 1, 2]):
        take(rank[begun], problem.gains, visits, products)
        brought = problem.chance @ products.term[0, 1:]
        # Survival is certain, so no label is hopeless before its last step.
        assert hoped_value(brought, 0.0, 1.0, 0.0, 0.0) == np.inf
        hoped = hoped_value(brought, 0.0, 0.5, 0.0, problem.unread[len(begun) - 1])
        assert value <= hoped + 1e-8
        assert hoped <= value + 1e-8
        assert np.array_equal(products.factor[0, powers:], np.ones(problem.chance.size))


def test_a_plan_is_the_same_in_a_larger_field():
    """Cells out of reach change nothing and are not searched."""
    rng = np.random.default_rng(1)
    small, large = Grid(13, 13, base=84), Grid(40, 50, base=25 * 40 + 20)
    inside = (np.arange(19, 32)[:, None] * 40 + np.arange(14, 27)).ravel()
    joint = brute_force.random_joint(rng, 169, 84)
    wide = brute_force.random_joint(rng, 2000, large.base)
    wide[inside] = joint
    near = plan(small, Belief(joint), SensorModel(0.5), SearchOptions(max_steps=12))
    far = plan(large, Belief(wide), SensorModel(0.5), SearchOptions(max_steps=12))
    assert far.path.tolist() == inside[near.path].tolist()
    assert far.information == near.information


@pytest.mark.slow
@for_each('planner, side, max_steps, width, max_visits, robots, is_allowed', [
    ('beam', 600, 1200, 16, 3, 1, False),
    ('relaxed', 1000, 2000, 16, 3, 1, False),
    ('beam', 9, 10_000, 16, 10_000, 1, False),
    ('beam', 100, 200, 4096, 3, 1, False),
    ('beam', 100, 200, 16, 3, 2000, False),
    ('beam', 9, 18, 10_000, 10_000, 1, True),
    ('beam', 9, 1000, 16, 3, 81, True),
    ('beam', 1000, 60, 16, 3, 100, True),
    ('relaxed', 300, 600, 10_000, 3, 1, True),
])  # fmt: skip
def test_searches_beyond_memory_are_refused_with_an_estimate(
    planner, side, max_steps, width, max_visits, robots, is_allowed
):
    finder = PathFinder(Grid(side, side), SearchOptions(planner, max_steps, width, max_visits))
    beam = f', a beam width of {width}' if planner == 'beam' else ','
    told = rf'max_steps = {max_steps}{beam}.* max_visits = {max_visits} .* GB.*lower'
    with nullcontext() if is_allowed else pytest.raises(ValueError, match=told):
        check_team(finder, [ORDINARY] * robots)


@pytest.mark.slow
def test_the_best_of_a_wide_search_is_found():
    """On beliefs of missions: most is known near the base, and little farther out."""
    grid = Grid(9, 9)
    near = np.clip(1.3 - grid.steps_to_base / 6, 0.02, 1.0)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        known = rng.random(81) < near
        hazard = np.where(known, np.where(rng.random(81) < 0.15, 0.8, 0.1), 0.5)
        target = np.where(known, np.where(rng.random(81) < 0.2, 0.9, 0.04), 0.45)
        hazard[0] = 0.0
        belief, model = Belief.from_maps(hazard, target, target), SensorModel(0.3)
        found, best = (
            plan(grid, belief, model, SearchOptions(max_steps=18, width=w)).information
            for w in (16, 128)
        )
        assert found >= 0.99 * best


def test_a_narrow_beam_is_no_relaxed_search():
    grid, model = Grid(9, 9), SensorModel(0.9)
    for seed in range(3):
        prior = Belief.prior(grid, 0.15, 0.205, 0.8)
        world = World.random(grid, seed, 0.15, 0.8, 0.1)
        options = SearchOptions('relaxed', 18)
        belief = run_mission(grid, prior, model, world, 30, seed, options=options).belief
        relaxed, narrow, wide = (
            plan(grid, belief, model, SearchOptions(planner, 18, width)).information
            for planner, width in (('relaxed', 1), ('beam', 1), ('beam', 16))
        )
        assert narrow > max(1.03 * relaxed, 0.95 * wide)


# Dense where the powers and the surprisal change fastest, near 0 and near 1.
LOGIT = np.linspace(-30, 30, 600_001)
LOSS = 1 / (1 + np.exp(LOGIT))


def error():
    surprisal = -LOSS * np.log(LOSS)
    return surprisal - np.exp(-np.log1p(np.exp(-LOGIT))[:, None] * EXPONENTS) @ WEIGHTS


def test_the_error_is_as_stated_from_0_to_1():
    assert np.abs(error()).max() <= ERROR
    assert abs(WEIGHTS.sum()) <= ERROR  # at 1, where no robot is lost; at 0 it is 0


def test_no_other_weights_are_better():
    """The error alternates between its extremes once more often than there are weights."""
    far = error()[np.abs(error()) > 0.999 * np.abs(error()).max()]
    turns = 1 + (np.diff(np.sign(far)) != 0).sum()
    assert turns == WEIGHTS.size + 1
