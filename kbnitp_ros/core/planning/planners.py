# SPDX-License-Identifier: Apache-2.0
"""
The planners: how each looks for the path of the next deployment.

A planner takes a `PathFinder` and an `Objective` and returns closed paths, the best first. A new
one is one file and one line here, or an entry point of another package; a label search has another
line among `LABELS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

from kbnitp_ros.core.field import Grid, whole_number
from kbnitp_ros.core.planning.behavioral import alpha_of, powers_of, SHANNON
from kbnitp_ros.core.planning.fates import MOST_FATES
from kbnitp_ros.core.planning.found import Found
from kbnitp_ros.core.planning.labels import best_paths, check_memory
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.random_walk import check_walk_memory, generator_of, random_walk
from kbnitp_ros.core.planning.reach import Reach
from kbnitp_ros.core.planning.readings import check_cameras, most_counted
from kbnitp_ros.core.planning.tour import boustrophedon, nearest, Order, tour
from kbnitp_ros.plugins import Registry, takes
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class PathFinder:
    """
    A planner on a grid, with the limits of its paths and of its search; arguments as of `plan`.

    Raises
    ------
    ValueError
        If the planner is unknown, a number is out of range or `visited` fits another grid.

    """

    grid: Grid
    planner: str
    max_steps: int
    width: int
    max_visits: int
    visited: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))

    def __post_init__(self) -> None:
        PLANNERS.find(self.planner)
        for name in ('max_steps', 'width', 'max_visits'):
            object.__setattr__(self, name, whole_number(name, getattr(self, name), 1))
        object.__setattr__(self, 'visited', visits_before(self.grid, self.visited))

    def after(self, paths: Sequence[NDArray[np.intp]]) -> PathFinder:
        """Return the finder once robots have left on these paths, each of shape (steps + 1,)."""
        return replace(self, visited=self.visited + count_visits(self.grid, paths))

    def paths(self, objective: Objective) -> list[Found]:
        """
        Return the closed paths found for an objective, at least one, the best first.

        Raises
        ------
        PluginError
            If a planner of another package breaks its rules.

        """
        with PLANNERS.blamed(self.planner):
            found = PLANNERS[self.planner](self, objective)
            if self.planner not in PLANNERS.own:
                self._check_found(found)
        return found

    def check_path(self, path: ArrayLike) -> NDArray[np.intp]:
        """
        Return a path as an array of cells, shape (steps + 1,), if it keeps to the limits.

        Raises
        ------
        ValueError
            If a robot cannot take it, it is too long or visits a cell too often.

        """
        cells = self.grid.check_path(path, self.max_steps)
        visits = count_visits(self.grid, [cells])
        if visits.max() > self.max_visits:
            raise ValueError(
                f'path enters cell {visits.argmax()} {visits.max()} times: '
                f'at most max_visits = {self.max_visits} may be'
            )
        return cells

    def _check_found(self, found: list[Found]) -> None:
        """Refuse what another package's planner may not return."""
        if not found:
            raise PLANNERS.fault(self.planner, 'returns no path')
        try:
            for each in found:
                self.check_path(each.path)
        except ValueError as error:
            raise PLANNERS.fault(self.planner, f'returns a path that is none: {error}') from error

    def check_memory(self, robots: int, cameras: int = 1, alpha: float = SHANNON) -> None:
        """
        Check that paths can be searched for within the memory allowed, before any is.

        Parameters
        ----------
        robots : int
            How many leave together or are out, at least 1.
        cameras : int
            How many different ones they have.
        alpha : float
            Of the objective.

        Raises
        ------
        ValueError
            With an estimate, if it takes more; or if the cameras are too many.

        """
        check_cameras(cameras)
        if self.planner == 'random':
            check_walk_memory(Reach.of(self.grid, self.max_steps))
        if labels := LABELS.get(self.planner):
            before = robots - 1
            # As many as there can be, without powers of two that nobody can count.
            fates = 2 ** min(before, MOST_FATES.bit_length() - 1)
            visits = min(self.max_visits, self.max_steps)
            counts = 1 + min(before * visits, most_counted(cameras) or before * visits)
            further = counts ** (cameras - 1) * (counts + visits)
            reach = Reach.of(self.grid, self.max_steps)
            width = labels(self.width)
            check_memory(
                reach,
                self.max_steps,
                width,
                self.max_visits,
                fates,
                counts**cameras,
                further,
                powers_of(alpha, fates),
            )


