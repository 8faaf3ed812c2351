# SPDX-License-Identifier: Apache-2.0
"""What a planner finds."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.planning.behavioral import behavioral_information, SHANNON
from kbnitp_ros.core.planning.information import added_information, path_log_survival
from kbnitp_ros.core.planning.objective import Objective
import numpy as np
from numpy.typing import NDArray

# Values closer than this many decimals (nats) are ties, so rounding never decides for a path.
DECIMALS = 9


class Found(NamedTuple):
    """
    A closed path that a planner found.

    Attributes
    ----------
    worth : float
        The objective, nats, rounded.
    path : ndarray of int, shape (steps + 1,)
        The base first and last.

    """

    worth: float
    path: NDArray[np.intp]

    @classmethod
    def along(cls, path: NDArray[np.intp], objective: Objective) -> Found:
        """Return a path, shape (steps + 1,), with its exact worth."""
        belief, model = objective.belief, objective.model
        lost = -np.expm1(path_log_survival(belief, model, path))
        if objective.alpha == SHANNON:
            information = added_information(belief, model, path, objective.fates)
        else:
            information = behavioral_information(
                belief, model, path, objective.alpha, objective.fates, objective.interest
            )
        return cls(round(float(information - objective.loss_cost * lost), DECIMALS), path)
