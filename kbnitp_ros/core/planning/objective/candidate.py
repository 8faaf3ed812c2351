# SPDX-License-Identifier: Apache-2.0
"""The candidates that a planner returns."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.planning.objective.information import added_information, path_log_survival
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.objective.options import SHANNON
import numpy as np
from numpy.typing import NDArray

# Values closer than this many decimals (nats) are ties, so rounding never decides for a path.
DECIMALS = 9


class Candidate(NamedTuple):
    """
    A closed path and its objective value.

    Attributes
    ----------
    value : float
        The objective value, nats, rounded.
    path : ndarray of int, shape (steps + 1,)
        The base first and last.

    """

    value: float
    path: NDArray[np.intp]

    @classmethod
    def along(cls, path: NDArray[np.intp], objective: Objective) -> Candidate:
        """
        Return a path, shape (steps + 1,), with its exact value.

        Equation :eq:`objective-value`.
        """
        belief, model = objective.belief, objective.model
        lost = -np.expm1(path_log_survival(belief, model, path))
        alpha = objective.alpha
        interest = None if alpha == SHANNON else objective.interest
        information = added_information(belief, model, path, objective.outcomes, alpha, interest)
        return cls(round(float(information - objective.loss_cost * lost), DECIMALS), path)

    def survival(self, objective: Objective) -> float:
        """Return the chance that the robot returns, by the belief of its objective."""
        return float(np.exp(path_log_survival(objective.belief, objective.model, self.path)))
