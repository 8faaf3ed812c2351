# SPDX-License-Identifier: Apache-2.0
"""The plans of a round: a path for each robot of a team, with its expected results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite
from typing import Any

from kbnitp_ros.core.field.belief import Belief, surprisal
from kbnitp_ros.core.field.check import (
    as_array,
    in_short,
    listed,
    number,
    Places,
    probability,
    read_only,
    typed,
    Value,
    whole_number,
)
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import as_path
from kbnitp_ros.core.field.sensor import of_each, RobotType, SensorModel
from kbnitp_ros.core.planning.objective import (
    after_deployment,
    camera_rates,
    check_cameras,
    check_paths,
    JointOutcomes,
    nobody_deployed,
    Objective,
    team_information,
)
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import check_distance, PathFinder
from kbnitp_ros.core.planning.regions import divide
from kbnitp_ros.plugins import Registry, takes
import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Value):
    """
    A path for one robot, with its expected results.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        Cells, the base first and last.
    information : float
        `path_information`, nats.
    survival : float
        Predicted chance that the robot returns, in [0, 1].
    gain : float or None
        Expected progress of the mission towards its goal, in the unit of the goal; None without a
        goal.

    """

    path: Places
    information: float
    survival: float
    gain: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'path', read_only(as_path(self.path)))
        number('information', self.information, 'finite', isfinite)
        probability('survival', self.survival)
        if self.gain is not None:
            number('gain', self.gain, 'finite', isfinite)

    @classmethod
    @typed
    def along(cls, path: ArrayLike, belief: Belief, model: SensorModel) -> Plan:
        """Return the plan of `path`, shape (steps + 1,)."""
        cells = as_path(path)
        check_paths(belief, cells, np.array([0, cells.size]), 'path')
        return cls.alone(cells, Objective.of(belief, model))

    @classmethod
    def alone(cls, path: ArrayLike, objective: Objective) -> Plan:
        """Return the plan of `path` for a robot alone."""
        information, survival = objective.alone().evaluate(path)
        return cls(as_path(path), information, float(survival[0]))


@typed
def plan(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    options: SearchOptions = SearchOptions(),
    *,
    visited: ArrayLike = (),
    rng: np.random.Generator | None = None,
) -> Plan:
    """
    Plan the next deployment: a closed path of high expected information.

    The planner maximises information - loss_cost * (1 - survival); 'relaxed' is calculateBNPath
    (arXiv:2305.06929, Algorithm 1, line 3).

    Parameters
    ----------
    grid, belief, model, options, visited, rng
        As for `plan_team`.

    Returns
    -------
    Plan
        Equal beliefs and visits give equal plans.

    Raises
    ------
    NoPathError, ValueError
        As in `plan_team`.

    """
    (found,) = plan_team(grid, belief, model, Team(), options, visited=visited, rng=rng)
    return found


@dataclass(frozen=True, eq=False)
class TeamMember:
    """A robot to plan for; one instance serves all robots of its type."""

    # Finder of the robot's paths, with the limits and the base of its type.
    finder: PathFinder
    # Objective of the robot's path, given the robots sent before the round.
    objective: Objective

    @classmethod
    def of(
        cls,
        robot_type: RobotType,
        finder: PathFinder,
        belief: Belief,
        model: SensorModel,
        outcomes: JointOutcomes | None = None,
    ) -> TeamMember:
        """Return a robot of a type, given the finder and the model of the common type."""
        own = finder.of_type(robot_type)
        return cls(own, Objective.of(belief, robot_type.model(model), own.options, outcomes))


def independent(robots: Sequence[TeamMember]) -> list[Places]:
    """Return the path that each robot would take alone, the same for robots of equal type."""
    nobody = nobody_deployed(robots[0].objective.belief)
    paths = {
        robot: robot.finder.candidates(replace(robot.objective, outcomes=nobody))[0].path
        for robot in dict.fromkeys(robots)
    }
    return [paths[robot] for robot in robots]


def greedy(robots: Sequence[TeamMember]) -> list[Places]:
    """Return paths, each planned given the joint outcomes of the paths before it."""
    first, *others = robots
    objective = first.objective
    paths = [first.finder.candidates(objective)[0].path]
    for robot in others:
        objective = replace(robot.objective, outcomes=objective.after(paths[-1]))
        paths.append(robot.finder.after(paths).candidates(objective)[0].path)
    return paths


# Weight of a robot's readings outside its own region.
ELSEWHERE = 0.1


def divided(robots: Sequence[TeamMember]) -> Places:
    """Divide the field into regions of about equal entropy; return each cell's robot or -1."""
    belief = robots[0].objective.belief
    searches = [(robot.finder.grid, robot.finder.options) for robot in robots]
    in_reach = [grid.in_reach(each.max_steps, each.max_distance) for grid, each in searches]
    reach = np.stack(in_reach, axis=1)
    cells = np.flatnonzero(reach.any(axis=1))
    entropy = surprisal(belief.joint[cells]).sum(axis=(1, 2))
    return divide([grid for grid, _ in searches], cells, entropy, reach[cells])


