# SPDX-License-Identifier: Apache-2.0
"""The objective of a planner."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kbnitp_ros.core.field import Belief, Grid, SensorModel
from kbnitp_ros.core.planning.objective.joint_outcomes import (
    after_deployment,
    JointOutcomes,
    nobody_deployed,
)
from kbnitp_ros.core.planning.objective.options import SearchOptions, SHANNON
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
        The cost of its loss, nats, at least 0.
    interest : ndarray, shape (cells,)
        What counts of the information of readings in each cell, in [0, 1].
    outcomes : JointOutcomes
        Of the robots that leave in the same round and whose paths are known.
    alpha : float
        Of the Prelec weight of what is likely and unlikely: 1 for Shannon's entropy, otherwise
        `behavioral_information` is in the place of the information.

    """

    belief: Belief
    model: SensorModel
    loss_cost: float
    interest: NDArray[np.float64]
    outcomes: JointOutcomes
    alpha: float = SHANNON

    @classmethod
    def alone(
        cls, grid: Grid, belief: Belief, model: SensorModel, options: SearchOptions
    ) -> Objective:
        """Return the objective of a robot that goes alone."""
        if belief.cells != grid.cells:
            raise ValueError(f'belief has {belief.cells} cells: the grid has {grid.cells}')
        interest, nobody = np.ones(belief.cells), nobody_deployed(belief)
        return cls(belief, model, options.loss_cost, interest, nobody, options.alpha)

    def after(self, path: NDArray[np.intp]) -> JointOutcomes:
        """Return what may become of the robots once this one takes `path` as well."""
        return after_deployment(self.outcomes, self.model, path)

    def given(self, outcomes: JointOutcomes) -> Objective:
        """Return the objective of the robot if others have left before."""
        return replace(self, outcomes=outcomes)
