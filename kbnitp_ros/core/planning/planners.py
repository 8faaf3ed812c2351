# SPDX-License-Identifier: Apache-2.0
"""
The planners, which search for the path of the next deployment.

A planner takes a `PathFinder` and an `Objective` and returns closed paths, the best first. A new
planner needs one file and one line here, or an entry point of another package.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from math import ceil

from kbnitp_ros.core.field.check import (
    as_array,
    cell_numbers,
    Floats,
    generator,
    in_short,
    Places,
    typed_fields,
    Value,
)
from kbnitp_ros.core.field.grid import Grid, longest
from kbnitp_ros.core.field.sensor import RobotType
from kbnitp_ros.core.planning.label_kernels import Reach
from kbnitp_ros.core.planning.labels import best_paths, find_reach
from kbnitp_ros.core.planning.objective import (
    Candidate,
    MAX_OUTCOMES,
    most_counted,
    Objective,
    WEIGHTS,
)
from kbnitp_ros.core.planning.options import PLANNERS, SearchOptions
from kbnitp_ros.core.planning.regions import without
import numpy as np
from numpy.typing import ArrayLike, NDArray


def tour(finder: PathFinder, order: Places | None = None) -> Places:
    """Return a closed path through the least visited cells, by `order` or nearest first."""
    grid, visited = finder.grid, finder.visited
    max_steps, max_visits = finder.options.max_steps, finder.options.max_visits

    def steps_from(cell: int, entered: Places, *, home: bool) -> Places:
        """Return the steps through cells that may be entered once more; the base only at last."""
        is_open = grid.free & (entered < max_visits)
        is_open[grid.base] = home
        return grid.steps_from(cell, is_open)

    wanted: NDArray[np.bool_] = grid.in_reach(max_steps)
    wanted[grid.base] = False
    if wanted.any():
        wanted &= visited == visited[wanted].min()
    path, home = [grid.base], [grid.base]
    entered: Places = np.zeros(grid.cells, dtype=np.intp)
    while wanted.any():
        steps = steps_from(path[-1], entered, home=False)
        in_time = len(path) - 1 + steps + grid.steps_to_base <= max_steps
        candidates = np.flatnonzero(wanted & (steps < grid.cells) & in_time)
        if not candidates.size:
            break
        target = int(candidates[np.argmin((steps if order is None else order)[candidates])])
        leg = way(grid, steps, target)
        after = entered + np.bincount(leg, minlength=grid.cells)
        back = steps_from(target, after, home=True)
        wanted[target] = False
        home_again = back[grid.base]
        if home_again < grid.cells and len(path) - 1 + len(leg) + home_again <= max_steps:
            path += leg
            entered = after
            wanted[leg] = False
            home = way(grid, back, grid.base)
    return np.array(path + home, dtype=np.intp)


def way(grid: Grid, steps: Places, target: int) -> list[int]:
    """Return a shortest path to `target`, without its start, given the steps from the start."""
    cells = [target]
    while steps[cells[-1]] > 1:
        around = grid.neighbors(cells[-1])
        cells.append(int(around[np.argmax(steps[around] == steps[cells[-1]] - 1)]))
    return cells[::-1]


# Maximum number of attempts at a random walk of each number of steps.
ATTEMPTS = 100


def random_walk(reach: Reach, max_visits: int, rng: np.random.Generator) -> Places:
    """Draw a closed walk of the maximum number of steps; of fewer if all attempts fail."""
    # The number of walks home by steps and cell, relative to the largest (:eq:`walks`).
    ways = [np.where(np.arange(reach.cells.size) == 0, 1.0, 0.0)]
    for _ in range(reach.within.size - 2):
        onward = np.where(reach.neighbors >= 0, ways[-1][reach.neighbors], 0.0).sum(axis=1)
        ways.append(onward / onward.max())
    for steps in range(reach.within.size - 1, 1, -1):
        for _ in range(ATTEMPTS):
            walk = one_walk(reach.neighbors, ways[:steps], max_visits, rng)
            if len(walk) > steps:
                return reach.cells[walk]
    return reach.cells[[0, 0]]


def one_walk(
    neighbors: Places, ways: list[Floats], max_visits: int, rng: np.random.Generator
) -> list[int]:
    """Draw a walk, as ranks, weighted by the number of `ways` home; a dead end ends it early."""
    walk, entered = [0], np.zeros(len(neighbors), dtype=np.intp)
    for left in reversed(ways):
        onward = neighbors[walk[-1]]
        onward = onward[onward >= 0]
        weight = np.cumsum(np.where(entered[onward] < max_visits, left[onward], 0.0))
        if weight[-1] == 0.0:
            break
        step = int(onward[np.searchsorted(weight, rng.random() * weight[-1], side='right')])
        entered[step] += 1
        walk.append(step)
    return walk


# Maximum bytes of a search.
MAX_MEMORY = 1 << 30

# The result of a planner.
A_LIST = 'a list of Candidate.along(path, objective)'


class NoPathError(ValueError):
    """Error raised if no path with the required survival is found."""


@typed_fields
@dataclass(frozen=True, eq=False, repr=False)
class PathFinder(Value):
    """
    A planner on a grid.

    Attributes
    ----------
    grid : Grid
        The field.
    options : SearchOptions
        The planner, the limits of its paths, and the objective.
    visited : array_like of int, shape (cells,)
        Number of visits to each cell by the paths of earlier deployments; 0 by default.
    rng : numpy.random.Generator, optional
        Generator for planners that have a parameter `rng`.

    Raises
    ------
    ValueError
        If the planner does not support the objective or the limit of distance, or `visited` or
        the cells to keep out of do not fit the grid.

    """

    grid: Grid
    options: SearchOptions
    visited: Places = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    rng: np.random.Generator | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        planner, objective = self.options.planner, self.options.objective
        if objective != 'information' and planner in BASELINES:
            raise ValueError(
                f'objective is {objective}, but the planner {planner} does not seek it: choose '
                'the planner beam or relaxed, or leave the objective at information'
            )
        if self.options.max_distance and planner in BASELINES:
            raise ValueError(
                f'max_distance is {self.options.max_distance:.6g} m, but the planner {planner} '
                'does not keep to it: choose the planner beam or relaxed, or leave max_distance '
                'at 0'
            )
        given, cells = as_array('visited', self.visited), self.grid.cells
        if given.size == 0:
            given = np.zeros(cells, dtype=np.intp)
        if given.shape != (cells,) or given.dtype.kind not in 'iu' or given.min() < 0:
            raise ValueError(
                f'visited has shape {given.shape} and type {given.dtype}: it must have a whole '
                f'number from 0 for each of the {cells} cells'
            )
        object.__setattr__(self, 'visited', given.astype(np.intp))
        object.__setattr__(self, 'grid', kept_out(self.grid, self.options))
        if self.rng is not None:
            object.__setattr__(self, 'rng', generator(self.rng))

    def of_type(self, robot_type: RobotType) -> PathFinder:
        """Return the finder with the base and the options of a robot type."""
        if not robot_type.own:
            return self
        grid, options = self.grid.at(robot_type.base), self.options.of_type(robot_type)
        return replace(self, grid=grid, options=options)

    def after(self, paths: Sequence[Places]) -> PathFinder:
        """Return the finder with the visits of these paths added, each of shape (steps + 1,)."""
        return replace(self, visited=self.visited + count_visits(self.grid, paths))

    def generator(self, objective: Objective) -> np.random.Generator:
        """Return the generator of a search; without `rng`, equal searches get equal ones."""
        if self.rng is not None:
            return self.rng
        known = sha256(objective.belief.joint.tobytes() + self.visited.tobytes()).digest()
        return np.random.default_rng(np.frombuffer(known, dtype='<u4'))

    def next_cells(self, path: ArrayLike) -> Places:
        """
        Return the cells into which a path can go on, and be closed within the limits.

        Parameters
        ----------
        path : array_like of int, shape (steps + 1,)
            The cells so far; only the base before the first step.

        Raises
        ------
        ValueError
            If the path does not begin at the base, or leaves the grid, jumps or has too many
            steps or visits.

        """
        grid, options, cells = self.grid, self.options, as_array('path', path, 'cells')
        if cells.ndim != 1 or not cells.size or cells.dtype.kind not in 'iu':
            raise ValueError(f'path is {in_short(path)}: it must list cells, the base first')
        cells = cells.astype(np.intp)
        grid.check_cells(cells)
        grid.check_steps(cells)
        left = options.max_steps - len(cells)
        if cells[0] != grid.base or left < -1:
            raise ValueError(
                f'path is {in_short(path)}: it must start at the base {grid.base} and have at '
                f'most max_steps = {options.max_steps} steps'
            )
        is_open = count_visits(grid, [cells]) < options.max_visits
        around = grid.neighbors(int(cells[-1]))
        if not is_open[grid.base]:
            return around[:0]
        if options.max_distance:
            metres = grid.path_length(cells)
            metres += grid.step_lengths[grid.neighbor_table[cells[-1]] >= 0]
            metres += self._metres_home(is_open, left)[around]
            is_in_reach = metres <= longest(options.max_distance)
        else:
            steps = grid.steps_to_base
            if not is_open.all():
                steps = grid.steps_from(grid.base, is_open & grid.free)
            is_in_reach = (steps[around] <= left) & (steps[around] < grid.cells)
        found: Places = around[is_open[around] & is_in_reach]
        return found

    def _metres_home(self, is_open: NDArray[np.bool_], most: int) -> Floats:
        """Return the shortest way of each cell to the base in at most `most` steps, metres."""
        table, cells = self.grid.neighbor_table, self.grid.cells
        # The last entry stands for cells off the grid.
        home: Floats = np.full(cells + 1, np.inf)
        home[self.grid.base] = 0.0
        is_closed = np.append(~is_open, True)
        for _ in range(most):
            onward = np.where(is_closed, np.inf, home)[table] + self.grid.step_lengths
            home[:-1] = np.minimum(home[:-1], onward.min(axis=1))
        return home

    def candidates(self, objective: Objective) -> list[Candidate]:
        """Return closed paths, the best first; raise NoPathError if none has enough survival."""
        planner = self.options.planner
        search = PLANNERS.find(planner)
        # The search plans on the hazards that act in each cell.
        sought = objective.effective() if objective.model.reach else objective
        if planner in PLANNERS.own:
            candidates = search(self, sought)
        else:
            with PLANNERS.blamed(planner):
                candidates = self._checked(search(self, sought))
        if sought is not objective:
            some = candidates[: 2 * self.options.width]
            exact = [Candidate.along(each.path, objective) for each in some]
            candidates = sorted(exact, key=lambda candidate: -candidate.value)
        if least := self.options.minimum_survival:
            candidates = [each for each in candidates if objective.survival(each.path) >= least]
        if not candidates:
            raise NoPathError(
                f'no path was found that a robot survives with minimum_survival = {least}: '
                'lower it, or max_steps'
            )
        return candidates

    def check_path(self, path: ArrayLike) -> Places:
        """Return a path as an array of cells, shape (steps + 1,), checked against the limits."""
        options = self.options
        cells = self.grid.check_path(path, options.max_steps, options.max_distance)
        visits, most = count_visits(self.grid, [cells]), options.max_visits
        if visits.max() > most:
            raise ValueError(
                f'path enters cell {visits.argmax()} {visits.max()} times: '
                f'at most max_visits = {most} are allowed'
            )
        return cells

    def _checked(self, found: object) -> list[Candidate]:
        """Check the results of another package's planner."""
        planner = self.options.planner
        if not isinstance(found, list | tuple):
            raise PLANNERS.fault(planner, f'returns {in_short(found)}: it must be {A_LIST}')
        if not found:
            raise PLANNERS.fault(planner, 'returns no path')
        for candidate in found:
            if not isinstance(candidate, Candidate):
                raise PLANNERS.fault(
                    planner, f'finds {in_short(candidate)}: it must return {A_LIST}'
                )
        try:
            return [Candidate(each.value, self.check_path(each.path)) for each in found]
        except ValueError as error:
            raise PLANNERS.fault(planner, f'returns an invalid path: {error}') from error

    def check_memory(self, robots: int, cameras: int) -> None:
        """Check that a search for one of several robots fits in memory."""
        options, number = self.options, 8
        rows = {'relaxed': 1, 'beam': options.labels}.get(str(options.planner), 0)
        if not rows and options.planner != 'random':
            return
        max_steps, max_visits = options.max_steps, options.max_visits
        reach = find_reach(self.grid, max_steps, options.max_distance)
        labels, cells = int(reach.start[-1]), reach.cells.size
        what, lower = f'random walks of max_steps = {max_steps} take', 'max_steps'
        estimate = number * reach.within.size * cells
        if rows:
            beam = f'a beam width of {options.width} and ' if rows > 1 else ''
            what = f'planning with max_steps = {max_steps}, {beam}max_visits = {max_visits} takes'
            lower, visits = 'one of them', min(max_visits, max_steps)
            # Limited, to avoid huge powers of two.
            outcomes = 2 ** min(robots - 1, MAX_OUTCOMES.bit_length() - 1)
            counts = (robots - 1) * visits
            counts = 1 + min(counts, most_counted(cameras) or counts)
            powers = WEIGHTS.size
            factors_and_terms = powers + 1 + 2 * outcomes
            estimate = (
                # The origin of each label, and the completions if labels are kept by a heuristic.
                labels * (4 * rows + (number * (powers + 5) if rows > 1 else 0))
                # The labels of two steps, with their hashes and the visits to neighbours.
                + 2 * int(reach.within.max()) * rows * (number * (factors_and_terms + 2) + 4 * 9)
                # The gains and the likelihoods of readings during their computation.
                + 3 * number * cells * visits * factors_and_terms
                + 10 * number * (counts ** (cameras - 1) * (counts + visits)) ** 2
                # The joint outcomes of robots sent before.
                + 2 * number * outcomes * cells * (counts**cameras + 4)
            )
        if estimate > MAX_MEMORY:
            raise ValueError(
                f'{what} about {estimate / 1e9:.1f} GB, and {MAX_MEMORY / 1e9:.1f} GB are '
                f'allowed: lower {lower}'
            )