def voronoi(robots: Sequence[TeamMember]) -> list[Places]:
    """Return paths, each planned for information in its robot's region."""
    owner, paths = divided(robots), []
    for place, robot in enumerate(robots):
        interest = np.where(owner == place, 1.0, ELSEWHERE)
        objective = replace(robot.objective, interest=interest)
        paths.append(robot.finder.candidates(objective)[0].path)
    return paths


Allocation = Callable[[Sequence[TeamMember]], list[Places]]


ALLOCATIONS: Registry[Allocation] = Registry(
    'allocation',
    partial(takes, arguments=('robots',)),
    {
        'independent': independent,
        'voronoi': voronoi,
        'greedy': greedy,
    },
)


def allocated(allocation: str | Callable[..., Any], robots: Sequence[TeamMember]) -> list[Places]:
    """Return a path for each robot, checked against the rules of allocations."""
    allocate = ALLOCATIONS.find(allocation)
    if allocation in ALLOCATIONS.own:
        return allocate(robots)
    with ALLOCATIONS.blamed(allocation):
        paths = allocate(robots)
        if len(paths) != len(robots):
            words = f'returns {len(paths)} paths for {len(robots)} robots'
            raise ALLOCATIONS.fault(allocation, words)
        for place, (robot, path) in enumerate(zip(robots, paths)):
            try:
                robot.finder.check_path(path)
            except ValueError as error:
                words = f'returns an invalid path for robot {place}: {error}'
                raise ALLOCATIONS.fault(allocation, words) from error
    return paths


