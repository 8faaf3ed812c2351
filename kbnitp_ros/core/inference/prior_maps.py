# SPDX-License-Identifier: Apache-2.0
"""The three maps of a prior, and the offsets of their log odds that give them other averages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import Places
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.inference.filter import NUMBERS, ratio
import numpy as np
from numpy.typing import NDArray

# Bounds of the bisection for offsets of log odds, and its number of steps.
FURTHEST = 1000.0
HALVINGS = 60

# Prior maps whose average may be unknown: P(Z = 1), P(X = 1 | Z = 1) and P(X = 1 | Z = 0).
MAPS = ('hazard_density', 'kappa', 'target_background')


def prior_maps(
    belief: Belief, model: SensorModel, unknown: Sequence[str]
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.bool_]]]:
    """Return `MAPS` by name with their undecided cells; refuse unknowns without effect."""
    if 'lethality' in unknown and model.false_negative == 1.0:
        raise ValueError(
            'lethality is unknown but has no effect: '
            'with a false_negative of 1 every robot survives a strike'
        )
    safe = belief.joint[:, 0].sum(axis=1)
    background = ratio(belief.joint[:, 0, 1], safe).clip(max=1.0)
    maps = {}
    for name, values, where in zip(
        MAPS,
        (belief.hazard, belief.kappa, background),
        (belief.hazard > 0.0, belief.hazard > 0.0, safe > 0.0),
    ):
        maps[name] = values, where & (values > 0.0) & (values < 1.0)
        if name in unknown and not maps[name][1].any():
            raise ValueError(f'{name} is unknown but has no effect: the prior decides every cell')
    return maps


def classes_of_cells(belief: Belief) -> tuple[Places, Places, Places]:
    """Return the first cell of each class of equal priors, the class of each cell, and sizes."""
    joints = belief.joint.reshape(belief.cells, 4)
    _, first, of_cell, sizes = np.unique(
        joints, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    return first, of_cell.ravel(), sizes


def make_joint(
    hazard: NDArray[np.float64], kappa: NDArray[np.float64], background: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the joints, (cells, 2, 2, ...), for the three `MAPS`, each (cells, ...)."""
    safe = 1.0 - hazard
    joint = [safe * (1.0 - background), safe * background, hazard * (1.0 - kappa), hazard * kappa]
    return np.stack(joint, axis=1).reshape(-1, 2, 2, *hazard.shape[1:])


def offsets(
    log_odds: NDArray[np.float64],
    averages: NDArray[np.float64],
    sizes: NDArray[np.intp] | None = None,
) -> NDArray[np.float64]:
    """Return the offset of log odds that gives each average probability (:eq:`prior-offset`)."""
    low, high = np.full_like(averages, -FURTHEST), np.full_like(averages, FURTHEST)
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        mean = np.average(expit(log_odds[:, None] + middle), axis=0, weights=sizes)
        below = mean < averages
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    offset: NDArray[np.float64] = (low + high) / 2.0
    return offset


def with_average(
    probability: NDArray[np.float64],
    undecided: NDArray[np.bool_],
    averages: NDArray[np.float64],
    sizes: NDArray[np.intp] | None = None,
) -> NDArray[np.float64]:
    """
    Shift a map to each of some averages, (cells, averages) (:eq:`prior-offset`).

    With `sizes`, each value is of so many cells.
    """
    shifted = np.repeat(probability[:, None], averages.size, axis=1)
    open_to = probability[undecided]
    if np.ptp(open_to) == 0.0:
        shifted[undecided] = averages
    else:
        odds = np.log(open_to) - np.log1p(-open_to)
        weights = None if sizes is None else sizes[undecided]
        shifted[undecided] = expit(odds[:, None] + offsets(odds, averages, weights))
    return shifted


def told_numbers(belief: Belief, model: SensorModel) -> dict[str, float]:
    """Return the numbers of the sensor model and the averages of the prior's undecided maps."""
    averages = {
        name: float(values[undecided].mean())
        for name, (values, undecided) in prior_maps(belief, model, ()).items()
        if undecided.any()
    }
    return {name: getattr(model, name) for name in NUMBERS} | averages


def with_number(
    belief: Belief, model: SensorModel, name: str, factor: float
) -> tuple[Belief, SensorModel]:
    """Return prior and sensor model with one of `told_numbers` times a factor, at most 1."""
    if name in NUMBERS:
        return belief, replace(model, **{name: min(getattr(model, name) * factor, 1.0)})
    maps = prior_maps(belief, model, ())
    values, undecided = maps[name]
    average = np.array([min(values[undecided].mean() * factor, 1.0)])
    changed = with_average(values, undecided, average)[:, 0]
    joint = make_joint(*(changed if each == name else maps[each][0] for each in MAPS))
    return Belief(joint, belief.grid), model


def expit(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the probability at log odds x."""
    with np.errstate(over='ignore', under='ignore'):
        probability: NDArray[np.float64] = 1.0 / (1.0 + np.exp(-log_odds))
    return probability
