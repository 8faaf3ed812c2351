# SPDX-License-Identifier: Apache-2.0
"""What a deployment along a path may bring, before it is weighed by any entropy."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field import (
    as_path,
    Belief,
    log_predicted_survival,
    SensorModel,
    Visits,
)
from kbnitp_ros.core.planning.fates import Fates
from kbnitp_ros.core.planning.information_kernels import exposed
from kbnitp_ros.core.planning.readings import Readings
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Outlook:
    """
    The chances of one deployment, after each fate of the robots before.

    Attributes
    ----------
    visits : Visits
        Of its path.
    joint, earlier : ndarray
        Of the cells visited, as `Fates.of_cells` returns them: P(Z = z, X = x), and the readings
        of the robots before.
    survival : ndarray, shape (fates,)
        The chance that the robot returns.
    readings : Readings
        What its own readings may be.
    exposures : tuple of ndarray
        How often it may be exposed to hazards, and the log of the chance to survive that, as
        `exposed` returns them: the same whatever became of the others.

    """

    visits: Visits
    joint: NDArray[np.float64]
    earlier: NDArray[np.float64]
    survival: NDArray[np.float64]
    readings: Readings
    exposures: tuple[NDArray[np.float64], NDArray[np.float64]]


def look_ahead(belief: Belief, model: SensorModel, path: ArrayLike, fates: Fates) -> Outlook:
    """
    Return what a deployment may bring.

    Parameters
    ----------
    belief : Belief
        Before all deployments.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    path : array_like of int, shape (steps + 1,)
        The cells in order.
    fates : Fates
        Of the robots before.

    Raises
    ------
    ValueError
        If the path has no step or leaves the belief's cells.

    """
    cells = as_path(path)
    if cells.min() < 0 or cells.max() >= belief.cells:
        raise ValueError(
            f'path has cells from {cells.min()} to {cells.max()}: '
            f'the belief has the cells 0 to {belief.cells - 1}'
        )
    visits = Visits.of(cells)
    joint, earlier = fates.of_cells(visits.cells)
    hazard = joint[:, :, 1].sum(axis=-1).clip(max=1.0)
    log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival)
    return Outlook(
        visits,
        joint,
        earlier,
        np.exp(log_survival.sum(axis=1)),
        Readings.of(model, int(visits.counts.max()), fates.most_readings),
        exposed(visits.of_step, belief.hazard[visits.cells], *model.log_survival),
    )
