# SPDX-License-Identifier: Apache-2.0
"""The running estimate of a mission."""

from __future__ import annotations

from copy import copy

from kbnitp_ros.core.field import Belief, Observation, SensorModel
from kbnitp_ros.core.inference.methods import ONE_PASS
from kbnitp_ros.core.inference.smoothed import Smoother
from kbnitp_ros.core.inference.swept import SweptSmoother
from kbnitp_ros.core.inference.update import update

SMOOTHED = 'kappa_bnitp_smoothed'
METHODS = (*ONE_PASS, SMOOTHED)

# What the smoothed method was and is computed by: a log is replayed by what it was recorded with.
SMOOTHERS = (SweptSmoother, Smoother)


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
    version : int, optional
        Which of the `versions` of the method, from 1; the last unless given.

    Attributes
    ----------
    belief : Belief
        Given all deployments so far.
    version : int
        Of the method.

    Raises
    ------
    ValueError
        If the method or the version is unknown.

    """

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        method: str = 'kappa_bnitp',
        *,
        version: int | None = None,
    ) -> None:
        known = versions(method)
        if version is None:
            version = known[-1]
        elif version not in known:
            raise ValueError(f'version is {version}: {method} has {", ".join(map(str, known))}')
        independent = method in ONE_PASS and not ONE_PASS[method].correlated
        self.belief = belief.independent() if independent else belief
        self.model = model
        self.method = method
        self.version = version
        self._smoother = SMOOTHERS[version - 1](belief, model) if method == SMOOTHED else None

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


def versions(method: str) -> range:
    """
    Return the versions of a method, which give different bits: the last is how it is computed now.

    Earlier ones are there to replay logs that were recorded with them.

    Raises
    ------
    ValueError
        If the method is unknown.

    """
    if method not in METHODS:
        raise ValueError(f'method is {method!r}: known are {", ".join(METHODS)}')
    return range(1, 1 + (len(SMOOTHERS) if method == SMOOTHED else 1))
