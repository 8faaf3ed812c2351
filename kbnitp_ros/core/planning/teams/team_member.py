# SPDX-License-Identifier: Apache-2.0
"""A robot that a path is planned for."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kbnitp_ros.core.field import Belief, RobotType, SensorModel
from kbnitp_ros.core.planning.objective import JointOutcomes, Objective
from kbnitp_ros.core.planning.search import PathFinder


@dataclass(frozen=True, eq=False)
class TeamMember:
    """
    A robot that a path is planned for; those of one type are one and the same.

    Attributes
    ----------
    finder : PathFinder
        With the limits of its path, from its own base.
    objective : Objective
        Of its path, given the robots that have left before the round.

    """

    finder: PathFinder
    objective: Objective

    @classmethod
    def of(
        cls, robot_type: RobotType, finder: PathFinder, belief: Belief, model: SensorModel
    ) -> TeamMember:
        """Return a robot of a type that goes alone, from what those like all others have."""
        own = replace(
            finder,
            grid=finder.grid.at(robot_type.base),
            options=finder.options.of_type(robot_type),
        )
        own_model = robot_type.model(model)
        return cls(own, Objective.alone(own.grid, belief, own_model, own.options))

    def given(self, outcomes: JointOutcomes) -> TeamMember:
        """Return the robot when others have left before."""
        return replace(self, objective=self.objective.given(outcomes))
