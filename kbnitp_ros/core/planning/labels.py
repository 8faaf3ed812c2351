# SPDX-License-Identifier: Apache-2.0
"""Label search: extend the best few partial paths of every cell, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from kbnitp_ros.core.field import Grid
from kbnitp_ros.core.planning.behavioral import powers_weights, SHANNON
from kbnitp_ros.core.planning.found import DECIMALS, Found
from kbnitp_ros.core.planning.gains import Gains
from kbnitp_ros.core.planning.information_kernels import exposed, left_open
from kbnitp_ros.core.planning.label_kernels import (
    fate_worth,
    improve,
    out_and_back,
    search,
    take,
    trace,
)
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.reach import Reach
import numpy as np
from numpy.typing import NDArray

# As many closed paths are ranked by their exact worth, or `width` if that is more; so many of
# them are improved.
RANKED = 8

# So many paths that lead back the way they came are improved as well.
TURNED = 4

# A closed path is improved by exchanging up to so many cells in a row, and so many of the best
# by exchanging one more.
EXCHANGED = 2
BEST = 2

# The most bytes that a search may take.
MOST_MEMORY = 1 << 30


def best_paths(
    grid: Grid, objective: Objective, max_steps: int, width: int, max_visits: int
) -> list[Found]:
    """
    Return the closed paths of most worth that the search finds.

    Labels at the same cell after the same number of steps compete by the objective of their
    partial path, and every second one is kept for what it promises: the objective of that path and
    a good way home together. Paths that differ only in the order of their visits are worth the
    same and count once. In the best closed paths, and in the best that lead back the way they
    came, stretches of one or two cells are then exchanged for better ones, and in the best of all
    these stretches of up to three. A search of width 1 does nothing of this: there is one label
    for each cell and step, as in the paper.

    Parameters
    ----------
    grid : Grid
        Gives the base and who neighbours whom.
    objective : Objective
        What a path is worth.
    max_steps : int
        The most steps the path may have.
    width : int
        How many labels are kept for each cell and step.
    max_visits : int
        How often the path may enter a cell.

    Returns
    -------
    list of Found
        Ranked by the exact objective, the best first, then the shortest; `RANKED` or `width` of
        those that seemed best, and what became of them. The same belief gives the same paths.

    Raises
    ------
    ValueError
        If the search would take too much memory.

    """
    labels = Search(grid, objective, max_steps, width, max_visits)
    closed = labels.closed_paths(max(width, RANKED))
    if width > 1:
        improved = labels.improved([*closed[:RANKED], *labels.turned_paths(TURNED)], EXCHANGED)
        best = [path for _, path in labels.ranked(improved)[:BEST]]
        closed += improved + labels.improved(best, EXCHANGED + 1)
    return [Found(worth, labels.reach.cells[path]) for worth, path in labels.ranked(closed)]


class Search:
    """
    A label search; arguments as of `best_paths`.

    Its cells are ranks in `reach`. The kernels say what goes in and comes out.

    """

    def __init__(
        self, grid: Grid, objective: Objective, max_steps: int, width: int, max_visits: int
    ) -> None:
        self._sought = objective
        fates = objective.fates.probability
        self.reach = Reach.of(grid, max_steps)
        earlier = objective.fates.states
        further = objective.fates.states_after(objective.model, min(max_visits, max_steps))
        weights = powers_weights(objective.alpha, fates)
        powers = weights.size
        check_memory(
            self.reach, max_steps, width, max_visits, fates.size, earlier, further, powers
        )
        max_visits = min(max_visits, max_steps)
        gains = Gains.of(objective, self.reach.cells, max_visits)
        self.marks = scattered(self.reach.cells.size, 62 - max_steps.bit_length())
        self._hazard = objective.belief.hazard[self.reach.cells]
        self._log_survival = objective.model.log_survival
        self.gains = gains.factor, gains.term
        self._objective = weights, fates, objective.loss_cost, 10.0**DECIMALS
        self._width = width
        # The worths of closed paths, by the marks of their visits.
        self._exact: dict[int, float] = {}
        by_promise = width // 2
        home = np.empty((self.reach.within.sum() if by_promise else 0, powers + 4))
        if by_promise:
            self._search(1, 0, home)
        self._origins, self._worths = self._search(width, by_promise, home)

    def _search(
        self, width: int, by_promise: int, home: NDArray[np.float64]
    ) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Return where each label comes from, and what those at the base are worth."""
        within = self.reach.within
        cells, rows = within.max(), within.max() * width
        labels, after = (
            (
                np.empty((rows, self.gains[0].shape[2])),
                np.empty((rows, self.gains[1].shape[2])),
                np.zeros(rows, dtype=np.int64),
                np.zeros((rows, 9), dtype=np.int32),
                np.zeros(cells, dtype=np.int64),
            )
            for _ in range(2)
        )
        origins = np.full(within.sum() * width, -1, dtype=np.int32)
        worths = np.full((within.size, width), -inf)
        search(
            self.reach.neighbors,
            within,
            self.marks,
            self.gains,
            self._objective,
            labels,
            after,
            by_promise,
            home,
            by_promise > 0,
            origins,
            worths,
        )
        return origins, worths

    def closed_paths(self, most: int) -> list[NDArray[np.intp]]:
        """Return the paths of the best labels at the base, then the shortest, as ranks."""
        best = np.argsort(-self._worths, axis=None, kind='stable')[:most]
        return [
            self._traced(0, row, steps)
            for steps, row in zip(*np.divmod(best, self._width))
            if self._worths[steps, row] > -inf
        ]

    def turned_paths(self, most: int) -> list[NDArray[np.intp]]:
        """
        Return the best of the paths that go to a cell by its best label and back the same way.

        They leave two of the steps allowed to improve them by.
        """
        steps = (self.reach.within.size - 3) // 2
        if steps < 1:
            return []
        worths = np.full(self.reach.within[steps], -inf)
        out_and_back(
            steps,
            self.reach.neighbors,
            self.reach.within,
            self._origins,
            self._width,
            self.gains,
            self._objective,
            worths,
        )
        ways = [
            self._traced(cell, cell * self._width, steps)
            for cell in np.argsort(-worths, kind='stable')[:most]
            if worths[cell] > -inf
        ]
        return [np.concatenate((way, way[-2::-1])) for way in ways]

    def _traced(self, cell: int, row: int, steps: int) -> NDArray[np.intp]:
        """Return the path of a label in some row after so many steps at a cell, as ranks."""
        path = np.empty(steps + 1, dtype=np.intp)
        path[steps] = cell
        trace(self.reach.neighbors, self.reach.within, self._origins, self._width, row, path)
        return path

    def improved(
        self, paths: Sequence[NDArray[np.intp]], exchanged: int
    ) -> list[NDArray[np.intp]]:
        """Return closed paths with stretches of up to so many cells exchanged for better ones."""
        improved = []
        for path in paths:
            longest = np.empty(self.reach.within.size, dtype=np.intp)
            longest[: path.size] = path
            steps = improve(
                longest,
                path.size - 1,
                self.reach.neighbors,
                self.gains,
                self._objective,
                exchanged,
            )
            improved.append(longest[: steps + 1])
        return improved

    def ranked(self, paths: Sequence[NDArray[np.intp]]) -> list[tuple[float, NDArray[np.intp]]]:
        """Return closed paths and their worth, the best first, those of equal visits once."""
        of_visits: dict[int, NDArray[np.intp]] = {}
        for path in paths:
            of_visits.setdefault(int(self.marks[path[1:]].sum()), path)
        for visits, path in of_visits.items():
            if visits not in self._exact:
                self._exact[visits] = self.exact(path)
        worths = [(self._exact[visits], path) for visits, path in of_visits.items()]
        return sorted(worths, key=lambda ranked: (-ranked[0], ranked[1].size))

    def exact(self, path: NDArray[np.intp]) -> float:
        """Return what a closed path is worth, without the error of the moments, rounded."""
        if self._sought.alpha != SHANNON:
            return Found.along(self.reach.cells[path], self._sought).worth
        factor, term = (np.empty((1, gain.shape[2])) for gain in self.gains)
        visits = np.empty(self.reach.cells.size, dtype=np.int64)
        take(path, 0, 0, *self.gains, visits, factor, term)
        worth = fate_worth(factor, term, 0, self._objective[1], self._objective[2])
        worth -= left_open(*exposed(path[1:], self._hazard, *self._log_survival))
        return round(worth, DECIMALS)


