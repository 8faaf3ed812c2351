# SPDX-License-Identifier: Apache-2.0
"""Which used-up hazard explains which loss, of robots that never fail by themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from kbnitp_ros.core.field import Observation, SensorModel
from kbnitp_ros.core.inference.filtering.evidence import loss_weights
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Explanations:
    """A hazard of its own for each loss that no malfunction explains."""

    # Shape (cells,). Where there may be a hazard, and no robot with a lethality of 1 has set it
    # off.
    possible: NDArray[np.bool_]
    # For each of the losses, the cells whose hazard may have caused it.
    allowed: tuple[tuple[int, ...], ...] = ()
    # By its cell, which loss a hazard explains.
    chosen: Mapping[int, int] = field(default_factory=dict)

    def with_deployment(self, observation: Observation, model: SensorModel) -> Explanations:
        """Return the explanations with one more deployment."""
        path = observation.path[1:]
        is_certain = model.lethality == 1.0
        if observation.survived:
            return self._entered(path) if is_certain else self
        if model.malfunction:
            known = path[: observation.steps_survived]
            return self._entered(known) if is_certain else self
        fits = (loss_weights(observation) > 0.0) & self.possible[path]
        if not is_certain:
            return self._explained(tuple(np.unique(path[fits]).tolist()))
        # The first step that explains it leaves most hazards to explain other losses.
        fits[np.setdiff1d(np.arange(path.size), np.unique(path, return_index=True)[1])] = False
        for step in np.flatnonzero(fits).tolist():
            try:
                explained = self._explained((int(path[step]),))
            except ValueError:
                continue
            return explained._entered(path[: step + 1])
        return self._explained(())

    def _entered(self, cells: NDArray[np.intp]) -> Explanations:
        """Return it when robots that set off every hazard entered these cells."""
        possible = self.possible.copy()
        possible[cells] = False
        return replace(self, possible=possible)

    def _explained(self, cells: tuple[int, ...]) -> Explanations:
        """Return it with a loss that a hazard in one of these cells explains."""
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
                f'the loss on a path through {len(cells)} cells that may have a hazard is '
                'impossible: hazards that strike are used up, there is no malfunction, and all of '
                'these explain losses before; allow for it with a malfunction above 0'
            )
        return replace(self, allowed=allowed, chosen=chosen)
