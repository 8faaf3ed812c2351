# SPDX-License-Identifier: Apache-2.0
"""The targets found: how probable each is, and how it was looked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from kbnitp_ros.core.field import Belief, Observation, SensorModel
import numpy as np


class Target(NamedTuple):
    """
    What is known of a target in a cell.

    Attributes
    ----------
    cell : int
        Where it is.
    probability : float
        That there is one, in [0, 1].
    looks : int
        How many readings were taken there by robots that came back.
    found : int
        How many of these reported a target.
    missed : float
        Probability that so many looks all miss a target, in [0, 1]; 1 without any.

    """

    cell: int
    probability: float
    looks: int
    found: int
    missed: float


def targets(
    belief: Belief,
    model: SensorModel,
    observations: Sequence[Observation],
    least: float = 0.0,
) -> list[Target]:
    """
    Return what is known of the target in each cell, the most probable first.

    Equation :eq:`looks-missed`.

    Parameters
    ----------
    belief : Belief
        Given all observations.
    model : SensorModel
        What the sensors are believed to be like.
    observations : sequence of Observation
        Those of all deployments.
    least : float
        Cells with a lower probability are left out, in [0, 1].

    """
    looks, found = np.zeros((2, belief.cells), dtype=np.intp)
    for observation in observations:
        if observation.readings is not None:
            entered, readings = observation.path[1:], np.asarray(observation.readings, dtype=int)
            np.add.at(looks, entered[readings >= 0], 1)
            np.add.at(found, entered[readings == 1], 1)
    missed = (1.0 - model.true_positive) ** looks
    order = np.argsort(-belief.target, kind='stable')
    return [
        Target(
            cell,
            float(belief.target[cell]),
            int(looks[cell]),
            int(found[cell]),
            float(missed[cell]),
        )
        for cell in order.tolist()
        if belief.target[cell] >= least
    ]
