# SPDX-License-Identifier: Apache-2.0
"""A region of the field for each robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from kbnitp_ros.core.field import surprisal
from kbnitp_ros.core.planning.teams.regions import divide, Regions
from kbnitp_ros.core.planning.teams.team_member import TeamMember
import numpy as np
from numpy.typing import NDArray

# What counts of the readings that a robot brings from the regions of others.
ELSEWHERE = 0.1


def allocate(robots: Sequence[TeamMember]) -> tuple[list[NDArray[np.intp]], Regions]:
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
