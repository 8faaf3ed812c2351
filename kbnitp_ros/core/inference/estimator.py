# SPDX-License-Identifier: Apache-2.0
"""The running estimate of a mission."""

from __future__ import annotations

from copy import copy

from kbnitp_ros.core.field import Belief, Observation, SensorModel
from kbnitp_ros.core.inference.methods import ONE_PASS
from kbnitp_ros.core.inference.smoothed import Smoother
from kbnitp_ros.core.inference.update import update

SMOOTHED = 'kappa_bnitp_smoothed'
METHODS = (*ONE_PASS, SMOOTHED)


class Estimator:
    """
    A belief that takes in one deployment after another.

    Parameters
    ----------
    belief : Belief
        The prior. A method without kappa starts from its hazard and target maps alone.
    model : SensorModel
        What the robots and their sensors are believed to be like.
    method : str
        One of `METHODS`.

    Attributes
    ----------
    belief : Belief
        Given all deployments so far.

    Raises
    ------
    ValueError
        If the method is unknown.

    """

    def __init__(self, belief: Belief, model: SensorModel, method: str = 'kappa_bnitp') -> None:
        if method not in METHODS:
            raise ValueError(f'method is {method!r}: known are {", ".join(METHODS)}')
        independent = method in ONE_PASS and not ONE_PASS[method].correlated
        self.belief = belief.independent() if independent else belief
        self.model = model
        self.method = method
        self._smoother = Smoother(belief, model) if method == SMOOTHED else None

    def assimilate(self, observation: Observation) -> None:
        """
        Take in one deployment.

        Raises
        ------
        ValueError
            If its path leaves the belief's cells or its outcome is impossible under the belief,
            which then stays as it is.

        """
        if self._smoother is not None:
            self.belief = self._smoother.assimilate(observation)
        else:
            self.belief = update(self.belief, self.model, observation, self.method)

    def copy(self) -> Estimator:
        """Return an estimator that goes on by itself from here; it costs next to no memory."""
        other = copy(self)
        other._smoother = copy(self._smoother)
        return other
