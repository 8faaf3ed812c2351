# SPDX-License-Identifier: Apache-2.0
"""Every robot as if it were alone."""

from __future__ import annotations

from dataclasses import replace

from kbnitp_ros.core.planning.fates import nobody_sent
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.planners import PathFinder
import numpy as np
from numpy.typing import NDArray


def allocate(
    finder: PathFinder, objective: Objective, agents: int
) -> tuple[list[NDArray[np.intp]], None]:
    """Return the same path for all: robots that believe the same plan the same."""
    alone = replace(objective, fates=nobody_sent(objective.belief))
    return [finder.paths(alone)[0].path] * agents, None
