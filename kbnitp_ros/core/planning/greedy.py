# SPDX-License-Identifier: Apache-2.0
"""Robot after robot, each for what it adds to those before it."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.planning.labels import DECIMALS
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.planners import PathFinder
import numpy as np
from numpy.typing import NDArray

# The best path may leave too little to the next robot, so several teams grow side by side: as
# many as make this number of robots, and one at least.
ROBOTS_SIDE_BY_SIDE = 16


@dataclass(frozen=True, eq=False)
class Team:
    """
    The robots that have their paths.

    Attributes
    ----------
    worth : float
        Of their paths together, nats.
    paths : tuple of ndarray of int, each of shape (steps + 1,)
        In the order of the robots.
    last : Objective
        What the last of them was planned for; the next one's if there is none.

    """

    worth: float
    paths: tuple[NDArray[np.intp], ...]
    last: Objective

    def grown(self, finder: PathFinder) -> list[Team]:
        """Return the teams with one robot more, on each of the paths found for it."""
        objective = self.last.after(self.paths[-1]) if self.paths else self.last
        return [
            Team(round(self.worth + found.worth, DECIMALS), (*self.paths, found.path), objective)
            for found in finder.paths(objective)
        ]

    def visits(self) -> tuple[tuple[int, ...], ...]:
        """Return the cells that robots visit: what a team is worth depends on nothing else."""
        return tuple(sorted(tuple(sorted(path[1:].tolist())) for path in self.paths))


def allocate(
    finder: PathFinder, objective: Objective, agents: int
) -> tuple[list[NDArray[np.intp]], None]:
    """
    Return paths, each planned given that those before it are taken, returned or lost.

    Several teams grow side by side and the best is returned: the robot after which there is most
    left to find is not always the one that finds most.
    """
    side_by_side = max(1, ROBOTS_SIDE_BY_SIDE // agents)
    teams = [Team(0.0, (), objective)]
    for _ in range(agents):
        grown = [longer for team in teams for longer in team.grown(finder)]
        distinct: dict[tuple[tuple[int, ...], ...], Team] = {}
        for team in sorted(grown, key=lambda team: -team.worth):
            distinct.setdefault(team.visits(), team)
            if len(distinct) == side_by_side:
                break
        teams = list(distinct.values())
    return list(teams[0].paths), None
