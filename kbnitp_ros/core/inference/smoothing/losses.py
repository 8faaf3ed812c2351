# SPDX-License-Identifier: Apache-2.0
"""The paths of lost robots, as a graph of factors and cells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

from kbnitp_ros.core.field import SensorModel, times_log, Visits
from kbnitp_ros.core.inference.smoothing.message_kernels import FactorGraph
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Losses:
    """
    The lost paths of a mission; no array is changed once it is made.

    Attributes
    ----------
    graph : FactorGraph
        Paths with the same visits are copies of one factor; if it is known how well each step
        fits, only those with the same steps that fit as well. Its cells are numbered as they came
        up.
    cells : ndarray of int, shape (cells of the graph,)
        Which cells of the field they are.
    place : ndarray of int, shape (cells of the field,)
        The number of each in the graph; -1 if it is in no lost path.
    count : ndarray of int, shape (entries,)
        How often the path visits the cell.
    checksum : ndarray of int, shape (factors,)
        Of each factor's visits, or steps and `lost_at`, to find equal ones.
    destroyed : ndarray, shape (2,)
        1 - s_z of one visit, of the robots among those lost to which hazards make the most of a
        difference.

    """

    graph: FactorGraph
    cells: NDArray[np.int32]
    place: NDArray[np.int32]
    count: NDArray[np.int32]
    checksum: NDArray[np.uint32]
    destroyed: NDArray[np.float64]

    @classmethod
    def none(cls, cells: int) -> Losses:
        """Return no losses in a field of so many cells."""
        none = np.empty(0, dtype=np.int32)
        graph = FactorGraph(
            first=np.zeros(1, dtype=np.int32),
            longest=0,
            copies=np.empty(0),
            node=none,
            factor=none,
            lost=np.empty((0, 2)),
            first_step=np.zeros(1, dtype=np.int32),
            place=none,
            lost_at=np.empty(0),
            survived=np.empty((0, 2)),
            died=np.empty((0, 2)),
            newest=none,
            older=none,
        )
        place = np.full(cells, -1, dtype=np.int32)
        return cls(graph, none, place, none, np.empty(0, dtype=np.uint32), np.ones(2))

    @property
    def factors(self) -> int:
        """How many different paths there are."""
        return len(self.graph.copies)

    def entries(self, factor: int) -> slice:
        """Return where the entries of a factor are."""
        return slice(int(self.graph.first[factor]), int(self.graph.first[factor + 1]))

    def steps(self, factor: int) -> slice:
        """Return where the steps of a factor are, which it has if `lost_at` is known of it."""
        return slice(int(self.graph.first_step[factor]), int(self.graph.first_step[factor + 1]))

    def with_loss(
        self, path: NDArray[np.intp], model: SensorModel, lost_at: NDArray[np.float64] | None
    ) -> Losses:
        """
        Return the losses and one more.

        Equations :eq:`loss-factor` and :eq:`loss-located`.

        Parameters
        ----------
        path : ndarray of int, shape (steps + 1,)
            The stretch on which the robot was lost.
        model : SensorModel
            Of the robot.
        lost_at : ndarray, shape (steps,)
            How well each step fits; None if all are alike.

        """
        visits = Visits.of(path)
        content = np.stack([visits.cells, visits.counts]).astype(np.int32).tobytes()
        weight = np.empty(0) if lost_at is None else lost_at
        place = visits.of_step[: len(weight)].astype(np.int32)
        content += place.tobytes() + weight.tobytes()
        checksum = crc32(content)
        lost = -np.expm1(times_log(visits.counts[:, None], model.log_survival))
        for factor in np.flatnonzero(self.checksum == checksum).tolist():
            entries, steps = self.entries(factor), self.steps(factor)
            cells = self.cells[self.graph.node[entries]]
            same_visits = (
                np.array_equal([cells, self.count[entries]], [visits.cells, visits.counts])
                and np.array_equal(self.graph.place[steps], place)
                and np.array_equal(self.graph.lost_at[steps], weight)
            )
            if same_visits and np.array_equal(self.graph.lost[entries], lost):
                copies = self.graph.copies.copy()
                copies[factor] += 1.0
                return replace(self, graph=self.graph._replace(copies=copies))
        destroyed = more_informative(self.destroyed, -np.expm1(model.log_survival))
        losses = self._with_factor(visits, lost, checksum)
        graph = losses.graph._replace(
            first_step=appended(self.graph.first_step, [len(self.graph.place) + len(place)]),
            place=appended(self.graph.place, place),
            lost_at=appended(self.graph.lost_at, weight),
            survived=appended(self.graph.survived, np.exp(model.log_survival)[None]),
            died=appended(self.graph.died, -np.expm1(model.log_survival)[None]),
        )
        return replace(losses, graph=graph, destroyed=destroyed)

    def _with_factor(self, visits: Visits, lost: NDArray[np.float64], checksum: int) -> Losses:
        """Return the losses and one that is like none of them."""
        graph, size = self.graph, visits.cells.size
        new = visits.cells[self.place[visits.cells] < 0]
        place = self.place
        if new.size:
            place = place.copy()
            place[new] = len(self.cells) + np.arange(new.size)
        node = place[visits.cells]
        newest = appended(graph.newest, np.full(new.size, -1))
        older = appended(graph.older, newest[node])
        newest[node] = len(graph.node) + np.arange(size)
        return Losses(
            graph=graph._replace(
                first=appended(graph.first, [len(graph.node) + size]),
                longest=max(graph.longest, size),
                copies=appended(graph.copies, [1.0]),
                node=appended(graph.node, node),
                factor=appended(graph.factor, np.full(size, self.factors)),
                lost=appended(graph.lost, lost),
                newest=newest,
                older=older,
            ),
            cells=appended(self.cells, new),
            place=place,
            count=appended(self.count, visits.counts),
            checksum=appended(self.checksum, [checksum]),
            destroyed=self.destroyed,
        )


def more_informative(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """
    Return of two pairs 1 - s_z the one of which a change of hazard changes the mean by more.

    By its part of the mean, which grows with the ratio of the two, whatever the hazard.
    """
    return one if one[1] * other[0] >= other[1] * one[0] else other


def appended(array: NDArray[Any], values: ArrayLike) -> NDArray[Any]:
    """Return a new array with more values, of its type."""
    return np.concatenate([array, np.asarray(values, dtype=array.dtype)])