@dataclass(frozen=True)
class Team:
    """
    Robots that leave together.

    Parameters
    ----------
    agents : int
        Number of robots, at least 1.
    allocation : str
        One of `ALLOCATIONS`. 'independent': every robot takes the path it would take alone.
        'voronoi': the field is divided into regions of about equal entropy, one for each robot.
        'greedy': robot after robot, each for the information it adds to the expected outcomes of
        earlier robots.
    types : sequence of RobotType
        The type of each robot; empty if all are alike.

    Raises
    ------
    ValueError
        If there is no robot, the allocation is unknown, or `types` has another length than the
        number of robots.

    """

    agents: int = 1
    allocation: str | Callable[..., Any] = 'greedy'
    types: tuple[RobotType, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, 'agents', whole_number('agents', self.agents, 1))
        object.__setattr__(self, 'types', of_each(self.agents, self.types))
        ALLOCATIONS.find(self.allocation)

    def first(self, robots: int) -> Team:
        """Return the team of the first `robots` robots, or the whole team if it is smaller."""
        if robots >= self.agents:
            return self
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
    rng: np.random.Generator | None = None,
) -> list[Plan]:
    """
    Plan a round: a closed path for each of several robots that leave together.

    Parameters
    ----------
    grid : Grid
        The field.
    belief : Belief
        Belief about the field.
    model : SensorModel
        Believed sensor model of the common robot type.
    team : Team
        The robots.
    options : SearchOptions
        Search options of the common robot type.
    in_flight : sequence of (array_like of int, RobotType)
        The path, shape (steps + 1,), and the type of each robot in flight. All allocations but
        'independent' plan for the information added to the outcomes of these robots.
    visited : array_like of int, shape (cells,), optional
        Visits of each cell by the paths of earlier deployments, for planners that use them; 0 by
        default.
    rng : numpy.random.Generator, optional
        Generator for planners that have a parameter `rng`.

    Returns
    -------
    list of Plan
        One plan for each robot, in their order, with the expected results of that robot alone.
        Equal beliefs give equal plans, unless the planner takes `rng`. A single robot gets the
        plan of `plan`.

    Raises
    ------
    NoPathError
        If no path with the minimum survival is found.
    ValueError
        If the belief is of another grid, the planner does not support the objective or the limit
        of distance, the distance allows no step, there are more robots than free cells, a path in
        flight is invalid, a base is not one of the grid's, the robots have too many different
        cameras, or the search needs too much memory.

    """
    belief.check(grid)
    finder = PathFinder(grid, options, as_array('visited', visited), rng)
    team_size(finder.grid, team.agents)
    in_flight = listed('in_flight', in_flight)
    for sent in in_flight:
        is_pair = isinstance(sent, tuple | list) and len(sent) == 2
        if not (is_pair and isinstance(sent[1], RobotType)):
            words = f'in_flight has {in_short(sent)}: it must have (path, RobotType(...))'
            raise TypeError(words)
    types = dict.fromkeys((*team.types, *(robot_type for _, robot_type in in_flight)))
    cameras = {camera_rates(robot_type.model(model)) for robot_type in types}
    check_team(finder, team.types, len(in_flight), len(cameras))
    outcomes = nobody_deployed(belief)
    for path, robot_type in in_flight:
        cells = grid.at(robot_type.base).check_path(path)
        outcomes = after_deployment(outcomes, robot_type.model(model), cells)

    def find(finder: PathFinder) -> list[Plan]:
        members = {
            robot_type: TeamMember.of(robot_type, finder, belief, model, outcomes)
            for robot_type in dict.fromkeys(team.types)
        }
        paths = allocated(team.allocation, [members[each] for each in team.types])
        return [
            Plan.alone(path, members[robot_type].objective)
            for path, robot_type in zip(paths, team.types)
        ]

    if options.objective != 'information_per_loss':
        return find(finder)

    def at_cost(loss_cost: float) -> tuple[list[Plan], float, float]:
        """Return the plans at a loss cost, their information and the expected losses."""
        search = replace(options, objective='information', loss_cost=loss_cost)
        plans = find(replace(finder, options=search))
        paths = [each.path for each in plans]
        information = team_information(belief, model, paths, outcomes, team.types)
        return plans, information, sum(1.0 - each.survival for each in plans)

    return most_per_loss(at_cost)


# Maximum number of searches at successive loss costs; usually three or four change the plans.
MAX_SEARCHES = 10


def most_per_loss(at_cost: Callable[[float], tuple[list[Plan], float, float]]) -> list[Plan]:
    """Return the plans with the most information per expected loss (:eq:`per-loss`)."""
    best, information, lost = at_cost(0.0)
    for _ in range(MAX_SEARCHES):
        if lost <= 0.0:
            break
        # Dinkelbach: at this cost the best plans have value 0, and only better plans exceed 0.
        cost = information / lost
        plans, information, lost = at_cost(cost)
        if information <= cost * lost:
            break
        best = plans
    return best


def check_team(
    finder: PathFinder, types: Sequence[RobotType], in_flight: int = 0, cameras: int = 0
) -> None:
    """Check that the search for a team fits in the allowed memory."""
    # Robot types that set no rates of the camera share the common camera.
    cameras = cameras or len({(each.true_positive, each.false_positive) for each in types})
    check_cameras(cameras)
    for own in map(finder.of_type, dict.fromkeys(types)):
        check_distance(own.grid, own.options)
        own.check_memory(in_flight + len(types), cameras)


def team_size(grid: Grid, agents: int) -> int:
    """Return `agents`, checked to be at most one robot for each free cell."""
    free = grid.cells - len(frozenset(grid.blocked))
    try:
        return whole_number('agents', agents, 1, free)
    except ValueError as error:
        raise ValueError(f'{error}, at most one for each free cell') from error
