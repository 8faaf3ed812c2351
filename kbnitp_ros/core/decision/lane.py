# SPDX-License-Identifier: Apache-2.0
"""The goal to know of a lane that is free of hazards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from kbnitp_ros.core.decision.decision import (
    check_confidence,
    check_way,
    DECIMALS,
    Decision,
    lanes_within,
    safest_path,
    there_and_back,
)
from kbnitp_ros.core.decision.flights import Flight, flights_over, information, Situation
from kbnitp_ros.core.decision.hazard_draws import Floats, HazardDraws, Path
from kbnitp_ros.core.field import Grid, SensorModel, whole_number
import numpy as np

# How many lanes to the goal are combined, at most: those of any length, and of each of two that
# leave room for longer ones.
OUT, BACK = 12, 4
# What a nat of information on all hazards counts, in probability that the best lane is free: it
# decides where no flight can change which lane is best.
WORTH = 0.02


@dataclass(frozen=True)
class Lane:
    """
    A lane from the base of the mission to a cell.

    A robot flies to the goal on one lane and back on the same or another one: those after which
    the best lane is free with the highest probability, on average over its return and its loss. A
    robot of another base flies to cells of such lanes and back.

    Parameters
    ----------
    to : int
        The cell that it leads to.
    confidence : float, optional
        The probability that it is free of hazards at which the mission is over, in (0, 1); by
        default the mission goes on.

    Raises
    ------
    ValueError
        If the confidence is out of range or the cell is no whole number from 0.

    """

    name: ClassVar[str] = 'lane'

    to: int
    confidence: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'to', whole_number('goal', self.to, 0))
        check_confidence(self.confidence)

    def check(self, grid: Grid, max_steps: int) -> None:
        """
        Check that a lane of so many steps can lead there.

        Raises
        ------
        ValueError
            If the goal is off the map, on an obstacle, the base, or out of reach.

        """
        if self.to == grid.base:
            raise ValueError(f'goal is cell {self.to}, the base: choose another cell')
        check_way(grid, grid.base, self.to, max_steps)

    def decide(
        self, grid: Grid, draws: HazardDraws, model: SensorModel, max_steps: int
    ) -> Decision:
        """Return the safest lane found, and how safe it is; it may take `max_steps` one way."""
        lane = safest_path(grid, draws, model, grid.base, self.to, max_steps)
        return Decision.about(self.name, draws, lane.path, self.confidence, lane)

    def flight(self, situation: Situation) -> Flight | None:
        """Return the flight to make next; None if the robot may make none."""
        lanes, paths = self._flights(situation)
        if not paths:
            return None
        survival = situation.draws.survivals(paths, situation.model)
        allowed = situation.is_allowed(survival)
        if not allowed.any():
            return None
        paths = [path for path, is_allowed in zip(paths, allowed) if is_allowed]
        survival = survival[allowed]
        free = situation.draws.are_free(lanes)
        gain = expected_best(free, survival, situation.outcomes)
        value = gain + WORTH * information(survival, situation.outcomes)
        best = int(np.argmax(np.round(value, DECIMALS)))
        return Flight(paths[best], max(0.0, float(gain[best])))

    def _flights(self, situation: Situation) -> tuple[list[Path], list[Path]]:
        """Return lanes, and closed paths to the goal, or as far as a robot comes back from."""
        grid, draws, options = situation.grid, situation.draws, situation.options
        start, most = situation.start, options.max_steps
        least = int(grid.steps_from(start, grid.free)[self.to])
        if least >= grid.cells:
            return [], []
        half, longest = most // 2, max(least, most)
        if start != grid.base:
            [lanes] = lanes_within(grid, draws, start, self.to, [longest])
            return lanes, flights_over(situation, np.unique(np.concatenate(lanes)).tolist())
        if least > half:
            [lanes] = lanes_within(grid, draws, start, self.to, [longest])
            paths = [there_and_back(lane[: half + 1], lane[: half + 1]) for lane in lanes]
        else:
            limits = longest, most - least, half, least
            lanes, *shorter = lanes_within(grid, draws, start, self.to, limits)
            far, near, nearest = map(partial(best_lanes, draws), shorter, (OUT, BACK, BACK))
            # Whichever of two lanes is taken first, the outcome tells the same.
            paths = [
                there_and_back(out, back)
                for out in far + near
                for back in near + nearest
                if len(out) + len(back) - 2 <= most
            ]
        different = {path.tobytes(): path for path in paths}
        return lanes, [
            path
            for path in different.values()
            if np.bincount(path[1:]).max() <= options.max_visits
        ]


def best_lanes(draws: HazardDraws, lanes: Sequence[Path], count: int) -> list[Path]:
    """Return the lanes that are most probably free, at most so many."""
    p_free = draws.are_free(lanes) @ draws.weight
    best = np.argsort(-np.round(p_free, DECIMALS), kind='stable')[:count]
    return [lanes[lane] for lane in best.tolist()]


def expected_best(free: Floats, survival: Floats, outcomes: Floats) -> Floats:
    """
    Return by how much a flight is expected to raise P(the best lane is free), shape (flights,).

    Equation :eq:`lane-value`.
    """
    gain = np.zeros(len(survival))
    for each in outcomes:
        known = free * each
        before = known.sum(axis=1)
        returned = known @ survival.T
        gain += returned.max(axis=0) + (before[:, None] - returned).max(axis=0) - before.max()
    return gain
