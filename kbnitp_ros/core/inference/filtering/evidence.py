# SPDX-License-Identifier: Apache-2.0
"""What evidence says of single cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

from kbnitp_ros.core.field import (
    Belief,
    Dynamics,
    joint_after_change,
    joint_after_moves,
    neighbors_to_move_to,
    Observation,
    Rates,
    SensorModel,
    times_log,
    Visits,
)
import numpy as np
from numpy.typing import NDArray

# What is said of evidence that cannot be.
IMPOSSIBLE = (
    'the outcome is impossible under this belief and sensor model: '
    'allow for it with probabilities that are not exactly 0 or 1'
)


def check_cells(belief: Belief, observation: Observation) -> None:
    """Check that a path lies in the field that a belief is of."""
    beyond = observation.path[observation.path >= belief.cells]
    if beyond.size:
        raise ValueError(
            f'path has the cell {beyond[0]}: the belief has the cells 0 to {belief.cells - 1}'
        )


def survived_log_likelihood(model: SensorModel, visits: Visits) -> NDArray[np.float64]:
    """
    Return log P(survived the visits | Z = z) of each visited cell, shape (n, 2).

    Equation :eq:`loss-contact`.
    """
    return times_log(visits.counts[:, None], model.log_survival)


def returned_log_likelihood(
    model: SensorModel, visits: Visits, readings: NDArray[np.bool_] | NDArray[np.int8]
) -> NDArray[np.float64]:
    """Return log P(survived, readings | Z = z, X = x) of each visited cell (:eq:`returned`)."""
    survived = survived_log_likelihood(model, visits)
    return survived[:, :, None] + read_log_likelihood(model, visits, readings)[:, None, :]


def read_log_likelihood(
    model: SensorModel, visits: Visits, readings: NDArray[np.bool_] | NDArray[np.int8]
) -> NDArray[np.float64]:
    """Return log P(readings | X = x) of each visited cell, shape (n, 2) (:eq:`returned`)."""
    positive = np.bincount(visits.of_step, weights=readings == 1)
    negative = np.bincount(visits.of_step, weights=readings == 0)
    read = times_log(positive[:, None], model.log_reading[1])
    read += times_log(negative[:, None], model.log_reading[0])
    return read


def loss_weights(observation: Observation) -> NDArray[np.float64]:
    """Return how well what is known of a loss fits each step of the path, shape (steps,)."""
    if observation.lost_at is not None:
        return observation.lost_at
    weights = np.ones(observation.steps)
    weights[: observation.steps_survived] = 0.0
    return weights


def given(belief: Belief, cells: NDArray[np.intp], log_likelihood: NDArray[np.float64]) -> Belief:
    """Return the belief given evidence on some cells; the others keep their bits."""
    joint = belief.joint.copy()
    joint[cells] = condition(joint[cells], log_likelihood)
    return Belief(joint)


def condition(
    joint: NDArray[np.float64], log_likelihood: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the cells' joints given evidence, normalised (:eq:`returned`)."""
    with np.errstate(divide='ignore'):
        log_joint = np.log(joint) + log_likelihood
    peak = log_joint.max(axis=(1, 2), keepdims=True)
    if not np.isfinite(peak).all():
        raise ValueError(IMPOSSIBLE)
    posterior: NDArray[np.float64] = np.exp(log_joint - peak)
    posterior /= posterior.sum(axis=(1, 2), keepdims=True)
    return posterior


def change_of(
    prior: Belief, dynamics: Dynamics, rates: Mapping[str, Rates] = MappingProxyType({})
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the change of joints, (cells, 2, 2, ...), between deployments, at rates by case."""
    possible = prior.hazard > 0.0
    appear, vanish, move = (
        rates.get(name, getattr(dynamics, name)) for name in ('appear', 'vanish', 'move')
    )
    if dynamics.effect == 'changing':
        return partial(joint_after_change, possible=possible, appear=appear, vanish=vanish)
    if dynamics.effect == 'moving':
        if prior.grid is None:
            raise ValueError(
                'hazards are moving, and the prior has no grid for them to move on: make it with '
                'Belief.prior(grid, ...) or belief.on(grid)'
            )
        neighbors = neighbors_to_move_to(prior.grid, possible)
        return partial(joint_after_moves, neighbors=neighbors, move=move)
    return lambda joint: joint
