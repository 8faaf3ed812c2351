# SPDX-License-Identifier: Apache-2.0
"""
The allocations: how robots that leave together share the work.

An allocation takes (finder, objective of a robot alone, agents) and returns a path for each robot
and, if it divides the field, the regions. A new one is one file and one line here.
"""

from __future__ import annotations

from collections.abc import Callable

from kbnitp_ros.core.planning import greedy, independent, voronoi
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.planners import PathFinder
from kbnitp_ros.core.planning.regions import Regions
import numpy as np
from numpy.typing import NDArray

Allocation = Callable[[PathFinder, Objective, int], tuple[list[NDArray[np.intp]], Regions | None]]

ALLOCATIONS: dict[str, Allocation] = {
    'independent': independent.allocate,
    'voronoi': voronoi.allocate,
    'greedy': greedy.allocate,
}
