# SPDX-License-Identifier: Apache-2.0
"""
A bound on the value of every path, by a Lagrangian dual with cuts and branches.

The steps are those of docs/mathematics.md: the value of a path is at most a function of three sums
over its cells, equation :eq:`bound-path`; Lagrangian multipliers cut off sums that no closed walk
has, :eq:`bound-cut`; the function is maximised over what the cuts leave, :eq:`bound-maximum`; and
the paths are divided by a cell that they visit or not, for as many branches as are allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import exp, inf, log

from kbnitp_ros.core.field import Grid
from kbnitp_ros.core.planning.objective.candidate import Candidate
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.objective.options import SearchOptions
from kbnitp_ros.core.planning.search.bound_dual_kernels import Memory, minimise, Walks
from kbnitp_ros.core.planning.search.bound_maximum_kernels import (
    greatest_sum,
    maximum,
    next_cut,
    Region,
)
from kbnitp_ros.core.planning.search.label_kernels import Reach
from kbnitp_ros.core.planning.search.labels import MOST_MEMORY
from kbnitp_ros.core.planning.search.reach import reach_of
from kbnitp_ros.core.planning.search.visit_sums import VisitSums
import numpy as np
from numpy.typing import NDArray

# The most cuts of a set of paths, and after how many in a row that gain less than the tolerance no
# more are made.
MOST_CUTS = 60
STALLED = 6

# The set of paths is divided until its cuts took so much work: in a small field some dozen times,
# in a large one never. A unit is one step of the walks through a cell, or so many cuts of boxes.
MOST_WORK = 700_000
BOX_CUTS = 8

# The share of the value, and the nats, that the bound may be above the maximum it stands for.
TOLERANCE = 2e-4
LEAST_TOLERANCE = 1e-6

# What rounding may take from a bound, nats, and as a share of the loss cost.
ROUNDING = 1e-9
ROUNDING_OF_COST = 1e-13

# Paths that are survived less often bring nothing that a float can hold.
LEAST_SURVIVAL = 1e-100


def upper_bound(
    grid: Grid, objective: Objective, options: SearchOptions, path: NDArray[np.intp]
) -> float:
    """
    Return a bound on the value of every closed path of a robot that goes alone.

    Equations :eq:`bound-path` to :eq:`bound-maximum`.

    Parameters
    ----------
    grid : Grid
        The field.
    objective : Objective
        What is sought: information less the cost of a loss.
    options : SearchOptions
        Of the search.
    path : ndarray of int, shape (steps + 1,)
        A good path: the nearer to the best, the less there is to search.

    Returns
    -------
    float
        Nats, at least the value of `path`.

    Raises
    ------
    ValueError
        With an estimate, if it takes more memory than is allowed.

    """
    problem = Problem.of(grid, objective, options, path)
    slack = ROUNDING + ROUNDING_OF_COST * objective.loss_cost
    if exp(problem.log_safe) == 0.0:
        return problem.value + slack
    open_sets = [PathSet.whole(problem)]
    work = open_sets[0].work
    while work < MOST_WORK:
        loosest = max(open_sets, key=lambda paths: paths.bound)
        if loosest.bound <= problem.value + problem.tolerance:
            break
        cell = loosest.branching_cell()
        if cell is None:
            break
        halves = [loosest.without(cell), loosest.through(cell)]
        open_sets.remove(loosest)
        open_sets += halves
        work += sum(paths.work for paths in halves)
    return max(problem.value, *(paths.bound for paths in open_sets)) + slack


def check_memory(reach: Reach, options: SearchOptions) -> None:
    """
    Check that a bound can have the memory that it takes.

    Raises
    ------
    ValueError
        With an estimate, if it is more than `MOST_MEMORY`.

    """
    number, cells = 8, reach.cells.size
    max_steps, max_visits = options.max_steps, options.max_visits
    visits = 1 + min(max_visits, max_steps)
    of_walks = cells * (max_steps + 1 + number * (9 + 2 + 2))
    of_visits = number * cells * visits * (3 * 3 + 4)
    # Of the set of all paths; a set is divided only in a small field.
    of_multipliers = number * (cells + 2) * max_steps
    estimate = of_walks + of_visits + of_multipliers
    if estimate > MOST_MEMORY:
        raise ValueError(
            f'a bound for max_steps = {max_steps}, max_visits = {max_visits} and {cells} cells '
            f'within reach takes about {estimate / 1e9:.1f} GB, and {MOST_MEMORY / 1e9:.1f} GB '
            'are allowed: lower max_steps, or plan without a bound'
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """
    What a bound is sought for.

    Attributes
    ----------
    reach : Reach
        Of the paths.
    distance : ndarray of int, shape (cells,)
        Of the cells of `reach` from the base, steps.
    sums : VisitSums
        Of the cells of `reach`.
    log_safe : float
        log s0.
    loss_cost : float
        Nats.
    start : tuple of float
        The survival of a good path, its ratio r2 / r and its sum of W.
    value : float
        Its value, nats.
    max_steps : int
        Of a path.

    """

    reach: Reach
    distance: NDArray[np.intp]
    sums: VisitSums
    log_safe: float
    loss_cost: float
    start: tuple[float, float, float]
    value: float
    max_steps: int

    @classmethod
    def of(
        cls,
        grid: Grid,
        objective: Objective,
        options: SearchOptions,
        path: NDArray[np.intp],
    ) -> Problem:
        """Return the problem; arguments as of `upper_bound`."""
        reach = reach_of(grid, options.max_steps)
        check_memory(reach, options)
        visits = min(options.max_visits, options.max_steps)
        sums = VisitSums.of(objective.belief, objective.model, reach.cells, visits)
        counts = np.bincount(path[1:], minlength=grid.cells)[reach.cells]
        w, r, r2 = sums.added[np.arange(counts.size), counts].sum(axis=0)
        return cls(
            reach=reach,
            distance=grid.steps_to_base[reach.cells],
            sums=sums,
            log_safe=float(objective.model.log_survival[0]),
            loss_cost=objective.loss_cost,
            start=(inside(exp(-r)), r2 / r if r > 0.0 else 1.5, w),
            value=Candidate.along(path, objective).value,
            max_steps=options.max_steps,
        )

    @cached_property
    def memory(self) -> Memory:
        """Return what the dual writes."""
        cells = self.reach.cells.size
        return Memory(
            value=np.empty((2, cells)),
            origin=np.zeros((self.max_steps + 1, cells), dtype=np.int8),
            gradient=np.empty(cells + 2),
            share=np.empty(cells),
        )

    @property
    def tolerance(self) -> float:
        """By how much a bound may be above the maximum it stands for, nats."""
        return max(LEAST_TOLERANCE, TOLERANCE * abs(self.value))


def inside(survival: float) -> float:
    """Return a survival away from 0 and 1, where the slopes of the entropy have no end."""
    return min(max(survival, 1e-9), 1.0 - 1e-9)


@dataclass
class Length:
    """
    The paths of so many steps in a `PathSet`.

    Attributes
    ----------
    steps : int
        Of each.
    point : tuple of float
        The survival, the ratio r2 / r and the sum of W to be cut off next.
    multipliers : ndarray, shape (cells + 2,)
        Of the last cut.
    cuts : ndarray, shape (cuts, 3)
        As of `Region`.
    bound : float
        On the value of each, nats.

    """

    steps: int
    point: tuple[float, float, float]
    multipliers: NDArray[np.float64]
    cuts: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    bound: float = inf


class PathSet:
    """
    The paths that visit each cell at least and at most so often.

    Attributes
    ----------
    fewest, most : ndarray of int, shape (cells,)
        The visits to each cell of the reach.
    lengths : list of Length
        The paths by their steps.
    work : int
        That its cuts took, in units of `MOST_WORK`.

    """

    def __init__(
        self,
        problem: Problem,
        fewest: NDArray[np.intp],
        most: NDArray[np.intp],
        lengths: list[Length],
    ) -> None:
        self._problem = problem
        self.fewest, self.most, self.lengths = fewest, most, lengths
        self.work = 0
        self._share = np.full(fewest.size, 0.5)
        self._tighten()

    @classmethod
    def whole(cls, problem: Problem) -> PathSet:
        """Return the set of all paths."""
        most = problem.sums.survivable
        none = np.zeros(most.size + 2)
        lengths = [
            Length(steps, problem.start, none.copy()) for steps in range(1, problem.max_steps + 1)
        ]
        return cls(problem, np.zeros_like(most), most, lengths)

    @property
    def bound(self) -> float:
        """On the value of every path in it, nats."""
        return max(length.bound for length in self.lengths)

    def branching_cell(self) -> int | None:
        """Return the rank of the cell that the best walks agree least on, None without any."""
        doubt = self._share * (1.0 - self._share)
        doubt[(self.fewest > 0) | (self.most == 0)] = -1.0
        doubt[0] = -1.0
        cell = int(doubt.argmax())
        return cell if doubt[cell] >= 0.0 else None

    def without(self, cell: int) -> PathSet:
        """Return the paths that do not visit a cell."""
        most = self.most.copy()
        most[cell] = 0
        return PathSet(self._problem, self.fewest, most, self._copied())

    def through(self, cell: int) -> PathSet:
        """Return the paths that visit a cell."""
        fewest = self.fewest.copy()
        fewest[cell] = 1
        return PathSet(self._problem, fewest, self.most, self._copied())

    def _copied(self) -> list[Length]:
        return [replace(each, multipliers=each.multipliers.copy()) for each in self.lengths]

    def _tighten(self) -> None:
        """Cut where the bound is highest until that brings no more."""
        problem, stalled = self._problem, 0
        for _ in range(MOST_CUTS):
            highest = max(self.lengths, key=lambda length: length.bound)
            before = highest.bound
            if before <= problem.value + problem.tolerance or stalled == STALLED:
                break
            self._cut(highest)
            stalled = stalled + 1 if highest.bound > before - problem.tolerance else 0

    def _cut(self, length: Length) -> None:
        """Add the lowest cut at the point of a length, and bound what is left."""
        problem, steps = self._problem, length.steps
        longest_stay = steps - 2 * problem.distance + 1
        longest_stay[0] = steps
        most = np.minimum(self.most, longest_stay.clip(min=0))
        safest = exp(steps * problem.log_safe)
        if (self.fewest > most).any():
            length.bound = problem.value
            return
        if safest < LEAST_SURVIVAL:
            length.bound = max(problem.value, -problem.loss_cost)
            return
        self.work += steps * most.size
        survival, ratio, total = length.point
        r = -log(survival)
        region = Region(safest, problem.loss_cost, length.cuts)
        of_r, of_r2, enough = next_cut(region, survival, ratio, total, problem.value)
        if not len(length.cuts):
            length.multipliers[:-2] = problem.sums.added[:, 1] @ [1.0, -of_r, -of_r2]
        length.multipliers[-2:] = of_r, of_r2
        walks = Walks(
            problem.reach.neighbors,
            problem.reach.within,
            problem.sums.added,
            self.fewest,
            most,
        )
        d = minimise(walks, steps, length.multipliers, r, ratio * r, enough, problem.memory)
        self._share = problem.memory.share.copy()
        cuts = np.vstack([length.cuts, [d, *length.multipliers[-2:]]])
        point = np.array([survival, ratio])
        region = region._replace(cuts=cuts)
        bound, opened = maximum(region, problem.value, problem.tolerance, point)
        self.work += opened * len(cuts) // BOX_CUTS
        survival, ratio = inside(point[0]), float(point[1])
        length.cuts, length.point = cuts, (survival, ratio, greatest_sum(region, survival, ratio))
        length.bound = min(length.bound, bound)
