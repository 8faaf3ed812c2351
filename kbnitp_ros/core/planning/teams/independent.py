# SPDX-License-Identifier: Apache-2.0
"""Every robot as if it were alone."""

from __future__ import annotations

from collections.abc import Sequence

from kbnitp_ros.core.planning.objective.joint_outcomes import nobody_deployed
from kbnitp_ros.core.planning.teams.team_member import TeamMember
import numpy as np
from numpy.typing import NDArray


def allocate(robots: Sequence[TeamMember]) -> tuple[list[NDArray[np.intp]], None]:
    """Return the same path for all of a type: the same belief gives the same plan."""
    nobody = nobody_deployed(robots[0].objective.belief)
    paths = {
        robot: robot.finder.candidates(robot.objective.given(nobody))[0].path
        for robot in dict.fromkeys(robots)
    }
    return [paths[robot] for robot in robots], None
