# SPDX-License-Identifier: Apache-2.0
"""A robot that a path is planned for."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kbnitp_ros.core.field import Belief, Kind, SensorModel
from kbnitp_ros.core.planning.behavioral import SHANNON
from kbnitp_ros.core.planning.fates import Fates
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.planners import PathFinder


@dataclass(frozen=True, eq=False)
class Robot:
    """
    A robot that a path is planned for; those of one kind are one and the same.

    Attributes
    ----------
    finder : PathFinder
        Knows how far it can go.
    objective : Objective
        What a path is worth to it, given the robots that have left before the round.

    """

    finder: PathFinder
    objective: Objective

    @classmethod
    def of(
        cls,
        kind: Kind,
        finder: PathFinder,
        belief: Belief,
        model: SensorModel,
        loss_cost: float,
        alpha: float = SHANNON,
    ) -> Robot:
        """Return a robot that goes alone, of a kind, from what those like all others have."""
        own = finder if kind.max_steps is None else replace(finder, max_steps=kind.max_steps)
        cost = loss_cost if kind.loss_cost is None else kind.loss_cost
        return cls(own, Objective.alone(finder.grid, belief, kind.model(model), cost, alpha))

    def given(self, fates: Fates) -> Robot:
        """Return the robot when others have left before."""
        return replace(self, objective=self.objective.given(fates))
