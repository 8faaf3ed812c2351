# SPDX-License-Identifier: Apache-2.0
"""The three sums over cells that the bound of a path depends on."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.field import Belief, log_predicted_survival, SensorModel, times_log
from kbnitp_ros.core.planning.objective.readings import new_information, readings_of
import numpy as np
from numpy.typing import NDArray


class VisitSums(NamedTuple):
    """
    What each cell adds to the sums of equation :eq:`bound-path`, by the number of its visits.

    Attributes
    ----------
    added : ndarray, shape (cells, max_visits + 1, 3)
        W, r and r2 of n visits, indexed [cell, n, sum]; 0 where n visits cannot be survived.
    survivable : ndarray of int, shape (cells,)
        The most visits to each cell that can be survived, up to `max_visits`.

    """

    added: NDArray[np.float64]
    survivable: NDArray[np.intp]

    @classmethod
    def of(
        cls, belief: Belief, model: SensorModel, cells: NDArray[np.intp], max_visits: int
    ) -> VisitSums:
        """
        Return the sums in `cells`, shape (n,).

        Equation :eq:`bound-terms`.
        """
        visits = np.arange(max_visits + 1)
        hazard = belief.hazard[cells, None]
        log_mean = log_predicted_survival(hazard, visits, model.log_survival)
        log_square = log_predicted_survival(hazard, 2 * visits, model.log_survival)
        alive = log_mean > -np.inf
        log_power = times_log(visits[:, None], model.log_survival)
        p_log_p = times_log(np.exp(log_power), log_power)
        spread = (1.0 - hazard) * p_log_p[:, 0] + hazard * p_log_p[:, 1]
        w = np.divide(spread, np.exp(log_mean), out=np.zeros_like(spread), where=alive)
        readings = readings_of(model, max_visits, ())
        nothing_read = np.ones((cells.size, 1))
        for n in visits[1:]:
            count = np.full(cells.size, n)
            w[:, n] += new_information(readings, belief.joint[cells], nothing_read, count)
        added = np.stack([w, -log_mean, -log_square], axis=-1)
        return cls(np.where(alive[..., None], added, 0.0), alive.sum(axis=1) - 1)
