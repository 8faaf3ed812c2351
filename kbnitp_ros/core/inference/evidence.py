# SPDX-License-Identifier: Apache-2.0
"""What evidence says of single cells."""

from __future__ import annotations

from kbnitp_ros.core.field import SensorModel, times_log, Visits
import numpy as np
from numpy.typing import NDArray


def returned_log_likelihood(
    model: SensorModel, visits: Visits, readings: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """
    Return log P(survived, readings | Z = z, X = x) of each visited cell.

    Parameters
    ----------
    model : SensorModel
        What the robot and its sensor are believed to be like.
    visits : Visits
        Of a path that a robot returned from.
    readings : ndarray of bool, shape (steps,)
        Y in each step.

    Returns
    -------
    ndarray, shape (n, 2, 2)
        Indexed [visited cell, z, x]: each visit contributes log s_z + log P(y | x).

    """
    positive = np.bincount(visits.of_step, weights=readings)
    survived = times_log(visits.counts[:, None], model.log_survival)
    read = times_log(positive[:, None], model.log_reading[1])
    read += times_log((visits.counts - positive)[:, None], model.log_reading[0])
    return survived[:, :, None] + read[:, None, :]


def condition(
    joint: NDArray[np.float64], log_likelihood: NDArray[np.float64]
) -> NDArray[np.float64]:
    """
    Return the cells' joints given evidence, normalised.

    Parameters
    ----------
    joint : ndarray, shape (n, 2, 2)
        Before.
    log_likelihood : ndarray, broadcastable to (n, 2, 2)
        Of the evidence, up to a constant for each cell.

    Raises
    ------
    ValueError
        If the evidence is impossible.

    """
    with np.errstate(divide='ignore'):
        log_joint = np.log(joint) + log_likelihood
    peak = log_joint.max(axis=(1, 2), keepdims=True)
    if not np.isfinite(peak).all():
        raise ValueError(
            'the outcome is impossible under this belief and sensor model: '
            'allow for it with probabilities that are not exactly 0 or 1'
        )
    posterior: NDArray[np.float64] = np.exp(log_joint - peak)
    posterior /= posterior.sum(axis=(1, 2), keepdims=True)
    return posterior
