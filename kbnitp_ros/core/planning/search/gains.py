# SPDX-License-Identifier: Apache-2.0
"""What the next visit to a cell does to a path."""

from __future__ import annotations

from kbnitp_ros.core.field import log_predicted_survival, SensorModel, times_log
from kbnitp_ros.core.planning.objective import behavioral
from kbnitp_ros.core.planning.objective.information_kernels import Readings
from kbnitp_ros.core.planning.objective.moments import EXPONENTS
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.objective.options import SHANNON
from kbnitp_ros.core.planning.objective.readings import new_information, readings_of
from kbnitp_ros.core.planning.search.label_kernels import Gains
import numpy as np
from numpy.typing import NDArray


def gains_of(objective: Objective, cells: NDArray[np.intp], max_visits: int) -> Gains:
    """
    Return the gains of visits in `cells`, shape (n,).

    The moments are of `EXPONENTS`. With behavioral entropies the powers are those of `behavioral`,
    first of p and then of the survival in each outcome, and all but what is read is in them.
    """
    model, outcomes = objective.model, objective.outcomes
    visits = np.arange(max_visits + 1)
    belief = objective.belief
    hazard = belief.hazard[cells]
    nothing_read = np.eye(1, outcomes.states)
    shape = (outcomes.probability.size, cells.size, visits.size)
    log_survival = np.broadcast_to(
        log_predicted_survival(hazard[:, None], visits, model.log_survival), shape
    ).copy()
    readings = readings_of(model, max_visits, outcomes.most_readings)
    read = np.zeros(shape)
    read[..., 1:] = _read(
        readings, belief.joint[cells], nothing_read.repeat(cells.size, 0), objective.alpha
    )
    here, there = outcomes.places_of(cells)
    if here.size:
        joint = outcomes.joint[:, there]
        log_survival[:, here] = log_predicted_survival(
            joint[:, :, 1].sum(axis=-1).clip(max=1.0)[..., None], visits, model.log_survival
        )
        _, earlier = outcomes.of_cells(cells[here])
        read[:, here, 1:] = _read(readings, joint, earlier, objective.alpha)

    alive = log_survival[..., 1:] > -np.inf
    with np.errstate(invalid='ignore'):
        # Once nobody survives nothing more can be lost.
        log_ratio = np.where(alive, np.diff(log_survival), 0.0)
    added = np.diff(read) * objective.interest[cells, None]
    survival = np.moveaxis(np.exp(log_ratio) * alive, 0, -1)
    if objective.alpha == SHANNON:
        added -= log_ratio
        moment, spread = _moments(hazard, model, visits, EXPONENTS)
        factor = [moment, survival]
    else:
        moment, spread = _moments(hazard, model, visits, behavioral.EXPONENTS)
        spread = np.zeros_like(spread)
        powers = survival[..., None] ** behavioral.EXPONENTS
        factor = [moment, powers.reshape(*survival.shape[:2], -1), survival]
    term = [spread[..., None], np.moveaxis(added, 0, -1)]
    return Gains(*(np.ascontiguousarray(np.concatenate(g, axis=-1)) for g in (factor, term)))


def _read(
    readings: Readings,
    joint: NDArray[np.float64],
    earlier: NDArray[np.float64],
    alpha: float,
) -> NDArray[np.float64]:
    """Return what 1, 2, ... visits read, shape (..., cells, max_visits)."""
    visits = [np.full(joint.shape[-3], count) for count in range(1, len(readings.survival))]
    read = [new_information(readings, joint, earlier, each, alpha) for each in visits]
    return np.stack(read, axis=-1)


def _moments(
    hazard: NDArray[np.float64],
    model: SensorModel,
    visits: NDArray[np.intp],
    exponents: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Return the factors of moments, (cells, max_visits, powers), and the change of spread.

    Equations :eq:`moment-power` and :eq:`moment-log`.
    """
    safe, deadly = 1.0 - hazard[:, None], hazard[:, None]
    log_power = times_log(visits[:, None], model.log_survival)
    power = np.exp(times_log(exponents, log_power[:, :, None]))
    moment = safe[..., None] * power[:, 0] + deadly[..., None] * power[:, 1]
    before = moment[:, :-1]
    ratio = np.divide(moment[:, 1:], before, out=np.zeros_like(before), where=before > 0.0)
    # The first power is p itself.
    p_log_p = times_log(power[:, :, 0], log_power)
    spread = safe * p_log_p[:, 0] + deadly * p_log_p[:, 1]
    mean = moment[..., 0]
    spread = np.divide(spread, mean, out=np.zeros_like(spread), where=mean > 0.0)
    return ratio, np.diff(spread)
