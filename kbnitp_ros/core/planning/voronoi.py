# SPDX-License-Identifier: Apache-2.0
"""A region of the field for each robot."""

from __future__ import annotations

from dataclasses import replace

from kbnitp_ros.core.field import surprisal
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.planners import PathFinder
from kbnitp_ros.core.planning.regions import divide, Regions
import numpy as np
from numpy.typing import NDArray

# What counts of the readings that a robot brings from the regions of others.
ELSEWHERE = 0.1


def allocate(
    finder: PathFinder, objective: Objective, agents: int
) -> tuple[list[NDArray[np.intp]], Regions]:
    """
    Return paths that look for information in their own regions.

    The regions share out the joint entropy of the cells that a robot can visit and come back
    from. Readings elsewhere count little; where its path leads a robot is free, and so is its
    fate to tell of all hazards on the way.
    """
    cells = np.flatnonzero(finder.grid.in_reach(finder.max_steps))
    entropy = surprisal(objective.belief.joint[cells]).sum(axis=(1, 2))
    regions = divide(finder.grid, cells, entropy, agents)
    paths = []
    for robot in range(agents):
        interest = np.where(regions.owner == robot, 1.0, ELSEWHERE)
        paths.append(finder.paths(replace(objective, interest=interest))[0].path)
    return paths, regions
