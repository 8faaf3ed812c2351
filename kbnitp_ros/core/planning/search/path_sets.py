# SPDX-License-Identifier: Apache-2.0
"""Sets of paths, and bounds on the values of those in them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import exp, inf, log

from kbnitp_ros.core.field import Grid, surprisal, times_log
from kbnitp_ros.core.planning.objective.candidate import Candidate
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.objective.options import SearchOptions
from kbnitp_ros.core.planning.search.bound_dual_kernels import Memory, minimise, Walks
from kbnitp_ros.core.planning.search.bound_maximum_kernels import (
    greatest_sum,
    maximum,
    next_cut,
    Region,
    worthless,
)
from kbnitp_ros.core.planning.search.label_kernels import Reach
from kbnitp_ros.core.planning.search.reach import reach_of
from kbnitp_ros.core.planning.search.visit_sums import VisitSums
from kbnitp_ros.core.planning.search.walk_kernels import go_through, Worth
import numpy as np
from numpy.typing import NDArray

# The most cuts of a set of paths beyond one for each number of steps, and after how many in a row
# that gain less than the tolerance no more are made.
MOST_CUTS = 60
STALLED = 6

# The share of the value, and the nats, that the bound may be above the maximum it stands for.
TOLERANCE = 2e-4
LEAST_TOLERANCE = 1e-6

# What rounding may take from a bound, nats, and as a share of the loss cost.
ROUNDING = 1e-9
ROUNDING_OF_COST = 1e-13

# Paths that are survived less often bring nothing that a float can hold.
LEAST_SURVIVAL = 1e-100


@dataclass(eq=False)
class Problem:
    """
    The paths of a robot that goes alone, and the best of them that is known.

    Attributes
    ----------
    objective : Objective
        What is sought: information less the cost of a loss.
    reach : Reach
        Of the paths.
    distance : ndarray of int, shape (cells,)
        Of the cells of `reach` from the base, steps.
    sums : VisitSums
        Of the cells of `reach`.
    max_steps : int
        Of a path.
    least : float
        The survival that it must have.
    path : ndarray of int, shape (steps + 1,)
        The best that is known.
    value : float
        Its value, nats.

    """

    objective: Objective
    reach: Reach
    distance: NDArray[np.intp]
    sums: VisitSums
    max_steps: int
    least: float
    path: NDArray[np.intp]
    value: float

    @classmethod
    def of(
        cls,
        grid: Grid,
        objective: Objective,
        options: SearchOptions,
        path: NDArray[np.intp],
    ) -> Problem:
        """
        Return the problem to find the best path in a grid, of which a good one is known.

        Raises
        ------
        ValueError
            If the path is none.

        """
        reach = reach_of(grid, options)
        visits = min(options.max_visits, options.max_steps)
        return cls(
            objective=objective,
            reach=reach,
            distance=grid.steps_to_base[reach.cells],
            sums=VisitSums.of(objective.belief, objective.model, reach.cells, visits),
            max_steps=options.max_steps,
            # Whoever compares survivals rounds.
            least=options.minimum_survival * (1.0 - 1e-12),
            path=path,
            value=Candidate.along(path, objective).value,
        )

    @property
    def log_safe(self) -> float:
        """Return log s0."""
        return float(self.objective.model.log_survival[0])

    @property
    def slack(self) -> float:
        """Return what rounding may take from a bound, nats."""
        return rounding(self.objective.loss_cost)

    def start(self) -> tuple[float, float, float]:
        """Return the survival of the best path known, its ratio r2 / r and its sum of W."""
        visits = np.bincount(self.path[1:], minlength=self.objective.belief.cells)
        counts = visits[self.reach.cells]
        w, r, r2 = self.sums.added[np.arange(counts.size), counts].sum(axis=0)
        return inside(exp(-r)), r2 / r if r > 0.0 else 1.5, w

    def worth(self, steps: int) -> Worth:
        """Return what the values of paths of so many steps are computed from."""
        exposures = np.arange(steps + 1)
        log_safe, log_deadly = self.objective.model.log_survival
        log_survival = times_log(steps - exposures, log_safe) + times_log(exposures, log_deadly)
        return Worth(
            self.objective.belief.hazard[self.reach.cells],
            surprisal(-np.expm1(log_survival)),
            self.objective.loss_cost,
            -log(self.least) if self.least > 0.0 else inf,
        )

    def improve(self, path: NDArray[np.intp]) -> None:
        """Take note of a path, shape (steps + 1,), that is better than the best known."""
        self.path, self.value = path, Candidate.along(path, self.objective).value

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


def rounding(loss_cost: float) -> float:
    """Return what rounding may take from a bound at a loss cost, both in nats."""
    return ROUNDING + ROUNDING_OF_COST * loss_cost


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
        self._share = np.full(fewest.size, 0.5)
        self._tighten()

    @classmethod
    def whole(cls, problem: Problem) -> PathSet:
        """Return the set of all paths."""
        most = problem.sums.survivable
        start, none = problem.start(), np.zeros(most.size + 2)
        lengths = [Length(steps, start, none.copy()) for steps in range(1, problem.max_steps + 1)]
        return cls(problem, np.zeros_like(most), most, lengths)

    @property
    def bound(self) -> float:
        """On the value of every path in it, nats."""
        return max(length.bound for length in self.lengths)

    def branching_cell(self) -> int | None:
        """
        Return the rank of the cell to divide by, None without any.

        The best walks agree least on it, weighted by what a visit takes from the survival.
        """
        doubt = self._share * (1.0 - self._share) * self._problem.sums.added[:, 1, 1]
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

    def go_through(self, tolerance: float, most: int) -> bool:
        """
        Go through the paths that may be worth more than the best known by a tolerance.

        Equation :eq:`bound-walk`.

        Parameters
        ----------
        tolerance : float
            Nats.
        most : int
            How many steps may be taken.

        Returns
        -------
        bool
            Whether these were enough, so that the bound is the best value known and the tolerance.

        """
        problem = self._problem
        for length in sorted(self.lengths, key=lambda length: -length.bound):
            allowed = problem.value + tolerance
            if length.bound <= allowed:
                break
            best = np.empty(length.steps + 1, dtype=np.intp)
            value, taken = go_through(
                self._walks(length.steps),
                problem.reach,
                length.multipliers,
                worthless(self._region(length), allowed, problem.tolerance),
                problem.worth(length.steps),
                problem.value,
                most,
                best,
            )
            if value > problem.value:
                problem.improve(problem.reach.cells[best])
            most -= taken
            if most < 0:
                return False
            length.bound = max(allowed, problem.value)
        return True

    def _walks(self, steps: int) -> Walks:
        """Return the closed walks of so many steps and their visits."""
        problem = self._problem
        longest_stay = steps - 2 * problem.distance + 1
        longest_stay[0] = steps
        most = np.minimum(self.most, longest_stay.clip(min=0))
        reach = problem.reach
        return Walks(reach.neighbors, reach.within, problem.sums.added, self.fewest, most)

    def _region(self, length: Length) -> Region:
        """Return what is known of the paths of a length."""
        problem = self._problem
        safest = exp(length.steps * problem.log_safe)
        return Region(safest, problem.least, problem.objective.loss_cost, length.cuts)

    def _copied(self) -> list[Length]:
        return [replace(each, multipliers=each.multipliers.copy()) for each in self.lengths]

    def _tighten(self) -> None:
        """Cut where the bound is highest until that brings no more."""
        problem, stalled = self._problem, 0
        for _ in range(MOST_CUTS + len(self.lengths)):
            highest = max(self.lengths, key=lambda length: length.bound)
            before = highest.bound
            if before <= problem.value + problem.tolerance or stalled == STALLED:
                break
            self._cut(highest)
            stalled = stalled + 1 if highest.bound > before - problem.tolerance else 0

    def _cut(self, length: Length) -> None:
        """Add the lowest cut at the point of a length, and bound what is left."""
        problem, steps = self._problem, length.steps
        walks = self._walks(steps)
        region = self._region(length)
        if (self.fewest > walks.most).any() or region.safest < region.least:
            length.bound = -inf
            return
        if region.safest < LEAST_SURVIVAL:
            length.bound = -problem.objective.loss_cost
            return
        survival, ratio, total = length.point
        r = -log(survival)
        of_r, of_r2, enough = next_cut(region, survival, ratio, total, problem.value)
        if not len(length.cuts):
            length.multipliers[:-2] = problem.sums.added[:, 1] @ [1.0, -of_r, -of_r2]
        length.multipliers[-2:] = of_r, of_r2
        d = minimise(walks, steps, length.multipliers, r, ratio * r, enough, problem.memory)
        self._share = problem.memory.share.copy()
        cuts = np.vstack([length.cuts, [d, *length.multipliers[-2:]]])
        point = np.array([survival, ratio])
        region = region._replace(cuts=cuts)
        bound = maximum(region, problem.value, problem.tolerance, point)
        survival, ratio = inside(point[0]), float(point[1])
        length.cuts, length.point = cuts, (survival, ratio, greatest_sum(region, survival, ratio))
        length.bound = min(length.bound, bound)