def kept_out(grid: Grid, options: SearchOptions) -> Grid:
    """Return the grid with the cells to keep out of blocked."""
    if not options.keepout:
        return grid
    return without(grid, cell_numbers('keepout', options.keepout, grid.height, grid.width))


def check_distance(grid: Grid, options: SearchOptions) -> None:
    """Check that the limit of distance allows a step from the base and back."""
    if not options.max_distance:
        return
    within_steps = grid.in_reach(options.max_steps)
    within_both = grid.in_reach(options.max_steps, options.max_distance)
    if within_steps.sum() > 1 and within_both.sum() == 1:
        # Rounded up to millimetres.
        least = ceil(2e3 * np.sort(grid.distance_to_base[within_steps])[1] - 1e-6) / 1e3
        raise ValueError(
            f'max_distance is {options.max_distance:.6g} m, which allows no step from the base '
            f'and back in cells of {grid.resolution:.6g} m: it must be at least '
            f'{least:.6g} m, or 0 for no limit'
        )


def count_visits(grid: Grid, paths: Sequence[Places]) -> Places:
    """Count the visits to each cell, (cells,), by paths, each of shape (steps + 1,)."""
    entered = [path[1:] for path in paths] or [np.empty(0, dtype=np.intp)]
    return np.bincount(np.concatenate(entered), minlength=grid.cells)


