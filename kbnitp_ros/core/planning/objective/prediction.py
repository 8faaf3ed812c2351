# SPDX-License-Identifier: Apache-2.0
"""The predicted outcome of a deployment, before it is weighed by any entropy."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field import (
    as_path,
    Belief,
    log_predicted_survival,
    SensorModel,
    Visits,
)
from kbnitp_ros.core.planning.objective.information_kernels import exposed, Exposures, Readings
from kbnitp_ros.core.planning.objective.joint_outcomes import JointOutcomes
from kbnitp_ros.core.planning.objective.readings import readings_of
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Prediction:
    """
    The predicted outcome of one deployment, given each joint outcome of the robots before.

    Attributes
    ----------
    visits : Visits
        Of its path.
    joint, earlier : ndarray
        Of the cells visited, as `JointOutcomes.of_cells` returns them: P(Z = z, X = x), and the
        readings of the robots before.
    survival : ndarray, shape (outcomes,)
        The chance that the robot returns.
    readings : Readings
        What its own readings may be.
    exposures : Exposures
        Of its path, the same whatever became of the others.

    """

    visits: Visits
    joint: NDArray[np.float64]
    earlier: NDArray[np.float64]
    survival: NDArray[np.float64]
    readings: Readings
    exposures: Exposures


def predict(
    belief: Belief, model: SensorModel, path: ArrayLike, outcomes: JointOutcomes
) -> Prediction:
    """Predict the outcome of a deployment after those of `outcomes`."""
    cells = as_path(path)
    if cells.min() < 0 or cells.max() >= belief.cells:
        raise ValueError(
            f'path has cells from {cells.min()} to {cells.max()}: '
            f'the belief has the cells 0 to {belief.cells - 1}'
        )
    visits = Visits.of(cells)
    joint, earlier = outcomes.of_cells(visits.cells)
    hazard = joint[:, :, 1].sum(axis=-1).clip(max=1.0)
    log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival)
    return Prediction(
        visits,
        joint,
        earlier,
        np.exp(log_survival.sum(axis=1)),
        readings_of(model, int(visits.counts.max()), outcomes.most_readings),
        exposed(visits.of_step, belief.hazard[visits.cells], *model.log_survival),
    )
