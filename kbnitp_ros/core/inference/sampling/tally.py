# SPDX-License-Identifier: Apache-2.0
"""All evidence of a mission, counted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from kbnitp_ros.core.field import Observation, ORDINARY, RobotType, Visits
from kbnitp_ros.core.inference.sampling.gibbs_kernels import LossGraph
from kbnitp_ros.core.inference.sampling.located_kernels import LocatedGraph
import numpy as np
from numpy.typing import NDArray


def none_yet() -> NDArray[np.int32]:
    """Return an empty list of whole numbers."""
    return np.empty(0, np.int32)


@dataclass(frozen=True, eq=False)
class Tally:
    """The evidence of all deployments, losses as factors (:eq:`loss-factor`); never changed."""

    # Shape (types, cells). Steps of robots of each type into each cell that are known to have been
    # survived, and how many of them brought a reading of a target, and of none.
    survived: NDArray[np.int32]
    positive: NDArray[np.int32]
    negative: NDArray[np.int32]
    # Of the robots so far, by what sets their sensor models apart.
    robot_types: tuple[RobotType, ...] = (ORDINARY,)
    # How many there were.
    deployments: int = 0
    # Shape (losses,). Of each path on which a robot was lost, without those it is known to have
    # survived, and of which type the robot was. Those of which it is known how well each step fits
    # are not among them.
    steps: NDArray[np.int32] = field(default_factory=none_yet)
    robot_type: NDArray[np.int32] = field(default_factory=none_yet)
    # Shape (entries,). Which cell is on which of these paths, and how often it enters it; in the
    # order of paths.
    cell: NDArray[np.int32] = field(default_factory=none_yet)
    path: NDArray[np.int32] = field(default_factory=none_yet)
    visits: NDArray[np.int32] = field(default_factory=none_yet)
    # Shape (located losses,). The same of losses of which that is known.
    located_steps: NDArray[np.int32] = field(default_factory=none_yet)
    located_type: NDArray[np.int32] = field(default_factory=none_yet)
    # Shape (steps,). The cells that the steps of these lead to, one loss after another.
    step_cell: NDArray[np.int32] = field(default_factory=none_yet)
    # Shape (steps,). How well a loss in each step fits what was observed.
    lost_at: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    @classmethod
    def empty(cls, cells: int) -> Tally:
        """Return the tally before the first deployment."""
        return cls(*np.zeros((3, 1, cells), np.int32))

    def with_deployment(self, observation: Observation, robot_type: RobotType) -> Tally:
        """Return the tally with one more deployment, of a robot of this type."""
        sensors = RobotType(**robot_type.sensors)
        known = self.with_type(sensors)
        of_type, steps = known.robot_types.index(sensors), observation.path[1:]
        tally = replace(known, deployments=self.deployments + 1)
        if observation.readings is not None:
            seen, not_seen = (steps[observation.readings == reading] for reading in (1, 0))
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
        """Return the tally with room for a robot type."""
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
        """Which cells some robot was to step into, shape (cells,)."""
        visited: NDArray[np.bool_] = np.any(self.survived > 0, axis=0)
        visited[self.cell] = visited[self.step_cell] = True
        return visited

    @property
    def read(self) -> NDArray[np.bool_]:
        """In which cells a target was looked for, shape (cells,)."""
        read: NDArray[np.bool_] = np.any(self.positive + self.negative > 0, axis=0)
        return read

    def within(self, cells: NDArray[np.intp]) -> Tally:
        """Return the same of cells in ascending order, all that were visited among them."""
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
        """Where the steps of each located loss start, and the end."""
        return np.append(0, np.cumsum(self.located_steps)).astype(np.int32)

    def loss_graph(self, possible: NDArray[np.bool_], undecided: NDArray[np.bool_]) -> LossGraph:
        """Return the lost paths with their cells of possible, and those of undecided, hazards."""
        held = np.flatnonzero(possible[self.cell])
        by_cell = held[np.argsort(self.cell[held], kind='stable')]
        # Hazards may be moved along every lost path, those of located losses last.
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
        """Return the located losses with their cells of possible hazards."""
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
        """Return each located loss with each of its cells, and the first and last step into it."""
        loss = np.repeat(np.arange(self.located_steps.size), self.located_steps)
        order = np.lexsort((self.step_cell, loss))
        loss, cell = loss[order], self.step_cell[order]
        # Sorting keeps the order of steps into the same cell.
        starts = np.ones(order.size, dtype=bool)
        starts[1:] = (loss[1:] != loss[:-1]) | (cell[1:] != cell[:-1])
        ends = np.append(starts[1:], True)[: order.size]
        columns = loss[starts], cell[starts], order[starts], order[ends]
        return tuple(each.astype(np.int32) for each in columns)


def add_steps(
    counts: NDArray[np.int32], robot_type: int, steps: NDArray[np.intp]
) -> NDArray[np.int32]:
    """Return how often each cell was stepped into, with some steps more of one type."""
    more = counts.copy()
    more[robot_type] += np.bincount(steps, minlength=counts.shape[1]).astype(np.int32)
    return more


def group_starts(group: NDArray[np.int32], groups: int) -> NDArray[np.int32]:
    """Return where each group starts among sorted entries, and the end, shape (groups + 1,)."""
    return np.append(0, np.cumsum(np.bincount(group, minlength=groups))).astype(np.int32)