def relaxed(finder: PathFinder, objective: Objective) -> list[Candidate]:
    """Search with the best label of each cell and step (arXiv:2305.06929, calculateBNPath)."""
    return best_paths(finder.grid, objective, finder.options, 1)


def beam(finder: PathFinder, objective: Objective) -> list[Candidate]:
    """Search with the best labels of each cell and step, as many as `SearchOptions.labels`."""
    return best_paths(finder.grid, objective, finder.options, finder.options.labels)


def random(finder: PathFinder, objective: Objective) -> list[Candidate]:
    """Draw a closed walk; equal beliefs and earlier visits give equal walks."""
    reach = find_reach(finder.grid, finder.options.max_steps)
    rng = replace(finder, rng=None).generator(objective)
    return [Candidate.along(random_walk(reach, finder.options.max_visits, rng), objective)]


def coverage(finder: PathFinder, objective: Objective) -> list[Candidate]:
    """Sweep the field row by row, starting where earlier paths ended."""
    grid = finder.grid
    row, col = np.divmod(np.arange(grid.cells), grid.width)
    # Row after row, every second row backwards.
    order = row * grid.width + np.where(row % 2, grid.width - 1 - col, col)
    return [Candidate.along(tour(finder, order), objective)]


def shortest_unvisited(finder: PathFinder, objective: Objective) -> list[Candidate]:
    """Go from one least visited cell to the nearest other one."""
    return [Candidate.along(tour(finder), objective)]


PLANNERS.fill(
    {
        'relaxed': relaxed,
        'beam': beam,
        'random': random,
        'coverage': coverage,
        'shortest_unvisited': shortest_unvisited,
    }
)

# Planners that seek no information.
BASELINES = ('random', 'coverage', 'shortest_unvisited')
