# SPDX-License-Identifier: Apache-2.0
"""The plans of a round: several robots that leave together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from kbnitp_ros.core.field import Belief, Grid, Kind, of_each, SensorModel, whole_number
from kbnitp_ros.core.planning.allocations import allocated, ALLOCATIONS
from kbnitp_ros.core.planning.behavioral import SHANNON
from kbnitp_ros.core.planning.fates import after_sending, nobody_sent
from kbnitp_ros.core.planning.information import team_information
from kbnitp_ros.core.planning.plan import Plan
from kbnitp_ros.core.planning.planners import PathFinder, sought_by
from kbnitp_ros.core.planning.readings import Camera, check_cameras
from kbnitp_ros.core.planning.refused import without
from kbnitp_ros.core.planning.regions import Regions
from kbnitp_ros.core.planning.robot import Robot
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class TeamPlan:
    """
    Paths for robots that leave together and what is expected of them.

    Attributes
    ----------
    plans : tuple of Plan
        One a robot, in their order; each says what is expected of that robot alone.
    information : float
        What is expected of all together, beyond what robots that are out bring, nats.
    regions : Regions, optional
        How the field was divided among the robots; None where the allocation does not.

    """

    plans: tuple[Plan, ...]
    information: float
    regions: Regions | None


def plan_team(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    max_steps: int,
    agents: int,
    allocation: str = 'greedy',
    planner: str = 'beam',
    *,
    width: int = 16,
    max_visits: int = 3,
    loss_cost: float = 0.0,
    kinds: Sequence[Kind] = (),
    out: Sequence[ArrayLike] = (),
    kinds_out: Sequence[Kind] = (),
    visited: ArrayLike = (),
    keep_off: Sequence[int] | NDArray[np.intp] = (),
    objective: str = 'information',
    alpha: float = 1.0,
) -> TeamPlan:
    """
    Plan a round: a closed path for each of several robots that leave together.

    Parameters
    ----------
    grid, belief, model, max_steps, planner, width, max_visits, loss_cost, visited
        As for `plan`; of each robot that has nothing else of its own.
    agents : int
        How many robots, from 1 to the number of free cells.
    allocation : str
        How the work is shared. 'independent': every robot takes the path it would take alone.
        'voronoi': the field is divided into regions of about equal entropy, one a robot.
        'greedy': robot after robot, for what each adds to what those before it are expected to
        bring, returned or lost.
    kinds : sequence of Kind
        Of each robot; empty if all are alike.
    out : sequence of array_like of int, each of shape (steps + 1,)
        The paths of robots that have left before and are not back. All but 'independent' plan for
        what is added to them.
    kinds_out : sequence of Kind
        Of each of those; empty if all are alike.
    keep_off : sequence of int
        Cells that none of the robots enters, besides those that are blocked.
    objective, alpha
        As for `plan`.

    Returns
    -------
    TeamPlan
        The same belief gives the same plans. A single robot's is that of `plan`.

    Raises
    ------
    ValueError
        If the allocation, the planner or the objective is unknown, the planner seeks none, a
        number is out of range, the belief has another number of cells than the grid, a robot that
        is out could not have left that way, there is not one kind for each robot, or they have too
        many different cameras.

    """
    ALLOCATIONS.find(allocation)
    in_use = without(grid, keep_off) if len(keep_off) else grid
    agents = team_size(in_use, agents)
    kinds, kinds_out = of_each(agents, kinds), of_each(len(out), kinds_out)
    check_cameras(len({Camera.of(kind.model(model)) for kind in (*kinds, *kinds_out)}))
    finder = PathFinder(in_use, planner, max_steps, width, max_visits, np.asarray(visited))
    sought = sought_by(planner, objective, alpha)
    alone = {kind: Robot.of(kind, finder, belief, model, loss_cost, sought) for kind in kinds}
    fates = nobody_sent(belief)
    for path, kind in zip(out, kinds_out):
        fates = after_sending(fates, kind.model(model), grid.check_path(path))
    robots = {kind: robot.given(fates) for kind, robot in alone.items()}
    paths, regions = allocated(allocation, [robots[kind] for kind in kinds])
    plans = tuple(Plan.along(path, belief, kind.model(model)) for path, kind in zip(paths, kinds))
    is_alone = len(plans) == 1 and not len(out)
    information = (
        plans[0].information if is_alone else team_information(belief, model, paths, fates, kinds)
    )
    return TeamPlan(plans, information, regions)


def check_team(
    finder: PathFinder,
    model: SensorModel,
    kinds: Sequence[Kind],
    alpha: float = SHANNON,
) -> None:
    """
    Check that paths for a team can be searched for within the memory allowed, before any is.

    Parameters
    ----------
    finder : PathFinder
        For robots that have no limit of their own.
    model : SensorModel
        Of robots that have no sensor of their own.
    kinds : sequence of Kind
        Of each robot that may leave or be out.
    alpha : float
        Of the objective.

    Raises
    ------
    ValueError
        With an estimate, if it takes more; or if they have too many different cameras.

    """
    most = max(kind.max_steps or finder.max_steps for kind in kinds)
    cameras = {Camera.of(kind.model(model)) for kind in kinds}
    replace(finder, max_steps=most).check_memory(len(kinds), len(cameras), alpha)


def team_size(grid: Grid, agents: int) -> int:
    """
    Return how many robots there are if the grid has a free cell for each.

    Raises
    ------
    ValueError
        If there are none, or more than free cells.

    """
    free = int(grid.free.sum())
    try:
        return whole_number('agents', agents, 1, free)
    except ValueError as error:
        raise ValueError(f'{error}, one for each free cell at most') from error
