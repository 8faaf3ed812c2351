# SPDX-License-Identifier: Apache-2.0
"""Laws that every allocation obeys, as checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from kbnitp_ros.core import ALLOCATIONS, Belief, PathFinder, RobotType, SearchOptions
from kbnitp_ros.core.planning.plans import Allocation, TeamMember
from kbnitp_ros.testing.laws import (
    draw_field,
    draw_robot_type,
    draw_walk,
    FieldCase,
    hold,
    PLANS,
    require,
)
import numpy as np


@dataclass(frozen=True, eq=False)
class RoundCase(FieldCase):
    """A field, and the robots of a round."""

    # Two to four robots, some with limits and numbers of their own.
    robots: tuple[TeamMember, ...]
    # The same robots, planned after another robot has left.
    after: tuple[TeamMember, ...]


def draw_round(seed: int) -> RoundCase:
    """Draw a field and the robots of a round."""
    rng = np.random.default_rng([PLANS, seed])
    field = draw_field(rng)
    planner = str(rng.choice(['relaxed', 'beam']))
    options = SearchOptions(planner, int(rng.integers(2, 9)), 2, int(rng.integers(1, 4)))
    options = replace(options, loss_cost=float(rng.choice([0.0, 0.5])))
    finder = PathFinder(field.grid, options)
    robot_types = [
        RobotType(),
        replace(draw_robot_type(rng), max_steps=int(rng.integers(1, 5))),
        replace(draw_robot_type(rng), loss_cost=0.3),
    ]
    each = [
        TeamMember.of(robot_type, finder, field.prior, field.model) for robot_type in robot_types
    ]
    robots = tuple(each[n] for n in rng.integers(0, 3, int(rng.integers(2, 5))))
    other = draw_walk(rng, field.grid, int(rng.integers(1, 7)))
    outcomes = robots[0].objective.after(other)
    later = {
        robot: replace(robot, objective=replace(robot.objective, outcomes=outcomes))
        for robot in robots
    }
    after = tuple(later[robot] for robot in robots)
    return RoundCase(field.grid, field.prior, field.model, robots, after)


def check_allocation(allocation: str | object, *, cases: int = 25, seed: int = 0) -> None:
    """Check that an allocation obeys the laws of this package, in random cases."""
    hold(ALLOCATIONS, allocation, LAWS, draw_round, cases, seed)


def gives_each_robot_a_path(allocation: Allocation, given: RoundCase) -> None:
    """Check that each robot has one path, within its own limits."""
    for robots in (given.robots, given.after):
        paths = allocation(robots)
        require(
            len(paths) == len(robots),
            f'Number of paths: {len(paths)}; number of robots: {len(robots)}',
        )
        for number, (robot, path) in enumerate(zip(robots, paths)):
            try:
                robot.finder.check_path(path)
            except ValueError as error:
                raise AssertionError(f'Path of robot {number}: {error}') from error


def plans_one_as_alone(allocation: Allocation, given: RoundCase) -> None:
    """Check that a team of one robot gets the best path of a single robot."""
    for robot in given.robots:
        (path,) = allocation([robot])
        best = robot.finder.candidates(robot.objective)[0].path
        require(
            np.array_equal(path, best),
            f'The path is {np.asarray(path).tolist()}, the best path is {best.tolist()}',
        )


def is_reproducible(allocation: Allocation, given: RoundCase) -> None:
    """Check that the same belief gives the same paths."""
    first = allocated_paths(allocation, given.robots)
    allocation(given.after)
    belief = Belief(given.prior.joint.copy())
    again = {
        robot: replace(robot, objective=replace(robot.objective, belief=belief))
        for robot in given.robots
    }
    second = allocated_paths(allocation, [again[robot] for robot in given.robots])
    require(first == second, f'The first paths are {first}, the second paths are {second}')


def allocated_paths(allocation: Allocation, robots: Sequence[TeamMember]) -> list[list[int]]:
    """Return the paths of an allocation."""
    return [np.asarray(path).tolist() for path in allocation(robots)]


LAWS: tuple[Callable[[Allocation, RoundCase], None], ...] = (
    gives_each_robot_a_path,
    plans_one_as_alone,
    is_reproducible,
)
