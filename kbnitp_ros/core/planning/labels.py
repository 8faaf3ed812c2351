# SPDX-License-Identifier: Apache-2.0
"""Label search: extend the best few partial paths of every cell, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from kbnitp_ros.core.field import binary_entropy, Grid, log_predicted_survival
from kbnitp_ros.core.planning.exposures import with_visit, without_cell
from kbnitp_ros.core.planning.information import fate_entropy, new_reading_information
from kbnitp_ros.core.planning.objective import Objective
import numpy as np
from numpy.typing import NDArray

# Values closer than this many decimals (nats) are ties, so rounding never decides for a path.
DECIMALS = 10


@dataclass(frozen=True)
class Labels:
    """
    The partial paths kept after some number of steps: up to `width` for each cell they end in.

    Attributes
    ----------
    value : ndarray, shape (cells, width)
        The objective if the path ended here, nats, best first; -inf where there is no label.
    log_survival : ndarray, shape (fates, cells, width)
        Log of the predicted survival, by what became of the robots before.
    read : ndarray, shape (fates, cells, width)
        Information of the readings if the robot survives, nats.
    exposures : ndarray, shape (cells, width, steps + 1)
        P(c of the steps lead into a hazard).
    path : ndarray of int, shape (cells, width, steps)
        The cells the steps lead to.
    visits : ndarray of int, shape (cells, width, cells)
        Steps into each cell.
    mark : ndarray of uint64, shape (cells, width)
        Equal for labels of equal visits.

    """

    value: NDArray[np.float64]
    log_survival: NDArray[np.float64]
    read: NDArray[np.float64]
    exposures: NDArray[np.float64]
    path: NDArray[np.intp]
    visits: NDArray[np.int16]
    mark: NDArray[np.uint64]

    @classmethod
    def none(cls, fates: int, cells: int, width: int, steps: int) -> Labels:
        """Return room for labels of `steps` steps."""
        return cls(
            value=np.full((cells, width), -np.inf),
            log_survival=np.zeros((fates, cells, width)),
            read=np.zeros((fates, cells, width)),
            exposures=np.zeros((cells, width, steps + 1)),
            path=np.zeros((cells, width, steps), dtype=np.intp),
            visits=np.zeros((cells, width, cells), dtype=np.int16),
            mark=np.zeros((cells, width), dtype=np.uint64),
        )

    @classmethod
    def at(cls, base: int, fates: int, cells: int, width: int) -> Labels:
        """Return the one label of a robot that stands at the base."""
        labels = cls.none(fates, cells, width, steps=0)
        labels.value[base, 0] = 0.0
        labels.exposures[base, 0] = 1.0
        return labels


class Gains:
    """
    What the next visit to each cell adds, by fate, cell and the number of visits before it.

    Attributes
    ----------
    log_survival, read : ndarray, shape (fates, cells, max_visits)
        As of `Labels`.

    """

    def __init__(self, objective: Objective, max_visits: int) -> None:
        cells = np.arange(objective.belief.cells)
        visits = np.arange(max_visits + 1)
        log_survival = np.stack(
            [
                log_predicted_survival(
                    fate.belief.hazard[:, None], visits[None, :], objective.model.log_survival
                )
                for fate in objective.fates
            ]
        )
        read = np.zeros(log_survival.shape)
        for fate, of_fate in zip(objective.fates, read):
            for count in visits[1:]:
                of_fate[:, count] = new_reading_information(fate, objective.model, cells, count)
        with np.errstate(invalid='ignore'):
            # Once nobody survives nothing more can be lost: -inf less -inf adds nothing.
            self.log_survival = np.nan_to_num(np.diff(log_survival), nan=0.0, neginf=-np.inf)
        self.read = np.diff(read) * objective.interest[:, None]


class Found(NamedTuple):
    """
    A closed path that a search found.

    Attributes
    ----------
    worth : float
        The objective, nats, rounded.
    path : ndarray of int, shape (steps + 1,)
        The base first and last.

    """

    worth: float
    path: NDArray[np.intp]


def best_paths(
    grid: Grid, objective: Objective, max_steps: int, width: int, max_visits: int
) -> list[Found]:
    """
    Return the closed paths of most worth that the search finds.

    Labels at the same cell after the same number of steps compete by the objective of their
    partial path, which is exact at every step, repeated visits included, and every second one is
    kept for what it promises: the objective of that path and a good way home together. Paths
    that differ only in the order of their visits are worth the same and count once.

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
        The best first, then the shortest; up to `width` of each number of steps. The same belief
        gives the same paths.

    """
    search = Search(grid, objective, max_steps, max_visits)
    way_home = search.way_home() if width > 1 else None
    found = [
        Found(float(value), np.concatenate([[grid.base], path]))
        for labels in search.steps(width, way_home)
        for value, path in zip(np.round(labels.value[grid.base], DECIMALS), labels.path[grid.base])
        if value > -np.inf
    ]
    return sorted(found, key=lambda path: -path.worth)


@dataclass(frozen=True)
class WayHome:
    """
    A good way home for each number of steps left and each cell to go home from.

    Attributes
    ----------
    cells : ndarray of int, shape (max_steps + 1, cells, max_steps)
        The cells of its steps, in any order; -1 after the last.
    before : ndarray of int, shape (max_steps + 1, cells, max_steps)
        How often it visits each of them before.
    exposures : ndarray, shape (max_steps + 1, cells, max_steps + 1)
        P(c of its steps lead into a hazard).

    """

    cells: NDArray[np.intp]
    before: NDArray[np.intp]
    exposures: NDArray[np.float64]


class Search:
    """All that stays the same while labels are extended; arguments as of `best_paths`."""

    def __init__(self, grid: Grid, objective: Objective, max_steps: int, max_visits: int) -> None:
        self._grid = grid
        self._hazard = objective.belief.hazard
        self._loss_cost = objective.loss_cost
        self._chance = np.array([[fate.probability] for fate in objective.fates])
        self._max_steps = max_steps
        self._max_visits = max_visits
        self._gains = Gains(objective, max_visits)
        self._marks = scattered(grid.cells)
        # By steps in all and exposures; nobody asks for more exposures than steps.
        self._fate_entropy = np.zeros((max_steps + 1, 2 * max_steps + 2))
        for steps in range(1, max_steps + 1):
            self._fate_entropy[steps, : steps + 1] = fate_entropy(objective.model, steps)

    def steps(self, width: int, way_home: WayHome | None = None) -> Iterator[Labels]:
        """
        Yield the labels after each step.

        Parameters
        ----------
        width : int
            How many are kept for each cell.
        way_home : WayHome, optional
            What labels promise; without it they compete by their own worth alone.

        """
        labels = Labels.at(self._grid.base, len(self._chance), self._grid.cells, width)
        for step in range(1, self._max_steps + 1):
            labels = self._extend(labels, step, way_home)
            yield labels

    def way_home(self) -> WayHome:
        """
        Return the ways home that a search of width 1 knows.

        Paths are worth the same in both directions, so a way home is a label at a neighbour,
        walked backwards, and the step into the base.
        """
        cells, base, most = self._grid.cells, self._grid.base, self._max_steps
        table = self._grid.neighbor_table
        way = np.full((most + 1, cells, most), -1)
        before = np.zeros((most + 1, cells, most), dtype=np.intp)
        exposures = np.zeros((most + 1, cells, most + 1))
        exposures[0, :, 0] = 1.0
        best = np.full(cells, -np.inf)
        reached = Labels.at(base, len(self._chance), cells, 1)
        for left, labels in enumerate(self.steps(width=1), start=1):
            for kept in (way, before, exposures):
                kept[left] = kept[left - 1]
            around = np.where(table >= 0, reached.value[table, 0], -np.inf)
            better = np.flatnonzero(around.max(axis=1) > best)
            best[better] = around.max(axis=1)[better]
            via = table[better, around.argmax(axis=1)[better]]
            steps = np.concatenate([reached.path[via, 0], np.full((better.size, 1), base)], axis=1)
            way[left, better, :left] = steps
            earlier = np.tril(np.ones((left, left), dtype=bool), -1)
            before[left, better, :left] = ((steps[:, :, None] == steps[:, None, :]) & earlier).sum(
                axis=-1
            )
            exposures[left, better] = 0.0
            exposures[left, better, :left] = reached.exposures[via, 0]
            reached = labels
        return WayHome(way, before, exposures)

    def _extend(self, labels: Labels, step: int, way_home: WayHome | None) -> Labels:
        """Return the labels after one more step, the `step`-th."""
        cells, width = labels.value.shape
        left = self._max_steps - step
        ends = np.flatnonzero(self._grid.free & (self._grid.steps_to_base <= left))
        # Candidates for each end: every label of every neighbour, shape (ends, 9 * width).
        origin = np.repeat(self._grid.neighbor_table[ends], width, axis=1)
        label = np.tile(np.arange(width), 9)
        possible = (origin >= 0) & (labels.value[origin, label] > -np.inf)
        possible &= labels.visits[origin, label, ends[:, None]] < self._max_visits
        end, candidate = np.nonzero(possible)
        origin, label, to = origin[possible], label[candidate], ends[end]
        visits = labels.visits[origin, label, to].astype(np.intp)

        log_survival = labels.log_survival[:, origin, label]
        log_survival = log_survival + self._gains.log_survival[:, to, visits]
        read = labels.read[:, origin, label] + self._gains.read[:, to, visits]
        left_open = self._left_open(labels, step, origin, label, to, visits)
        value = self._worth(log_survival, left_open, read)
        mark = labels.mark[origin, label] + self._marks[to]
        promise = None
        if way_home is not None:
            promise = self._promise(labels, step, origin, label, to, log_survival, read, way_home)

        chosen, slot = best_of_each(end, value, promise, mark, width)
        origin, label, to = origin[chosen], label[chosen], to[chosen]
        kept = (to, slot)
        after = Labels.none(len(self._chance), cells, width, step)
        after.value[kept] = value[chosen]
        after.log_survival[:, to, slot] = log_survival[:, chosen]
        after.read[:, to, slot] = read[:, chosen]
        after.exposures[kept] = with_visit(
            labels.exposures[origin, label], self._hazard[to], visits[chosen]
        )
        after.path[kept] = np.column_stack([labels.path[origin, label], to])
        after.visits[kept] = labels.visits[origin, label]
        after.visits[to, slot, to] += 1
        after.mark[kept] = mark[chosen]
        return after

    def _promise(
        self,
        labels: Labels,
        step: int,
        origin: NDArray[np.intp],
        label: NDArray[np.intp],
        to: NDArray[np.intp],
        log_survival: NDArray[np.float64],
        read: NDArray[np.float64],
        way_home: WayHome,
    ) -> NDArray[np.float64]:
        """
        Return the objective of each candidate's path and way home together.

        Exact but for the hazards of cells that are on both, whose visits count as those of two
        cells; visits beyond the limit count nothing.
        """
        left = self._max_steps - step
        home = way_home.cells[left, to]
        visits = labels.visits[origin[:, None], label[:, None], home]
        visits = visits + (home == to[:, None]) + way_home.before[left, to]
        counts = (home >= 0) & (visits < self._max_visits)
        visits = np.where(counts, visits, 0)
        log_survival = log_survival + np.sum(
            self._gains.log_survival[:, home, visits], axis=-1, where=counts
        )
        read = read + np.sum(self._gains.read[:, home, visits], axis=-1, where=counts)
        # Mean entropy by exposures so far, the exposures on the way home summed out.
        in_all = step + (way_home.cells[left] >= 0).sum(axis=1)
        exposed = np.arange(step + 1)[:, None] + np.arange(self._max_steps + 1)
        entropy = self._fate_entropy[in_all[:, None, None], exposed]
        mean = (entropy @ way_home.exposures[left][:, :, None])[to, :, 0]
        exposures, hazard = labels.exposures[origin, label], self._hazard[to]
        left_open = (1.0 - hazard) * (exposures * mean[:, :-1]).sum(axis=1)
        left_open += hazard * (exposures * mean[:, 1:]).sum(axis=1)
        return self._worth(log_survival, left_open, read)

    def _left_open(
        self,
        labels: Labels,
        step: int,
        origin: NDArray[np.intp],
        label: NDArray[np.intp],
        to: NDArray[np.intp],
        visits: NDArray[np.intp],
    ) -> NDArray[np.float64]:
        """Return E_z[h(P(survive | z))] of each candidate, shape (candidates,)."""
        entropy = self._fate_entropy[step, : step + 1]
        hazard = self._hazard[to]
        # A first visit needs of each label only its mean without and with one more exposure.
        spared, exposed = labels.exposures @ entropy[:-1], labels.exposures @ entropy[1:]
        left_open = (1.0 - hazard) * spared[origin, label] + hazard * exposed[origin, label]
        for count in np.unique(visits[visits > 0]):
            again = visits == count
            z = hazard[again]
            others = without_cell(labels.exposures[origin[again], label[again]], z, count)
            reach = others.shape[1]
            left_open[again] = (1.0 - z) * (others @ entropy[:reach])
            left_open[again] += z * (others @ entropy[-reach:])
        return left_open

    def _worth(
        self,
        log_survival: NDArray[np.float64],
        left_open: NDArray[np.float64],
        read: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return h(P0) - E_z[h(P(survive | z))] + P0 * read - loss_cost * (1 - P0), over fates."""
        survival = np.exp(log_survival)
        information = np.sum(self._chance * binary_entropy(survival), axis=0) - left_open
        information += np.sum(self._chance * survival * read, axis=0)
        returned = np.sum(self._chance * survival, axis=0)
        worth: NDArray[np.float64] = information - self._loss_cost * (1.0 - returned)
        return worth


