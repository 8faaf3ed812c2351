# SPDX-License-Identifier: Apache-2.0
"""The belief after one deployment."""

from __future__ import annotations

from kbnitp_ros.core.field import Belief, Observation, SensorModel, Visits
from kbnitp_ros.core.inference.evidence import condition, returned_log_likelihood
from kbnitp_ros.core.inference.methods import ONE_PASS
import numpy as np


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
