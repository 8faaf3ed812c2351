# SPDX-License-Identifier: Apache-2.0
"""
A bound on the value of every path, by a Lagrangian dual with cuts and branches.

The steps are those of docs/mathematics.md: the value of a path is at most a function of three sums
over its cells, equation :eq:`bound-path`; Lagrangian multipliers cut off sums that no closed walk
has, :eq:`bound-cut`; the function is maximised over what the cuts leave, :eq:`bound-maximum`; and
the paths are divided by a cell that they visit or not, until so few are left that might be better
than the best one known that they can be gone through, :eq:`bound-walk`.
"""

from __future__ import annotations

from math import exp
from typing import NamedTuple

from kbnitp_ros.core.field import Grid
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.objective.options import SearchOptions
from kbnitp_ros.core.planning.search.label_kernels import Reach
from kbnitp_ros.core.planning.search.labels import MOST_MEMORY
from kbnitp_ros.core.planning.search.path_sets import PathSet, Problem, rounding
import numpy as np
from numpy.typing import NDArray

# A bound divides the paths so often, over the cells and the square of the steps: in a small field
# some times, in a large one never.
DIVISIONS = 300_000

# A set of paths is gone through in at most so many steps: for a bound, and for the best path.
FEW_WALKS = 10_000
MANY_WALKS = 1_000_000


class Proof(NamedTuple):
    """
    How good the best path known is.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        That one.
    upper_bound : float
        On the value of every path, nats.

    """

    path: NDArray[np.intp]
    upper_bound: float


def upper_bound(
    grid: Grid, objective: Objective, options: SearchOptions, path: NDArray[np.intp]
) -> float:
    """Return the bound beside a plan; arguments as of `Problem.of`."""
    problem = Problem.of(grid, objective, options, path)
    divisions = DIVISIONS // (problem.reach.cells.size * options.max_steps**2)
    return prove(problem, problem.tolerance, divisions, FEW_WALKS).upper_bound


def best_path(
    grid: Grid, objective: Objective, options: SearchOptions, path: NDArray[np.intp]
) -> Proof:
    """Return the best path, or the best found by `options.branches`; arguments likewise."""
    problem = Problem.of(grid, objective, options, path)
    return prove(problem, options.tolerance, options.branches, MANY_WALKS)


def prove(problem: Problem, tolerance: float, branches: int, walks: int) -> Proof:
    """
    Divide the paths until none can be worth more than the best by a tolerance.

    Equations :eq:`bound-path` to :eq:`bound-walk`.

    Parameters
    ----------
    problem : Problem
        With a good path: the nearer to the best, the less there is to search.
    tolerance : float
        Nats.
    branches : int
        How often they are divided at most.
    walks : int
        In how many steps a set of them is gone through at most; all of them in as many for each
        branch.

    Returns
    -------
    Proof
        The same problem has the same proof.

    """
    open_sets = [PathSet.whole(problem)] if exp(problem.log_safe) > 0.0 else []
    # First of all paths, in as many steps as those of all branches together.
    most = walks * max(1, branches)
    while open_sets:
        loosest = max(open_sets, key=lambda paths: paths.bound)
        if loosest.bound <= problem.value + tolerance - 2.0 * problem.slack:
            break
        if loosest.go_through(0.5 * tolerance, most):
            continue
        most, cell = walks, loosest.branching_cell()
        if cell is None or branches == 0:
            break
        branches -= 1
        open_sets.remove(loosest)
        open_sets += [loosest.without(cell), loosest.through(cell)]
    bound = max([problem.value, *(paths.bound for paths in open_sets)])
    return Proof(problem.path, bound + problem.slack)


def check_bound(reach: Reach, options: SearchOptions, robots: int) -> None:
    """
    Check that there is a bound, and that it can have the memory that it takes.

    Parameters
    ----------
    reach : Reach
        Of the paths.
    options : SearchOptions
        Of the search.
    robots : int
        How many leave together or are in flight.

    Raises
    ------
    ValueError
        If there are several robots, the objective has none, or the tolerance is below rounding;
        with an estimate, if it takes more than `MOST_MEMORY`.

    """
    if robots > 1:
        raise ValueError(
            f'there are {robots} robots, and a bound and the planner exact are for one that goes '
            'alone: send one at a time, or choose the planner beam without a bound'
        )
    if options.objective != 'information':
        raise ValueError(
            f'objective is {options.objective}, for which there is no bound: choose the objective '
            'information, or the planner beam without a bound'
        )
    least = 10.0 * rounding(options.loss_cost)
    if options.planner == 'exact' and options.tolerance < least:
        raise ValueError(
            f'tolerance is {options.tolerance}: with a loss_cost of {options.loss_cost} rounding '
            f'is above that, and it must be at least {least:.3g}'
        )
    number, cells = 8, reach.cells.size
    max_steps, max_visits = options.max_steps, options.max_visits
    visits = 1 + min(max_visits, max_steps)
    # The best walks, and the prices of the ways home.
    of_walks = cells * (max_steps + 1) * (1 + number) + number * cells * (9 + 2 + 2)
    of_visits = number * cells * visits * (3 * 3 + 4 + 1)
    # Of the set of all paths; a set is divided only in a small field.
    of_multipliers = number * (cells + 2) * max_steps
    estimate = of_walks + of_visits + of_multipliers
    if estimate > MOST_MEMORY:
        raise ValueError(
            f'a bound for max_steps = {max_steps}, max_visits = {max_visits} and {cells} cells '
            f'within reach takes about {estimate / 1e9:.1f} GB, and {MOST_MEMORY / 1e9:.1f} GB '
            'are allowed: lower max_steps, or choose the planner beam without a bound'
        )
