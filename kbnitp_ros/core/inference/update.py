# SPDX-License-Identifier: Apache-2.0
"""The belief after one deployment."""

from __future__ import annotations

from kbnitp_ros.core.field import Belief, Observation, SensorModel, Visits
from kbnitp_ros.core.inference.evidence import (
    check_cells,
    given,
    returned_log_likelihood,
    survived_log_likelihood,
)
from kbnitp_ros.core.inference.methods import ONE_PASS
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
    P(X | Z), which a loss leaves unchanged. Steps it is known to have survived are evidence of
    their own: it was lost in the rest.

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
    check_cells(belief, observation)
    if not ONE_PASS[method].correlated:
        belief = _independent(belief, observation.path[1:])
    if observation.readings is not None:
        visits = Visits.of(observation.path)
        return given(
            belief, visits.cells, returned_log_likelihood(model, visits, observation.readings)
        )
    if observation.steps_survived:
        survived = Visits.of(observation.path[: observation.steps_survived + 1])
        belief = given(
            belief, survived.cells, survived_log_likelihood(model, survived)[:, :, None]
        )
    visits = Visits.of(observation.path[observation.steps_survived :])
    lost = ONE_PASS[method].lost(belief.hazard[visits.cells], model, visits)
    with np.errstate(divide='ignore'):
        return given(belief, visits.cells, np.log(lost)[:, :, None])


def _independent(belief: Belief, cells: NDArray[np.intp]) -> Belief:
    """Return the belief with hazard and target independent in `cells`."""
    joint = belief.joint.copy()
    joint[cells] = Belief(joint[cells]).independent().joint
    return Belief(joint)