def scattered(cells: int) -> NDArray[np.uint64]:
    """Return a mark for each cell whose sums tell apart how often each was visited (splitmix)."""
    x = np.arange(1, cells + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def best_of_each(
    end: NDArray[np.intp],
    value: NDArray[np.float64],
    promise: NDArray[np.float64] | None,
    mark: NDArray[np.uint64],
    width: int,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """
    Return the best `width` candidates of each end, of those that visit the same cells only one.

    Parameters
    ----------
    end : ndarray of int, shape (n,)
        Ascending.
    value : ndarray, shape (n,)
        What the candidates compete by. Ties go to the earlier candidate.
    promise : ndarray, shape (n,), optional
        What they also compete by: in turn with `value`, which comes first.
    mark : ndarray of uint64, shape (n,)
        Equal for candidates that count as the same.
    width : int
        How many of each end at most.

    Returns
    -------
    chosen : ndarray of int, shape (m,)
        Indices of candidates.
    slot : ndarray of int, shape (m,)
        The rank of each among its end's, from 0; the best by value has 0.

    """
    by_visits = np.lexsort((-np.round(value, DECIMALS), mark, end))
    first = np.ones(len(end), dtype=bool)
    first[1:] = (np.diff(mark[by_visits]) != 0) | (np.diff(end[by_visits]) != 0)
    distinct = np.sort(by_visits[first])
    end = end[distinct]
    rank = rank_within(end, -np.round(value[distinct], DECIMALS))
    if promise is not None:
        by_promise = rank_within(end, -np.round(promise[distinct], DECIMALS))
        rank = rank_within(end, np.minimum(2 * rank, 2 * by_promise + 1))
    best = rank < width
    return distinct[best], rank[best]


def rank_within(group: NDArray[np.intp], score: NDArray[np.generic]) -> NDArray[np.intp]:
    """Return each one's rank by ascending `score` among those of its group, from 0, shape (n,)."""
    order = np.lexsort((score, group))
    rank = np.empty(len(group), dtype=np.intp)
    rank[order] = np.arange(len(group)) - np.searchsorted(group, group)
    return rank
