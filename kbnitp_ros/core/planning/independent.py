# SPDX-License-Identifier: Apache-2.0
"""Every robot as if it were alone."""

from __future__ import annotations

from collections.abc import Sequence

from kbnitp_ros.core.planning.fates import nobody_sent
from kbnitp_ros.core.planning.robot import Robot
import numpy as np
from numpy.typing import NDArray


def allocate(robots: Sequence[Robot]) -> tuple[list[NDArray[np.intp]], None]:
    """Return the same path for all of a kind: robots that believe the same plan the same."""
    nobody = nobody_sent(robots[0].objective.belief)
    paths = {
        robot: robot.finder.paths(robot.objective.given(nobody))[0].path
        for robot in dict.fromkeys(robots)
    }
    return [paths[robot] for robot in robots], None
