# SPDX-License-Identifier: Apache-2.0
"""The goal to know where an area is free of hazards."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from kbnitp_ros.core.decision.decision import check_confidence, DECIMALS, Decision
from kbnitp_ros.core.decision.flights import Flight, flights_over, Situation
from kbnitp_ros.core.decision.hazard_draws import cells_on, Floats, HazardDraws, Path
from kbnitp_ros.core.field import binary_entropy, each_of, Grid, SensorModel, whole_number
from kbnitp_ros.core.planning import Camera, positives
import numpy as np


@dataclass(frozen=True)
class Area:
    """
    Cells that are to be free of hazards.

    A robot flies where its return or loss, and what it then reads of targets, is expected to tell
    most of the hazards of the area, cell by cell.

    Parameters
    ----------
    cells : iterable of int
        Those of the area, at least one.
    confidence : float, optional
        The probability that all are free at which the mission is over, in (0, 1); by default the
        mission goes on.

    Raises
    ------
    ValueError
        If the confidence is out of range or there are no cells.

    """

    name: ClassVar[str] = 'area'

    cells: Iterable[int]
    confidence: float | None = None

    def __post_init__(self) -> None:
        cells = tuple(
            sorted({whole_number('goal', cell, 0) for cell in each_of('cells', self.cells)})
        )
        if not cells:
            raise ValueError('goal is an area without cells: give at least one')
        object.__setattr__(self, 'cells', cells)
        check_confidence(self.confidence)

    def check(self, grid: Grid, max_steps: int) -> None:
        """
        Check that robots can come to all cells from some base, and back.

        Raises
        ------
        ValueError
            If a cell is off the map, on an obstacle, or out of reach.

        """
        cells = cells_on(grid, list(self.cells), 'goal')
        in_reach = [grid.at(base).in_reach(max_steps) for base in sorted(grid.bases)]
        out = cells[~np.any(in_reach, axis=0)[cells]]
        if out.size:
            raise ValueError(
                f'goal has cell {out[0]}, and {out.size - 1} more, that no robot comes back from '
                f'within max_steps = {max_steps}: raise max_steps or choose a smaller area'
            )

    def decide(
        self, grid: Grid, draws: HazardDraws, model: SensorModel, max_steps: int
    ) -> Decision:
        """Return how probably all cells are free, and how many hazards remain in them."""
        return Decision.about(self.name, draws, list(self.cells), self.confidence)

    def flight(self, situation: Situation) -> Flight | None:
        """Return the flight to make next; None if the robot may make none."""
        paths = flights_over(situation, list(self.cells))
        survival = situation.draws.survivals(paths, situation.model)
        allowed = situation.is_allowed(survival)
        if not allowed.any():
            return None
        cells = list(self.cells)
        here = situation.draws.hazardous[:, cells].astype(np.float64)
        visits = np.array(
            [np.bincount(path[1:], minlength=situation.grid.cells) for path in paths]
        )
        gain = expected_certainty(here, survival, situation.outcomes) + expected_from_readings(
            here,
            survival * situation.outcomes.sum(axis=0),
            visits[:, cells],
            situation.belief.joint[cells],
            situation.model,
        )
        best = int(np.argmax(np.where(allowed, np.round(gain, DECIMALS), -np.inf)))
        return Flight(paths[best], max(0.0, float(gain[best])))


def expected_certainty(here: Floats, survival: Floats, outcomes: Floats) -> Floats:
    """
    Return by how much a flight is expected to lower the entropies of some cells, (flights,) nats.

    Equation :eq:`area-value`.
    """

    def entropies(chance: Floats, hazards: Floats) -> Floats:
        given = hazards / np.where(chance > 0.0, chance, 1.0)[:, None]
        left: Floats = chance * binary_entropy(given.clip(0.0, 1.0)).sum(axis=1)
        return left

    gain = np.zeros(len(survival))
    for each in outcomes:
        all_hazards = each @ here
        before = entropies(each.sum(keepdims=True), all_hazards[None])
        back = survival * each
        chance, hazards = back.sum(axis=1), back @ here
        gain += before - entropies(chance, hazards)
        gain -= entropies(each.sum() - chance, all_hazards - hazards)
    return gain


def expected_from_readings(
    here: Floats, returned: Floats, visits: Path, joint: Floats, model: SensorModel
) -> Floats:
    """
    Return by how much readings are expected to lower entropies of cells, (flights,) nats.

    Equation :eq:`area-readings`.
    """
    chance = returned.sum(axis=1)
    hazard = (returned @ here / np.where(chance > 0.0, chance, 1.0)[:, None]).clip(0.0, 1.0)
    of_hazard = joint.sum(axis=2, keepdims=True)
    target = joint / np.where(of_hazard > 0.0, of_hazard, 1.0)
    likelihood = positives(Camera.of(model), int(visits.max(initial=0)))
    information = np.zeros_like(hazard)
    for count in np.unique(visits[visits > 0]).tolist():
        safe, hazardous = np.moveaxis(target @ likelihood[count, : count + 1].T, 1, 0)
        with_hazard = hazard[..., None] * hazardous
        reading = with_hazard + (1.0 - hazard)[..., None] * safe
        given = with_hazard / np.where(reading > 0.0, reading, 1.0)
        left = (reading * binary_entropy(given.clip(0.0, 1.0))).sum(axis=-1)
        information += (visits == count) * (binary_entropy(hazard) - left)
    gain: Floats = chance * information.sum(axis=1)
    return gain
