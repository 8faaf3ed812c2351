# SPDX-License-Identifier: Apache-2.0
"""One deployment as its robot remembers it."""

from __future__ import annotations

from dataclasses import dataclass, field

from kbnitp_ros.core import Observation
from kbnitp_ros.robot.way import steps_within
import numpy as np

NOT_LOOKED = -1


@dataclass
class Step:
    """A cell that the robot came to, or stayed in."""

    cell: int
    # When it came, in nanoseconds of ROS time.
    time: int
    # 1 if the target detector saw something there, 0 if it looked and saw nothing, -1 if it was
    # not heard.
    reading: int = NOT_LOOKED


@dataclass
class Deployment:
    """A deployment: what was ordered and what became of it."""

    # That of its path, in nanoseconds, which names it.
    stamp: int
    # When its mission began, in nanoseconds.
    mission: int
    # The cells of its path.
    path: tuple[int, ...]
    # When the robot said that it departs, in nanoseconds; 0 before.
    departed: int = 0
    # Those made so far.
    steps: list[Step] = field(default_factory=list)
    # Whether the robot is back at its base, so that no step follows.
    is_home: bool = False
    # Whether it was localised where it cannot have come to: nothing is read from then on.
    is_doubted: bool = False

    @property
    def base(self) -> int:
        """Return the cell that it started in."""
        return self.path[0]

    @property
    def cells(self) -> list[int]:
        """Return the cells of the walk so far, the base first."""
        return [self.base, *(step.cell for step in self.steps)]

    def observation(self, most: int) -> Observation:
        """Return what the robot that is home tells of its field."""
        kept = steps_within(self.cells, most)
        steps = [self.steps[number - 1] for number in kept] or [Step(self.base, 0)]
        walk = np.array([self.base, *(step.cell for step in steps)], dtype=np.intp)
        readings = np.array([step.reading for step in steps], dtype=np.int8)
        return Observation(walk, True, readings)
