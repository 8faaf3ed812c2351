# SPDX-License-Identifier: Apache-2.0
"""How the robots of a team share the field: independent, greedy or in regions."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from kbnitp_ros.core.field import surprisal
from kbnitp_ros.core.planning.objective.candidate import DECIMALS
from kbnitp_ros.core.planning.objective.joint_outcomes import nobody_deployed
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.teams.regions import divide, Regions
from kbnitp_ros.core.planning.teams.team_member import TeamMember
from kbnitp_ros.plugins import Registry, takes
import numpy as np
from numpy.typing import NDArray


def independent(robots: Sequence[TeamMember]) -> tuple[list[NDArray[np.intp]], None]:
    """Return the same path for all of a type: the same belief gives the same plan."""
    nobody = nobody_deployed(robots[0].objective.belief)
    paths = {
        robot: robot.finder.candidates(robot.objective.given(nobody))[0].path
        for robot in dict.fromkeys(robots)
    }
    return [paths[robot] for robot in robots], None


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


def greedy(robots: Sequence[TeamMember]) -> tuple[list[NDArray[np.intp]], None]:
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


# What counts of the readings that a robot brings from the regions of others.
ELSEWHERE = 0.1


def voronoi(robots: Sequence[TeamMember]) -> tuple[list[NDArray[np.intp]], Regions]:
    """
    Return paths that look for information in their own regions.

    The regions share out the joint entropy of the cells that a robot can visit and come back
    from, each among the robots that can. Readings elsewhere count little; where its path leads a
    robot is free, and its return counts for all hazards on the way.
    """
    belief = robots[0].objective.belief
    in_reach = {
        robot: robot.finder.grid.in_reach(
            robot.finder.options.max_steps, robot.finder.options.max_distance
        )
        for robot in dict.fromkeys(robots)
    }
    reach = np.stack([in_reach[robot] for robot in robots], axis=1)
    cells = np.flatnonzero(reach.any(axis=1))
    entropy = surprisal(belief.joint[cells]).sum(axis=(1, 2))
    regions = divide([robot.finder.grid for robot in robots], cells, entropy, reach[cells])
    paths = []
    for number, robot in enumerate(robots):
        interest = np.where(regions.owner == number, 1.0, ELSEWHERE)
        objective = replace(robot.objective, interest=interest)
        paths.append(robot.finder.candidates(objective)[0].path)
    return paths, regions


Allocation = Callable[[Sequence[TeamMember]], tuple[list[NDArray[np.intp]], Regions | None]]


def as_allocation(given: object) -> Allocation:
    """Return an allocation that is to be registered."""
    takes(given, ('robots',))
    return cast(Allocation, given)


ALLOCATIONS = Registry(
    'allocation',
    as_allocation,
    {
        'independent': independent,
        'voronoi': voronoi,
        'greedy': greedy,
    },
)


def allocated(
    allocation: str | Callable[..., Any], robots: Sequence[TeamMember]
) -> tuple[list[NDArray[np.intp]], Regions | None]:
    """Return a path for each robot, and the regions if the allocation divides the field."""
    with ALLOCATIONS.blamed(allocation):
        paths, regions = ALLOCATIONS.find(allocation)(robots)
        if allocation not in ALLOCATIONS.own:
            _check_allocated(allocation, robots, paths, regions)
    return paths, regions


def _check_allocated(
    allocation: str | Callable[..., Any],
    robots: Sequence[TeamMember],
    paths: Sequence[NDArray[np.intp]],
    regions: Regions | None,
) -> None:
    """Refuse what another package's allocation may not return."""
    if len(paths) != len(robots):
        raise ALLOCATIONS.fault(allocation, f'returns {len(paths)} paths for {len(robots)} robots')
    for number, (robot, path) in enumerate(zip(robots, paths)):
        try:
            robot.finder.check_path(path)
        except ValueError as error:
            words = f'returns a path for robot {number} that is none: {error}'
            raise ALLOCATIONS.fault(allocation, words) from error
    cells = robots[0].finder.grid.cells
    if regions is not None and regions.owner.shape != (cells,):
        words = f'divides {regions.owner.size} cells where the field has {cells}'
        raise ALLOCATIONS.fault(allocation, words)