def check_memory(
    reach: Reach,
    max_steps: int,
    width: int,
    max_visits: int,
    fates: int,
    earlier: int,
    further: int,
    powers: int,
) -> None:
    """
    Check that a search can have the memory that it takes.

    Parameters
    ----------
    reach : Reach
        Of the paths.
    max_steps, width, max_visits : int
        As of `best_paths`.
    fates, earlier, further : int
        How many fates the robots before have, how many numbers of readings of a cell they may
        bring, and how many there are with those of the robot that is planned for.
    powers : int
        How many a label carries.

    Raises
    ------
    ValueError
        With an estimate, if it is more than `MOST_MEMORY`.

    """
    number = 8
    visits = min(max_visits, max_steps)
    labels, cells = int(reach.within.sum()), reach.cells.size
    factors_and_terms = powers + 1 + 2 * fates
    estimate = (
        # Where each label comes from, and the ways home if some are kept for what they promise.
        labels * (4 * width + (number * (powers + 4) if width > 1 else 0))
        # The labels of two steps, with their marks and the visits around.
        + 2 * int(reach.within.max()) * width * (number * (factors_and_terms + 1) + 4 * 9)
        # The gains and the chances of readings, while they are made.
        + 3 * number * cells * visits * factors_and_terms
        + 10 * number * further**2
        # What the robots before bring.
        + 2 * number * fates * cells * (earlier + 4)
    )
    if estimate > MOST_MEMORY:
        raise ValueError(
            f'planning with max_steps = {max_steps}, a beam width of {width} and max_visits = '
            f'{max_visits} takes about {estimate / 1e9:.1f} GB, and {MOST_MEMORY / 1e9:.1f} GB '
            'are allowed: lower one of them'
        )


def scattered(cells: int, bits: int) -> NDArray[np.int64]:
    """
    Return a mark for each cell whose sums tell apart how often each was visited (splitmix).

    Parameters
    ----------
    cells : int
        How many.
    bits : int
        Of a mark, such that no sum overflows.

    """
    x = np.arange(1, cells + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((x ^ (x >> np.uint64(31))) >> np.uint64(64 - bits)).astype(np.int64)
