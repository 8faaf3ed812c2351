# SPDX-License-Identifier: Apache-2.0
"""Explanations of losses by hazards that are used up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.inference.filter import Evidence
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Explanations:
    """A different hazard for each loss that no malfunction explains."""

    # Cells that may have a hazard, and that no robot with a lethality of 1 has entered, shape
    # (cells,).
    possible: NDArray[np.bool_]
    # For each loss, the cells whose hazard may have caused it.
    allowed: tuple[tuple[int, ...], ...] = ()
    # The loss assigned to the hazard of each cell.
    chosen: Mapping[int, int] = field(default_factory=dict)

    def with_deployment(self, evidence: Evidence, model: SensorModel) -> Explanations:
        """Return the explanations with one more deployment."""
        path = evidence.visits.cells[evidence.visits.of_step]
        is_certain = model.lethality == 1.0
        if not evidence.is_lost:
            return self._entered(path) if is_certain else self
        if model.malfunction:
            known = path[: evidence.first]
            return self._entered(known) if is_certain else self
        fits = (evidence.lost_in > 0.0) & self.possible[path]
        if not is_certain:
            return self._explained(tuple(np.unique(path[fits]).tolist()))
        # The earliest possible step leaves the most hazards to explain other losses.
        fits[np.setdiff1d(np.arange(path.size), np.unique(path, return_index=True)[1])] = False
        for step in np.flatnonzero(fits).tolist():
            try:
                explained = self._explained((int(path[step]),))
            except ValueError:
                continue
            return explained._entered(path[: step + 1])
        return self._explained(())

    def _entered(self, cells: NDArray[np.intp]) -> Explanations:
        """Return the explanations after a robot with a lethality of 1 has entered these cells."""
        possible = self.possible.copy()
        possible[cells] = False
        return replace(self, possible=possible)

    def _explained(self, cells: tuple[int, ...]) -> Explanations:
        """Return the explanations with one more loss, due to a hazard in one of these cells."""
        allowed, chosen = (*self.allowed, cells), dict(self.chosen)
        seen: set[int] = set()

        def finds_cell(loss: int) -> bool:
            for cell in allowed[loss]:
                if cell not in seen:
                    seen.add(cell)
                    if cell not in chosen or finds_cell(chosen[cell]):
                        chosen[cell] = loss
                        return True
            return False

        if not finds_cell(len(self.allowed)):
            raise ValueError(
                'the loss is impossible: with a malfunction of 0 each loss uses up another '
                'hazard, and no cell of this path is left for one; set malfunction above 0 to '
                'allow the loss'
            )
        return replace(self, allowed=allowed, chosen=chosen)
