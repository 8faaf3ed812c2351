# SPDX-License-Identifier: Apache-2.0
"""Label search: extend the best few partial paths of every cell, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from kbnitp_ros.core.field import Grid
from kbnitp_ros.core.planning.objective.behavioral import powers_weights
from kbnitp_ros.core.planning.objective.candidate import Candidate, DECIMALS
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.objective.options import SearchOptions, SHANNON
from kbnitp_ros.core.planning.search.gains import gains_of
from kbnitp_ros.core.planning.search.improvement_kernels import (
    exact_values,
    improve_all,
    Moves,
)
from kbnitp_ros.core.planning.search.label_kernels import (
    LabelObjective,
    LabelProblem,
    Reach,
)
from kbnitp_ros.core.planning.search.lasso_kernels import search_lassos
from kbnitp_ros.core.planning.search.reach import reach_of
from kbnitp_ros.core.planning.search.search_kernels import search, trace_closed
import numpy as np
from numpy.typing import NDArray

# As many closed paths are ranked by their exact value, or twice `width` if that is more.
RANKED = 8

# Of lassos, so many stems are kept for each cell and step, and so many lassos are improved.
STEMS = 4
LASSOS = 96

# The rounds of the local search: what is replaced, and how many of the best paths are kept.
ROUNDS = ((Moves(1, 2, 0, 0), 48), (Moves(2, 3, 0, 0), 8), (Moves(3, 3, 6, 4), 8))

# The most bytes that a search may take.
MOST_MEMORY = 1 << 30


def best_paths(
    grid: Grid, objective: Objective, options: SearchOptions, width: int
) -> list[Candidate]:
    """
    Return the closed paths of the highest value that the search finds.

    Labels at the same cell after the same number of steps compete by the objective of their
    partial path, and every second one is kept for its heuristic value: the objective of that path
    and a good completion together. Paths that differ only in the order of their visits have the
    same value and count once. A second search is for lassos, paths that go out, around a loop, and
    back the way out. A local search then replaces stretches of cells in the paths of both, on one
    way and in stems on both ways together: single cells in all, and longer stretches in the best,
    the longest by label searches of their own.
    A search of width 1 does nothing of this: there is one label for each cell and step, as in the
    paper.

    Parameters
    ----------
    grid : Grid
        Gives the base and who neighbours whom.
    objective : Objective
        Of the robot.
    options : SearchOptions
        Of which the search reads `max_steps`, `max_distance` and `max_visits`.
    width : int
        How many lassos of each cell and step are kept, and of other paths a quarter as many; or
        all if `max_visits` is 1, which leaves no lasso.

    Returns
    -------
    list of Candidate
        Ranked by the exact objective, the best first, then the shortest; `RANKED` or twice `width`
        of those that seemed best, and what became of them. The same belief gives the same paths.

    Raises
    ------
    ValueError
        If the search would take too much memory.

    """
    labels = LabelSearch(grid, objective, options, width)
    closed = labels.closed_paths(max(2 * width, RANKED))
    if width > 1:
        paths = [*closed, *labels.lassos()[:LASSOS]]
        for moves, kept in ROUNDS:
            improved = labels.improved(paths, moves)
            paths = [path for _, path in labels.ranked(improved)[:kept]]
            closed += paths
    return [Candidate(value, labels.reach.cells[path]) for value, path in labels.ranked(closed)]


class LabelSearch:
    """
    A label search; arguments as of `best_paths`.

    Its cells are ranks in `reach`. The kernels say what goes in and comes out.

    """

    def __init__(
        self, grid: Grid, objective: Objective, options: SearchOptions, width: int
    ) -> None:
        max_steps = options.max_steps
        max_visits = min(options.max_visits, max_steps)
        self._sought = objective
        outcomes = objective.outcomes.probability
        self.reach = reach_of(grid, options)
        earlier = objective.outcomes.states
        further = objective.outcomes.states_after(objective.model, max_visits)
        weights = powers_weights(objective.alpha, outcomes)
        powers = weights.size
        check_memory(self.reach, options, width, outcomes.size, earlier, further, powers)
        self.problem = LabelProblem(
            self.reach,
            scattered(self.reach.cells.size, 62 - max_steps.bit_length()),
            gains_of(objective, self.reach.cells, max_visits),
            LabelObjective(weights, outcomes, objective.loss_cost, 10.0**DECIMALS),
        )
        self._hazard = objective.belief.hazard[self.reach.cells]
        self._log_survival = objective.model.log_survival
        self._width = width
        # Lassos visit each cell of their stem twice.
        self._seeks_lassos = width > 1 and max_visits > 1
        self._kept = max(1, width // 4) if self._seeks_lassos else width
        # The values of closed paths, by the marks of their visits.
        self._exact: dict[int, float] = {}
        by_heuristic = self._kept // 2
        completions = np.empty((self.reach.start[-1] if by_heuristic else 0, powers + 5))
        if by_heuristic:
            search(self.problem, 1, 0, completions)
        # Where each label comes from, and the values of those at the base.
        self._origins, self._values = search(self.problem, self._kept, by_heuristic, completions)

    def closed_paths(self, most: int) -> list[NDArray[np.intp]]:
        """Return the paths of the best labels at the base, then the shortest, as ranks."""
        best = np.argsort(-self._values, axis=None, kind='stable')[:most]
        steps, slots = np.divmod(best[self._values.flat[best] > -inf], self._kept)
        paths = np.empty((steps.size, self.reach.within.size), dtype=np.intp)
        trace_closed(self.reach, self._origins, steps, slots, paths)
        return [path[: count + 1] for path, count in zip(paths, steps)]

    def lassos(self) -> list[NDArray[np.intp]]:
        """Return the best lasso for each end of a stem that has one, the best first, as ranks."""
        if not self._seeks_lassos:
            return []
        closed = search_lassos(self.problem, self._width, STEMS)
        return [
            closed.path[end, : closed.steps[end] + 1].astype(np.intp)
            for end in np.argsort(-closed.value, kind='stable')
            if closed.value[end] > -inf
        ]

    def improved(self, paths: Sequence[NDArray[np.intp]], moves: Moves) -> list[NDArray[np.intp]]:
        """Return closed paths with stretches of cells replaced by better ones."""
        padded, steps = self._padded(paths)
        improve_all(self.problem, padded, steps, moves)
        return [path[: count + 1] for path, count in zip(padded, steps)]

    def _padded(
        self, paths: Sequence[NDArray[np.intp]]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return paths as rows of one array, and their steps."""
        steps = np.array([path.size - 1 for path in paths], dtype=np.intp)
        padded = np.zeros((steps.size, self.reach.within.size), dtype=np.intp)
        for row, path in zip(padded, paths):
            row[: path.size] = path
        return padded, steps

    def ranked(self, paths: Sequence[NDArray[np.intp]]) -> list[tuple[float, NDArray[np.intp]]]:
        """Return closed paths and their value, the best first, those of equal visits once."""
        of_visits: dict[int, NDArray[np.intp]] = {}
        for path in paths:
            of_visits.setdefault(int(self.problem.marks[path[1:]].sum()), path)
        new = {each: path for each, path in of_visits.items() if each not in self._exact}
        self._exact.update(zip(new, self.exact([*new.values()])))
        values = [(self._exact[visits], path) for visits, path in of_visits.items()]
        return sorted(values, key=lambda ranked: (-ranked[0], ranked[1].size))

    def exact(self, paths: Sequence[NDArray[np.intp]]) -> list[float]:
        """Return the values of closed paths, without the error of the moments, rounded."""
        if self._sought.alpha != SHANNON:
            return [Candidate.along(self.reach.cells[each], self._sought).value for each in paths]
        values = exact_values(
            self.problem, *self._padded(paths), self._hazard, *self._log_survival
        )
        return [round(value, DECIMALS) for value in values.tolist()]


