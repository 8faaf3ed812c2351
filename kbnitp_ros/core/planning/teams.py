# SPDX-License-Identifier: Apache-2.0
"""Teams of robots that are planned together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import typed, whole_number
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.sensor import of_each, RobotType, SensorModel
from kbnitp_ros.core.planning.allocations import allocated, ALLOCATIONS, TeamMember, without
from kbnitp_ros.core.planning.objective import (
    after_deployment,
    Camera,
    check_cameras,
    nobody_deployed,
)
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import check_distance, PathFinder
from kbnitp_ros.core.planning.search import check_bounded, Plan, plan_alone
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Team:
    """
    Robots that leave together.

    Parameters
    ----------
    agents : int
        How many, at least 1.
    allocation : str
        One of `ALLOCATIONS`. 'independent': every robot takes the path it would take alone.
        'voronoi': the field is divided into regions of about equal entropy, one a robot.
        'greedy': robot after robot, for what each adds to what those before it are expected to
        bring, returned or lost.
    types : sequence of RobotType
        The type of each robot; empty if all are alike.

    Raises
    ------
    ValueError
        If there is no robot, or not one type for each.

    """

    agents: int = 1
    allocation: str | Callable[..., Any] = 'greedy'
    types: tuple[RobotType, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, 'agents', whole_number('agents', self.agents, 1))
        object.__setattr__(self, 'types', of_each(self.agents, self.types))

    def first(self, robots: int) -> Team:
        """Return the first so many of them, at least 1; all if they are fewer."""
        types = self.types[:robots]
        return replace(self, agents=len(types), types=types)


@typed
def plan_team(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    team: Team,
    options: SearchOptions,
    *,
    in_flight: Sequence[tuple[ArrayLike, RobotType]] = (),
    visited: ArrayLike = (),
    keepout: Sequence[int] | NDArray[np.intp] = (),
    bound: bool = False,
) -> list[Plan]:
    """
    Plan a round: a closed path for each of several robots that leave together.

    Parameters
    ----------
    grid, belief, visited
        As for `plan`.
    model : SensorModel
        What robots that have nothing of their own are believed to be like.
    team : Team
        The robots.
    options : SearchOptions
        Of the search for the path of each robot that has nothing of its own.
    in_flight : sequence of (array_like of int, RobotType)
        The path, shape (steps + 1,), and the type of each robot that has left before and has not
        reported. All allocations but 'independent' plan for what is added to them.
    keepout : sequence of int
        Cells that none of the robots enters, besides those that are blocked.
    bound : bool
        As of `plan`, for one robot while none is in flight.

    Returns
    -------
    list of Plan
        One a robot, in their order: each says what is expected of that robot alone. The same
        belief gives the same plans. A single robot's is that of `plan`.

    Raises
    ------
    ValueError
        As of `plan`; if the allocation is unknown, there are more robots than free cells, a robot
        in flight could not have left that way, a base is none of the grid's, or the robots have
        too many different cameras.

    """
    ALLOCATIONS.find(team.allocation)
    in_use = without(grid, keepout) if len(keepout) else grid
    team_size(in_use, team.agents)
    types = {*team.types, *(robot_type for _, robot_type in in_flight)}
    check_cameras(len({Camera.of(robot_type.model(model)) for robot_type in types}))
    finder = PathFinder(in_use, options, np.asarray(visited))
    for robot_type in dict.fromkeys(team.types):
        check_distance(grid.at(robot_type.base), options.of_type(robot_type))
    if bound:
        for robot_type in team.types:
            check_bounded(in_use.at(robot_type.base), options, len(team.types) + len(in_flight))
    outcomes = nobody_deployed(belief)
    for path, robot_type in in_flight:
        cells = grid.at(robot_type.base).check_path(path)
        outcomes = after_deployment(outcomes, robot_type.model(model), cells)
    members = {
        robot_type: TeamMember.of(robot_type, finder, belief, model).given(outcomes)
        for robot_type in team.types
    }
    if bound:
        (robot,) = members.values()
        return [plan_alone(robot.finder, robot.objective, bound)]
    paths = allocated(team.allocation, [members[each] for each in team.types])
    return [
        Plan.along(path, belief, robot_type.model(model))
        for path, robot_type in zip(paths, team.types)
    ]


def check_team(finder: PathFinder, types: Sequence[RobotType]) -> None:
    """Check that paths of a team can be searched for within the memory allowed."""
    # Of those that have no camera of their own the model is all the same.
    cameras = {(each.true_positive, each.false_positive) for each in types}
    for base, options in dict.fromkeys(
        (each.base, finder.options.of_type(each)) for each in types
    ):
        own = replace(finder, grid=finder.grid.at(base), options=options)
        check_distance(own.grid, options)
        own.check_memory(len(types), len(cameras))


def team_size(grid: Grid, agents: int) -> int:
    """Return how many robots there are if the grid has a free cell for each."""
    free = int(grid.free.sum())
    try:
        return whole_number('agents', agents, 1, free)
    except ValueError as error:
        raise ValueError(f'{error}, one for each free cell at most') from error
