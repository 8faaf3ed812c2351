# SPDX-License-Identifier: Apache-2.0
"""The belief after one deployment."""

from __future__ import annotations

from kbnitp_ros.core.belief import Belief
from kbnitp_ros.core.methods import ONE_PASS
from kbnitp_ros.core.observation import Observation, Visits
from kbnitp_ros.core.sensor import SensorModel
from kbnitp_ros.core.survival import times_log
import numpy as np
from numpy.typing import NDArray


def update(
    belief: Belief,
    model: SensorModel,
    observation: Observation,
    method: str = 'kappa_bnitp',
) -> Belief:
    """
    Return the belief after one deployment; cells off the path keep their bits.

    A returned robot's cells are updated exactly (arXiv:2305.06929, eq. 6-8). Of a lost robot each
    cell's P(Z) is updated with the method's likelihood of the loss, and X follows through
    P(X | Z), which a loss leaves unchanged.

    Parameters
    ----------
    belief : Belief
        Before the deployment. Methods without kappa take hazard and target for independent.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    observation : Observation
        The deployment's outcome.
    method : str
        A one-pass method.

    Raises
    ------
    ValueError
        If the method is unknown or keeps more state than a belief, the path leaves the belief's
        cells, or the outcome is impossible under the belief.

    """
    if method not in ONE_PASS:
        raise ValueError(
            f'method is {method!r}: known for one deployment are {", ".join(ONE_PASS)}; '
            'kappa_bnitp_smoothed needs them all, in an Estimator'
        )
    beyond = observation.path[observation.path >= belief.cells]
    if beyond.size:
        raise ValueError(
            f'path has the cell {beyond[0]}: the belief has the cells 0 to {belief.cells - 1}'
        )
    visits = Visits.of(observation.path)
    prior = belief.joint[visits.cells]
    if not ONE_PASS[method].correlated:
        prior = Belief(prior).independent().joint
    if observation.readings is not None:
        log_likelihood = returned_log_likelihood(model, visits, observation.readings)
    else:
        lost = ONE_PASS[method].lost(belief.hazard[visits.cells], model, visits)
        with np.errstate(divide='ignore'):
            log_likelihood = np.log(lost)[:, :, None]
    joint = belief.joint.copy()
    joint[visits.cells] = condition(prior, log_likelihood)
    return Belief(joint)


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