def check_memory(
    reach: Reach,
    options: SearchOptions,
    width: int,
    outcomes: int,
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
    options : SearchOptions
        As of `best_paths`.
    width : int
        Likewise.
    outcomes, earlier, further : int
        How many outcomes the robots before have, how many numbers of readings of a cell they may
        bring, and how many there are with those of the robot that is planned for.
    powers : int
        How many a label carries.

    Raises
    ------
    ValueError
        With an estimate, if it is more than `MOST_MEMORY`.

    """
    number = 8
    max_steps, max_visits = options.max_steps, options.max_visits
    visits = min(max_visits, max_steps)
    labels, cells = int(reach.start[-1]), reach.cells.size
    factors_and_terms = powers + 1 + 2 * outcomes
    estimate = (
        # Where each label comes from, and the completions if some are kept for their heuristic.
        labels * (4 * width + (number * (powers + 5) if width > 1 else 0))
        # The labels of two steps, with their marks and the visits around.
        + 2 * int(reach.within.max()) * width * (number * (factors_and_terms + 2) + 4 * 9)
        # The lassos of two steps, with their paths.
        + (width > 1)
        * 2
        * cells
        * (width + STEMS)
        * (number * (factors_and_terms + 3) + 4 * (max_steps + 1))
        # The labels of a stretch.
        + (width > 1)
        * max(moves.long for moves, _ in ROUNDS)
        * cells
        * number
        * (factors_and_terms + 5)
        # The gains and the chances of readings, while they are made.
        + 3 * number * cells * visits * factors_and_terms
        + 10 * number * further**2
        # What the robots before bring.
        + 2 * number * outcomes * cells * (earlier + 4)
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
