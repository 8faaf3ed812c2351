# SPDX-License-Identifier: Apache-2.0
"""The tally of evidence for the Gibbs chains."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from kbnitp_ros.core.field.observation import Observation, Visits
from kbnitp_ros.core.field.sensor import ORDINARY, RobotType
from kbnitp_ros.core.inference.sampling_kernels import LocatedGraph, LossGraph
import numpy as np
from numpy.typing import NDArray


def none_yet() -> NDArray[np.int32]:
    """Return an empty list of whole numbers."""
    return np.empty(0, np.int32)


@dataclass(frozen=True, eq=False)
class Tally:
    """Immutable evidence of all deployments, with a factor for each loss (:eq:`loss-factor`)."""

    # Number of survived steps, of positive readings and of negative readings, by robot type and
    # cell, shape (types, cells).
    survived: NDArray[np.int32]
    positive: NDArray[np.int32]
    negative: NDArray[np.int32]
    # Robot types so far, reduced to the fields of the sensor model.
    robot_types: tuple[RobotType, ...] = (ORDINARY,)
    # Number of deployments.
    deployments: int = 0
    # Of each loss that is not located: number of steps in which the robot may have been lost, and
    # robot type, shape (losses,).
    steps: NDArray[np.int32] = field(default_factory=none_yet)
    robot_type: NDArray[np.int32] = field(default_factory=none_yet)
    # For each cell of these steps: the cell, the index of its loss, its visits, shape (entries,).
    cell: NDArray[np.int32] = field(default_factory=none_yet)
    path: NDArray[np.int32] = field(default_factory=none_yet)
    visits: NDArray[np.int32] = field(default_factory=none_yet)
    # Number of steps and robot type of each located loss, shape (located losses,).
    located_steps: NDArray[np.int32] = field(default_factory=none_yet)
    located_type: NDArray[np.int32] = field(default_factory=none_yet)
    # Cells of the steps of located losses, one loss after another, shape (steps,).
    step_cell: NDArray[np.int32] = field(default_factory=none_yet)
    # Likelihood of a loss in each step, shape (steps,).
    lost_at: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    @classmethod
    def empty(cls, cells: int) -> Tally:
        """Return the tally before the first deployment."""
        return cls(*np.zeros((3, 1, cells), np.int32))

    def with_deployment(self, observation: Observation, robot_type: RobotType) -> Tally:
        """Return the tally with one more deployment, by a robot of this type."""
        sensors = RobotType(**robot_type.sensors)
        known = self.with_type(sensors)
        of_type, (path, readings) = known.robot_types.index(sensors), observation.evidence
        steps = path[1:]
        tally = replace(known, deployments=self.deployments + 1)
        if readings is not None:
            seen, not_seen = (steps[readings == reading] for reading in (1, 0))
            return replace(
                tally,
                survived=add_steps(known.survived, of_type, steps),
                positive=add_steps(known.positive, of_type, seen),
                negative=add_steps(known.negative, of_type, not_seen),
            )
        alive = observation.steps_survived
        tally = replace(tally, survived=add_steps(known.survived, of_type, steps[:alive]))
        path, lost_at = observation.lost_on
        if lost_at is not None:
            return replace(
                tally,
                located_steps=np.append(self.located_steps, np.int32(lost_at.size)),
                located_type=np.append(self.located_type, np.int32(of_type)),
                step_cell=np.append(self.step_cell, path[1:].astype(np.int32)),
                lost_at=np.append(self.lost_at, lost_at),
            )
        lost = Visits.of(path)
        return replace(
            tally,
            steps=np.append(self.steps, np.int32(path.size - 1)),
            robot_type=np.append(self.robot_type, np.int32(of_type)),
            cell=np.append(self.cell, lost.cells.astype(np.int32)),
            path=np.append(self.path, np.full(lost.cells.size, self.steps.size, np.int32)),
            visits=np.append(self.visits, lost.counts.astype(np.int32)),
        )

    def with_type(self, robot_type: RobotType) -> Tally:
        """Return the tally with a row for a robot type."""
        if robot_type in self.robot_types:
            return self
        survived, positive, negative = (
            np.pad(counts, ((0, 1), (0, 0)))
            for counts in (self.survived, self.positive, self.negative)
        )
        return replace(
            self,
            survived=survived,
            positive=positive,
            negative=negative,
            robot_types=(*self.robot_types, robot_type),
        )

    @property
    def visited(self) -> NDArray[np.bool_]:
        """Return a mask of the cells that a robot was sent into, shape (cells,)."""
        visited: NDArray[np.bool_] = np.any(self.survived > 0, axis=0)
        visited[self.cell] = visited[self.step_cell] = True
        return visited

    @property
    def read(self) -> NDArray[np.bool_]:
        """Return a mask of the cells with readings, shape (cells,)."""
        read: NDArray[np.bool_] = np.any(self.positive + self.negative > 0, axis=0)
        return read

    def within(self, cells: NDArray[np.intp]) -> Tally:
        """Return the tally restricted to `cells`, ascending and including all visited cells."""
        return replace(
            self,
            survived=self.survived[:, cells],
            positive=self.positive[:, cells],
            negative=self.negative[:, cells],
            cell=np.searchsorted(cells, self.cell).astype(np.int32),
            step_cell=np.searchsorted(cells, self.step_cell).astype(np.int32),
        )

    @property
    def first_step(self) -> NDArray[np.int32]:
        """Return the index of each located loss's first step, and the number of all steps."""
        return np.append(0, np.cumsum(self.located_steps)).astype(np.int32)

    def loss_graph(self, possible: NDArray[np.bool_], undecided: NDArray[np.bool_]) -> LossGraph:
        """Index lost paths by possibly hazardous cell, and undecided cells by lost path."""
        held = np.flatnonzero(possible[self.cell])
        by_cell = held[np.argsort(self.cell[held], kind='stable')]
        # Hazards may be swapped along every lost path; paths of located losses come last.
        loss, cell, *_ = self._located_visits()
        path = np.append(self.path, loss + self.steps.size)
        cell = np.append(self.cell, cell)
        movable = undecided[cell]
        return LossGraph(
            group_starts(self.cell[held], self.survived.shape[1]),
            self.path[by_cell],
            self.visits[by_cell],
            group_starts(path[movable], self.steps.size + self.located_steps.size),
            cell[movable],
        )

    def located_graph(self, possible: NDArray[np.bool_]) -> LocatedGraph:
        """Index located losses by cells of possible hazards."""
        loss, cell, first, last = self._located_visits()
        held = np.flatnonzero(possible[cell])
        by_cell = held[np.argsort(cell[held], kind='stable')]
        return LocatedGraph(
            group_starts(cell[held], self.survived.shape[1]),
            loss[by_cell],
            first[by_cell],
            last[by_cell],
            self.first_step,
            self.located_type,
            self.step_cell,
            self.lost_at,
        )

    def _located_visits(self) -> tuple[NDArray[np.int32], ...]:
        """Return pairs of a located loss and a cell, with the first and last step into it."""
        loss = np.repeat(np.arange(self.located_steps.size), self.located_steps)
        order = np.lexsort((self.step_cell, loss))
        loss, cell = loss[order], self.step_cell[order]
        # The sort is stable: steps into the same cell keep their order.
        starts = np.ones(order.size, dtype=bool)
        starts[1:] = (loss[1:] != loss[:-1]) | (cell[1:] != cell[:-1])
        ends = np.append(starts[1:], True)[: order.size]
        columns = loss[starts], cell[starts], order[starts], order[ends]
        return tuple(each.astype(np.int32) for each in columns)


def add_steps(
    counts: NDArray[np.int32], robot_type: int, steps: NDArray[np.intp]
) -> NDArray[np.int32]:
    """Add the steps into each cell by a robot of one type to the counts."""
    more = counts.copy()
    more[robot_type] += np.bincount(steps, minlength=counts.shape[1]).astype(np.int32)
    return more


def group_starts(group: NDArray[np.int32], groups: int) -> NDArray[np.int32]:
    """Return the start of each group of sorted entries, and the end, shape (groups + 1,)."""
    return np.append(0, np.cumsum(np.bincount(group, minlength=groups))).astype(np.int32)
