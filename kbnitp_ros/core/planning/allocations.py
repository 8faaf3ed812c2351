# SPDX-License-Identifier: Apache-2.0
"""
The allocations: how robots that leave together share the work.

An allocation takes the robots, in their order, and returns a path for each of them and, if it
divides the field, the regions. Robots of one kind are one and the same object. A new one is one
file and one line here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kbnitp_ros.core.planning import greedy, independent, voronoi
from kbnitp_ros.core.planning.regions import Regions
from kbnitp_ros.core.planning.robot import Robot
import numpy as np
from numpy.typing import NDArray

Allocation = Callable[[Sequence[Robot]], tuple[list[NDArray[np.intp]], Regions | None]]

ALLOCATIONS: dict[str, Allocation] = {
    'independent': independent.allocate,
    'voronoi': voronoi.allocate,
    'greedy': greedy.allocate,
}
