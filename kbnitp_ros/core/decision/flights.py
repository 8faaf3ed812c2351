# SPDX-License-Identifier: Apache-2.0
"""The flights that a goal compares, and what each tells of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from kbnitp_ros.core.decision.hazard_draws import Bools, Floats, HazardDraws, Path
from kbnitp_ros.core.field import binary_entropy, Grid, SensorModel
from kbnitp_ros.core.planning import SearchOptions
import numpy as np
from numpy.typing import ArrayLike

# The most outcomes of robots that are out which are told apart: those of the last six.
MOST_OUTCOMES = 64


class Flight(NamedTuple):
    """
    The path of a robot, for a goal.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        The base first and last.
    gain : float
        How much nearer the goal is expected to be once it is known what came of it, in the unit
        of the goal, at least 0.

    """

    path: Path
    gain: float


@dataclass(frozen=True, eq=False)
class Situation:
    """
    What a robot is sent on.

    Attributes
    ----------
    grid : Grid
        The field.
    draws : HazardDraws
        What is known of the hazards.
    model : SensorModel
        What the robot is believed to be like.
    options : SearchOptions
        The limits of its path, and how probably it must survive it.
    outcomes : ndarray, shape (outcomes, draws)
        The probability of each draw together with each outcome of the robots that are out.

    """

    grid: Grid
    draws: HazardDraws
    model: SensorModel
    options: SearchOptions
    outcomes: Floats

    def of_robot(self, model: SensorModel, options: SearchOptions) -> Situation:
        """Return the situation of a robot with a model and limits of its own."""
        return replace(self, model=model, options=options)

    def with_sent(self, path: ArrayLike, model: SensorModel) -> Situation:
        """Return the situation once another robot, of some model, has left on a path."""
        survived = self.draws.fates([path], model)[0]
        outcomes = np.concatenate([self.outcomes * survived, self.outcomes * (1.0 - survived)])
        if len(outcomes) > MOST_OUTCOMES:
            # That of the robot sent first, which alternates, is told apart no longer.
            outcomes = outcomes[0::2] + outcomes[1::2]
        return replace(self, outcomes=outcomes)

    def is_allowed(self, survival: Floats) -> Bools:
        """Return which paths, of these chances (paths, draws), the robot may be sent on."""
        allowed: Bools = survival @ self.draws.weight >= self.options.minimum_survival
        return allowed


def information(survival: Floats, outcomes: Floats) -> Floats:
    """
    Return what the fate of a robot tells of all hazards, nats, for each path, shape (paths,).

    Equation :eq:`fate-information`.

    Parameters
    ----------
    survival : ndarray, shape (paths, draws)
        The chance to survive each path in each draw.
    outcomes : ndarray, shape (outcomes, draws)
        As of `Situation`.

    """
    known = outcomes.sum(axis=1)
    expected = survival @ (outcomes / np.where(known > 0.0, known, 1.0)[:, None]).T
    entropy: Floats = binary_entropy(expected.clip(0.0, 1.0)) @ known
    left: Floats = binary_entropy(survival.clip(0.0, 1.0)) @ outcomes.sum(axis=0)
    return np.maximum(entropy - left, 0.0)
