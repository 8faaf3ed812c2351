# SPDX-License-Identifier: Apache-2.0
"""What may have become of robots that are sent but have not reported."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field import (
    as_path,
    Belief,
    log_predicted_survival,
    SensorModel,
    times_log,
    Visits,
)
from kbnitp_ros.core.inference import condition, lost_likelihood
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Each robot doubles the fates; beyond these the least probable are merged.
MOST_FATES = 16

# A fate less likely than this decides nothing, and its numbers would run out of digits.
NEGLIGIBLE = 1e-15


@dataclass(frozen=True, eq=False)
class Fate:
    """
    What became of the robots sent before: who of them returned and who was lost.

    Attributes
    ----------
    probability : float
        Of this fate.
    belief : Belief
        Given who returned and who was lost, but not yet what the returned ones read.
    readings : ndarray, shape (cells, most + 1)
        P(the returned robots bring m readings of the cell) for m = 0 to `most`: certain but where
        several fates are merged.

    """

    probability: float
    belief: Belief
    readings: NDArray[np.float64]


def nobody_sent(belief: Belief) -> tuple[Fate, ...]:
    """Return the only fate of no robots: all is as believed."""
    return (Fate(1.0, belief, np.ones((belief.cells, 1))),)


def after_sending(
    fates: tuple[Fate, ...], model: SensorModel, path: ArrayLike
) -> tuple[Fate, ...]:
    """
    Return the fates once one more robot is sent.

    Each fate splits in two. A return is taken in exactly; of a loss the cells keep their exact
    marginals but not that it ties them together. Of more than `MOST_FATES` the least probable
    become one, each cell their average.

    Parameters
    ----------
    fates : tuple of Fate
        Of the robots before.
    model : SensorModel
        What the robots are believed to be like.
    path : array_like of int, shape (steps + 1,)
        Of the robot, its cells in order.

    Returns
    -------
    tuple of Fate
        Their probabilities sum to 1 but for rounding.

    """
    visits = Visits.of(as_path(path))
    exposed = times_log(visits.counts[:, None], model.log_survival)
    split = []
    for fate in fates:
        hazard = fate.belief.hazard[visits.cells]
        log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival).sum()
        returned = fate.probability * np.exp(log_survival)
        lost = fate.probability * -np.expm1(log_survival)
        readings = np.pad(fate.readings, ((0, 0), (0, visits.counts.max())))
        if lost > NEGLIGIBLE:
            with np.errstate(divide='ignore'):
                log_lost = np.log(lost_likelihood(hazard, model, visits))
            split.append(Fate(lost, _given(fate.belief, visits, log_lost), readings))
        if returned > NEGLIGIBLE:
            more = readings.copy()
            for cell, count in zip(visits.cells, visits.counts):
                more[cell] = np.roll(readings[cell], count)
            split.append(Fate(returned, _given(fate.belief, visits, exposed), more))
    split.sort(key=lambda fate: -fate.probability)
    if len(split) <= MOST_FATES:
        return tuple(split)
    alone = MOST_FATES - 1
    return (*split[:alone], _merged(split[alone:]))


def _given(belief: Belief, visits: Visits, log_likelihood: NDArray[np.float64]) -> Belief:
    """Return the belief given evidence on the hazards of visited cells, log P(evidence | z)."""
    joint = belief.joint.copy()
    joint[visits.cells] = condition(joint[visits.cells], log_likelihood[:, :, None])
    return Belief(joint)


def _merged(fates: list[Fate]) -> Fate:
    """Return one fate for several: the chance of any of them, and in each cell their average."""
    weights = [fate.probability for fate in fates]
    joint = np.average([fate.belief.joint for fate in fates], axis=0, weights=weights)
    readings = np.average([fate.readings for fate in fates], axis=0, weights=weights)
    return Fate(sum(weights), Belief(joint), readings)
