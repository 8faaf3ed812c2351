# SPDX-License-Identifier: Apache-2.0
"""Robot after robot, each for what it adds to those before it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

from kbnitp_ros.core.planning.objective.candidate import DECIMALS
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.teams.team_member import TeamMember
import numpy as np
from numpy.typing import NDArray

# The best path may leave too little to the next robot, so several teams grow side by side: as
# many as make this number of robots, and one at least.
ROBOTS_SIDE_BY_SIDE = 16


@dataclass(frozen=True, eq=False)
class Assigned:
    """
    The first robots of a team, with their paths.

    Attributes
    ----------
    value : float
        Of their paths together, nats.
    paths : tuple of ndarray of int, each of shape (steps + 1,)
        In the order of the robots.
    last : Objective, optional
        What the last of them was planned for; None if there is none.

    """

    value: float = 0.0
    paths: tuple[NDArray[np.intp], ...] = ()
    last: Objective | None = None

    def grown(self, robot: TeamMember) -> list[Assigned]:
        """Return the teams with this robot as well, on each of its candidates."""
        objective = robot.objective
        if self.last is not None:
            objective = objective.given(self.last.after(self.paths[-1]))
        return [
            Assigned(round(self.value + each.value, DECIMALS), (*self.paths, each.path), objective)
            for each in robot.finder.after(self.paths).candidates(objective)
        ]

    def visits(self, robots: Sequence[TeamMember]) -> Hashable:
        """Return which cells robots of each type visit, which determines the value."""
        return tuple(
            sorted(
                (robots.index(robot), *sorted(path[1:].tolist()))
                for robot, path in zip(robots, self.paths)
            )
        )


def allocate(robots: Sequence[TeamMember]) -> tuple[list[NDArray[np.intp]], None]:
    """
    Return paths, each planned given that those before it are taken, returned or lost.

    Several teams grow side by side and the best is returned: the robot after which there is most
    left to find is not always the one that finds most.
    """
    side_by_side = max(1, ROBOTS_SIDE_BY_SIDE // len(robots))
    teams = [Assigned()]
    for robot in robots:
        grown = [longer for team in teams for longer in team.grown(robot)]
        distinct: dict[Hashable, Assigned] = {}
        for team in sorted(grown, key=lambda team: -team.value):
            distinct.setdefault(team.visits(robots), team)
            if len(distinct) == side_by_side:
                break
        teams = list(distinct.values())
    return list(teams[0].paths), None
