# SPDX-License-Identifier: Apache-2.0
"""How far robots can go, and what each step gains."""

from __future__ import annotations

from kbnitp_ros.core.field import Grid, log_predicted_survival, longest, SensorModel, times_log
from kbnitp_ros.core.planning.objective import SearchOptions
from kbnitp_ros.core.planning.objective.information_kernels import Readings
from kbnitp_ros.core.planning.objective.objective import BEHAVIORAL_EXPONENTS, Objective
from kbnitp_ros.core.planning.objective.options import SHANNON
from kbnitp_ros.core.planning.objective.readings import EXPONENTS, new_information, readings_of
from kbnitp_ros.core.planning.search.label_kernels import Gains, Reach
import numpy as np
from numpy.typing import NDArray


def reach_of(grid: Grid, options: SearchOptions) -> Reach:
    """Return the reach of paths within `max_steps` and `max_distance`."""
    max_steps, max_distance = options.max_steps, options.max_distance
    cells = np.flatnonzero(grid.in_reach(max_steps, max_distance))
    distance = grid.steps_to_base[cells]
    order = np.argsort(distance, kind='stable')
    cells = cells[order]
    rank = np.full(grid.cells + 1, -1)
    rank[cells] = np.arange(cells.size)
    step = np.arange(max_steps + 1)
    within = np.searchsorted(distance[order], np.minimum(step, max_steps - step), 'right')
    start = np.append(0, np.cumsum(within))
    neighbors = rank[grid.neighbor_table[cells]]
    if not max_distance:
        # Where no length is allowed for, none is counted.
        lengths, home = np.zeros(9), np.zeros(cells.size)
        return Reach(cells, neighbors, within, start, lengths, home, 0.0)
    return Reach(
        cells,
        neighbors,
        within,
        start,
        grid.step_lengths.copy(),
        grid.distance_to_base[cells],
        longest(max_distance),
    )


def gains_of(objective: Objective, cells: NDArray[np.intp], max_visits: int) -> Gains:
    """
    Return the gains of visits in `cells`, shape (n,).

    The moments are of `EXPONENTS`. With behavioral entropies `BEHAVIORAL_EXPONENTS` are powers,
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
        moment, spread = _moments(hazard, model, visits, BEHAVIORAL_EXPONENTS)
        spread = np.zeros_like(spread)
        powers = survival[..., None] ** BEHAVIORAL_EXPONENTS
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
