# SPDX-License-Identifier: Apache-2.0
"""The sensor model: what a hazard does to a robot and what the target sensor reads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from kbnitp_ros.core.field.check import frozen, probabilities
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class SensorModel:
    """
    Probabilities of the path-based sensor and of the target sensor.

    Parameters
    ----------
    lethality : float
        Chance in [0, 1] that a hazard strikes a robot which steps into its cell.
    malfunction : float
        Chance in [0, 1] that a robot is lost in a step, hazard or not: the path-based sensor's
        false positive.
    false_negative : float
        Chance in [0, 1] that a robot survives a hazard's strike: the path-based sensor's false
        negative.
    true_positive, false_positive : float
        Chances in [0, 1] that the target sensor reads a target where there is one, and where
        there is none.

    Raises
    ------
    ValueError
        If one of them is NaN or outside [0, 1].

    """

    lethality: float
    malfunction: float = 0.05
    false_negative: float = 0.05
    true_positive: float = 0.95
    false_positive: float = 0.05

    def __post_init__(self) -> None:
        probabilities(self)

    def survival(self, hazard: ArrayLike) -> NDArray[np.float64]:
        """
        Return P(step survived | Z), per step.

        Equation :eq:`step-survival`.

        Parameters
        ----------
        hazard : array_like
            Z in {0, 1} or its probability; any shape, which is the result's.

        """
        strike = self.lethality * (1.0 - self.false_negative)
        return (1.0 - self.malfunction) * (1.0 - np.asarray(hazard, dtype=np.float64) * strike)

    def reading(self, target: ArrayLike) -> NDArray[np.float64]:
        """
        Return P(Y = 1 | X), per step.

        Equation :eq:`reading`.

        Parameters
        ----------
        target : array_like
            X in {0, 1} or its probability; any shape, which is the result's.

        """
        present = np.asarray(target, dtype=np.float64)
        return present * self.true_positive + (1.0 - present) * self.false_positive

    @property
    def log_survival(self) -> NDArray[np.float64]:
        """
        Log P(step survived | Z = z) for z = 0, 1, shape (2,), in [-inf, 0].

        Equation :eq:`step-survival`.
        """
        return _log_survival(self.lethality * (1.0 - self.false_negative), self.malfunction)

    @property
    def log_reading(self) -> NDArray[np.float64]:
        """
        Log P(Y = y | X = x), indexed [y, x], shape (2, 2), in [-inf, 0].

        Equation :eq:`reading`.
        """
        return _log_reading(self.true_positive, self.false_positive)


# Each update and each plan asks for these several times.
@lru_cache(maxsize=64)
def _log_survival(strike: float, malfunction: float) -> NDArray[np.float64]:
    with np.errstate(divide='ignore'):
        log_survival: NDArray[np.float64] = np.log1p(-strike * np.arange(2.0))
        log_survival += np.log1p(-malfunction)
    frozen(log_survival)
    return log_survival


@lru_cache(maxsize=64)
def _log_reading(true_positive: float, false_positive: float) -> NDArray[np.float64]:
    positive = SensorModel(0.0, 0.0, 0.0, true_positive, false_positive).reading((0, 1))
    with np.errstate(divide='ignore'):
        log_reading: NDArray[np.float64] = np.log(np.stack([1.0 - positive, positive]))
    frozen(log_reading)
    return log_reading
