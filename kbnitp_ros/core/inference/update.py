# SPDX-License-Identifier: Apache-2.0
"""The belief after one deployment."""

from __future__ import annotations

from kbnitp_ros.core.field import Belief, Observation, SensorModel
from kbnitp_ros.core.inference.methods import METHODS
from kbnitp_ros.core.inference.one_pass import OnePass


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
    one_pass = {
        name: versions[-1]
        for name, versions in METHODS.items()
        if isinstance(versions[-1], OnePass)
    }
    if method not in one_pass:
        others = [name for name in METHODS if name not in one_pass]
        raise ValueError(
            f'method is {method!r}: known for one deployment are {", ".join(one_pass)}; '
            f'{", ".join(others)} need them all, in an Estimator'
        )
    return one_pass[method].update(belief, model, observation)
