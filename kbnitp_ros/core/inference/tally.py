# SPDX-License-Identifier: Apache-2.0
"""All evidence of a mission, counted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from kbnitp_ros.core.field import Observation, Visits
from kbnitp_ros.core.inference import gibbs
import numpy as np
from numpy.typing import NDArray


def none_yet() -> NDArray[np.int32]:
    """Return an empty list of whole numbers."""
    return np.empty(0, np.int32)


@dataclass(frozen=True, eq=False)
class Tally:
    """
    What all deployments told. No array is changed once it is made.

    Attributes
    ----------
    survived, positive, negative : ndarray of int, shape (cells,)
        Steps into each cell that are known to have been survived, and how many of them brought a
        reading of a target, and of none.
    deployments : int
        How many there were.
    steps : ndarray of int, shape (losses,)
        Of each path on which a robot was lost, without those it is known to have survived.
    cell, path, visits : ndarray of int, shape (entries,)
        Which cell is on which of these paths, and how often it enters it; in the order of paths.

    """

    survived: NDArray[np.int32]
    positive: NDArray[np.int32]
    negative: NDArray[np.int32]
    deployments: int = 0
    steps: NDArray[np.int32] = field(default_factory=none_yet)
    cell: NDArray[np.int32] = field(default_factory=none_yet)
    path: NDArray[np.int32] = field(default_factory=none_yet)
    visits: NDArray[np.int32] = field(default_factory=none_yet)

    @classmethod
    def empty(cls, cells: int) -> Tally:
        """Return the tally before the first deployment."""
        return cls(*np.zeros((3, cells), np.int32))

    def and_one_more(self, observation: Observation) -> Tally:
        """Return the tally with one more deployment."""
        steps = observation.path[1:]
        tally = replace(self, deployments=self.deployments + 1)
        if observation.readings is not None:
            return replace(
                tally,
                survived=plus(self.survived, steps),
                positive=plus(self.positive, steps[observation.readings == 1]),
                negative=plus(self.negative, steps[observation.readings == 0]),
            )
        known = observation.steps_survived
        lost = Visits.of(observation.path[known:])
        return replace(
            tally,
            survived=plus(self.survived, steps[:known]),
            steps=np.append(self.steps, np.int32(steps.size - known)),
            cell=np.append(self.cell, lost.cells.astype(np.int32)),
            path=np.append(self.path, np.full(lost.cells.size, self.steps.size, np.int32)),
            visits=np.append(self.visits, lost.counts.astype(np.int32)),
        )

    @property
    def visited(self) -> NDArray[np.bool_]:
        """Which cells some robot was to step into, shape (cells,)."""
        visited: NDArray[np.bool_] = self.survived > 0
        visited[self.cell] = True
        return visited

    def ties(self, possible: NDArray[np.bool_], undecided: NDArray[np.bool_]) -> gibbs.Ties:
        """Return how lost paths tie the cells of possible, and those of undecided hazards."""
        held = np.flatnonzero(possible[self.cell])
        by_cell = held[np.argsort(self.cell[held], kind='stable')]
        movable = undecided[self.cell]
        return gibbs.Ties(
            starts(self.cell[held], self.survived.size),
            self.path[by_cell],
            self.visits[by_cell],
            starts(self.path[movable], self.steps.size),
            self.cell[movable],
        )


def plus(counts: NDArray[np.int32], steps: NDArray[np.intp]) -> NDArray[np.int32]:
    """Return how often each cell was stepped into, with some steps more."""
    return counts + np.bincount(steps, minlength=counts.size).astype(np.int32)


def starts(group: NDArray[np.int32], groups: int) -> NDArray[np.int32]:
    """Return where each group starts among sorted entries, and the end, shape (groups + 1,)."""
    return np.append(0, np.cumsum(np.bincount(group, minlength=groups))).astype(np.int32)
