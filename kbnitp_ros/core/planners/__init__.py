# SPDX-License-Identifier: Apache-2.0
"""
The planners: how each looks for the path of the next deployment.

A planner takes (grid, belief, model, max_steps, width, max_visits) and returns a closed path. A
new one is one file and one line here.
"""

from __future__ import annotations

from collections.abc import Callable

from kbnitp_ros.core.belief import Belief
from kbnitp_ros.core.grid import Grid
from kbnitp_ros.core.planners.labels import best_path
from kbnitp_ros.core.sensor import SensorModel
import numpy as np
from numpy.typing import NDArray

Planner = Callable[[Grid, Belief, SensorModel, int, int, int], NDArray[np.intp]]


def relaxed(
    grid: Grid, belief: Belief, model: SensorModel, max_steps: int, width: int, max_visits: int
) -> NDArray[np.intp]:
    """Keep the single best label of each cell and step, whatever `width`: the paper's planner."""
    return best_path(grid, belief, model, max_steps, 1, max_visits)


PLANNERS: dict[str, Planner] = {'relaxed': relaxed, 'beam': best_path}