def visits_before(grid: Grid, given: NDArray[np.intp]) -> NDArray[np.intp]:
    """
    Return how often earlier paths entered each cell, shape (cells,); nothing given: never.

    Raises
    ------
    ValueError
        If they are not whole numbers from 0, one for each cell.

    """
    if given.size == 0:
        return np.zeros(grid.cells, dtype=np.intp)
    if given.shape != (grid.cells,) or given.dtype.kind not in 'iu' or given.min() < 0:
        raise ValueError(
            f'visited has shape {given.shape} and type {given.dtype}: it must have a whole number '
            f'from 0 for each of the {grid.cells} cells'
        )
    return given.astype(np.intp)


def count_visits(grid: Grid, paths: Sequence[NDArray[np.intp]]) -> NDArray[np.intp]:
    """Return how often paths, each of shape (steps + 1,), enter each cell, shape (cells,)."""
    entered = [path[1:] for path in paths] or [np.empty(0, dtype=np.intp)]
    return np.bincount(np.concatenate(entered), minlength=grid.cells)


def relaxed(finder: PathFinder, objective: Objective) -> list[Found]:
    """Keep the single best label of each cell and step: the paper's planner."""
    return best_paths(finder.grid, objective, finder.max_steps, 1, finder.max_visits)


def beam(finder: PathFinder, objective: Objective) -> list[Found]:
    """Keep the best few labels of each cell and step."""
    return best_paths(finder.grid, objective, finder.max_steps, finder.width, finder.max_visits)


def random(finder: PathFinder, objective: Objective) -> list[Found]:
    """Draw a closed walk, the same again for the same belief and earlier visits."""
    reach = Reach.of(finder.grid, finder.max_steps)
    check_walk_memory(reach)
    rng = generator_of(objective.belief.joint, finder.visited)
    return [Found.along(random_walk(reach, finder.max_visits, rng), objective)]


def coverage(finder: PathFinder, objective: Objective) -> list[Found]:
    """Plough the field, where earlier paths left off."""
    return toured(finder, objective, boustrophedon(finder.grid))


def shortest_unvisited(finder: PathFinder, objective: Objective) -> list[Found]:
    """Go to the nearest of the cells that were visited least, and on to the next."""
    return toured(finder, objective, nearest)


def toured(finder: PathFinder, objective: Objective, order: Order) -> list[Found]:
    """Return the tour in an order."""
    path = tour(finder.grid, finder.max_steps, finder.max_visits, finder.visited, order)
    return [Found.along(path, objective)]


Planner = Callable[[PathFinder, Objective], list[Found]]


def as_planner(given: object) -> Planner:
    """
    Return a planner that is to be registered.

    Raises
    ------
    TypeError
        If it is none.

    """
    takes(given, ('finder', 'objective'))
    return cast(Planner, given)


PLANNERS = Registry(
    'planner',
    as_planner,
    {
        'relaxed': relaxed,
        'beam': beam,
        'random': random,
        'coverage': coverage,
        'shortest_unvisited': shortest_unvisited,
    },
)

# Those that seek no information.
BASELINES = ('random', 'coverage', 'shortest_unvisited')


def sought_by(planner: str, objective: str, alpha: float) -> float:
    """
    Return the alpha of an objective that a planner is to seek.

    Raises
    ------
    ValueError
        If there is no such objective, or it would change nothing.

    """
    if objective != 'information' and planner in BASELINES:
        raise ValueError(
            f'objective is {objective}, and the planner {planner} seeks none: choose the planner '
            'beam or relaxed, or leave the objective at information'
        )
    return alpha_of(objective, alpha)


# How many labels the label searches among them keep, of a width that they are given.
LABELS: dict[str, Callable[[int], int]] = {'relaxed': lambda _: 1, 'beam': lambda width: width}
