# SPDX-License-Identifier: Apache-2.0
"""What a path is worth to a planner."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kbnitp_ros.core.field import Belief, cost, Grid, SensorModel
from kbnitp_ros.core.planning.behavioral import SHANNON
from kbnitp_ros.core.planning.fates import after_sending, Fates, nobody_sent
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Objective:
    """
    The information a path is expected to add, less the cost of the robots it is expected to lose.

    Attributes
    ----------
    belief : Belief
        Before the round.
    model : SensorModel
        What the robot and its sensors are believed to be like.
    loss_cost : float
        What it is worth if it is lost, nats, at least 0.
    interest : ndarray, shape (cells,)
        What counts of the information of readings in each cell, in [0, 1].
    fates : Fates
        Of the robots that leave in the same round and whose paths are known.
    alpha : float
        Of the Prelec weight of what is likely and unlikely: 1 for Shannon's entropy, otherwise
        `behavioral_information` is in the place of the information.

    """

    belief: Belief
    model: SensorModel
    loss_cost: float
    interest: NDArray[np.float64]
    fates: Fates
    alpha: float = SHANNON

    @classmethod
    def alone(
        cls,
        grid: Grid,
        belief: Belief,
        model: SensorModel,
        loss_cost: float,
        alpha: float = SHANNON,
    ) -> Objective:
        """
        Return the objective of a robot that goes alone.

        Raises
        ------
        ValueError
            If the belief has another number of cells than the grid, or `loss_cost` is out of
            range.

        """
        if belief.cells != grid.cells:
            raise ValueError(f'belief has {belief.cells} cells: the grid has {grid.cells}')
        interest = np.ones(belief.cells)
        priced = cost('loss_cost', loss_cost)
        return cls(belief, model, priced, interest, nobody_sent(belief), alpha)

    def after(self, path: NDArray[np.intp]) -> Fates:
        """Return what may become of the robots once this one takes `path` as well."""
        return after_sending(self.fates, self.model, path)

    def given(self, fates: Fates) -> Objective:
        """Return the objective of the robot if others have left before."""
        return replace(self, fates=fates)
