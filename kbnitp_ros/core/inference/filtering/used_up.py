# SPDX-License-Identifier: Apache-2.0
"""What one deployment tells of hazards that are gone once they strike."""

from __future__ import annotations

from kbnitp_ros.core.field import (
    Belief,
    Observation,
    SensorModel,
    sum_of_others,
    times_log,
    Visits,
)
from kbnitp_ros.core.inference.filtering.evidence import (
    check_cells,
    condition,
    IMPOSSIBLE,
    loss_weights,
    read_log_likelihood,
)
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def update_used_up(belief: Belief, model: SensorModel, observation: Observation) -> Belief:
    """
    Return the belief after one deployment in a field whose hazards are used up.

    Equations :eq:`used-up-returned` and :eq:`used-up-lost`.
    """
    cells, before, move = moves(belief, model, observation)
    after = np.einsum('czx,czy->cyx', before, move)
    total = after.sum(axis=(1, 2), keepdims=True)
    if not (total > 0.0).all():
        raise ValueError(IMPOSSIBLE)
    joint = belief.joint.copy()
    joint[cells] = after / total
    return Belief(joint)


def hazards_used_up(belief: Belief, model: SensorModel, observation: Observation) -> Floats:
    """
    Return how probably a deployment used up the hazard of each cell, shape (cells,).

    Equations :eq:`used-up-returned` and :eq:`used-up-lost`: what moves from a hazard before the
    deployment to none after it.

    Parameters
    ----------
    belief : Belief
        Before the deployment; hazards of different cells are taken for independent.
    model : SensorModel
        What the robot is believed to be like.
    observation : Observation
        What came of it.

    Raises
    ------
    ValueError
        If the path leaves the belief's cells or the outcome is impossible.

    """
    cells, before, move = moves(belief, model, observation)
    moved = before.sum(axis=2)[:, :, None] * move
    total = moved.sum(axis=(1, 2))
    if not (total > 0.0).all():
        raise ValueError(IMPOSSIBLE)
    used_up = np.zeros(belief.cells)
    used_up[cells] = moved[:, 1, 0] / total
    return used_up


def moves(
    belief: Belief, model: SensorModel, observation: Observation
) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Return how the hazards on a path move in a deployment."""
    check_cells(belief, observation)
    visits = Visits.of(observation.path)
    before = belief.joint[visits.cells]
    if observation.readings is None:
        weights = loss_weights(observation)
        return (
            visits.cells,
            before,
            lost_transition(belief.hazard[visits.cells], model, visits, weights),
        )
    read = read_log_likelihood(model, visits, observation.readings)
    endures = float(model.malfunction < 1.0)
    move = endures * survived_transition(model, visits.counts)
    return visits.cells, condition(before, read[:, None, :]), move


def survived_transition(model: SensorModel, counts: NDArray[np.intp]) -> Floats:
    """
    Return P(survived n visits, Z after = z' | Z before = z), shape (..., 2, 2) over [z, z'].

    Equation :eq:`used-up-survival`.
    """
    not_set_off = (1.0 - model.lethality) ** counts
    move = np.zeros((*counts.shape, 2, 2))
    move[..., 0, 0] = 1.0
    move[..., 1, 0] = model.false_negative * (1.0 - not_set_off)
    move[..., 1, 1] = not_set_off
    return move


def lost_transition(hazard: Floats, model: SensorModel, visits: Visits, weights: Floats) -> Floats:
    """
    Return the sum over the steps k of w_k P(lost in k, Z after = z' | Z before = z), exactly.

    Equation :eq:`used-up-lost`.
    """
    here = np.arange(visits.of_step.size)
    entered = visits.of_step[:, None] == np.arange(visits.cells.size)
    # Visits to each cell before each step, (steps, n), and what they do to its hazard.
    made = np.concatenate([np.zeros((1, visits.cells.size), np.intp), entered[:-1]]).cumsum(axis=0)
    moved = survived_transition(model, made)
    # In the step itself a robot that is lost has failed, or set the hazard off.
    failed, struck = model.malfunction, model.lethality * (1.0 - model.false_negative)
    lost = np.array([[failed, 0.0], [(1.0 - failed) * struck, failed]])
    own = np.matmul(moved[here, visits.of_step], lost)
    prior = np.stack([1.0 - hazard, hazard], axis=-1)
    with np.errstate(divide='ignore'):
        chance = np.log(np.einsum('nz,knzy->kn', prior, moved))
        chance[here, visits.of_step] = np.log(np.einsum('kz,kzy->k', prior[visits.of_step], own))
        others = sum_of_others(chance)
        others += np.log(weights)[:, None] + times_log(here, np.log1p(-failed))[:, None]
    peak = others.max(initial=-np.inf)
    if peak == -np.inf:
        return np.zeros((visits.cells.size, 2, 2))
    moved[here, visits.of_step] = own
    summed: Floats = np.einsum('kn,knzy->nzy', np.exp(others - peak), moved)
    return summed
