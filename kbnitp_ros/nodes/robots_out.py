# SPDX-License-Identifier: Apache-2.0
"""Which robots have left, which of them are out, and when one is given up as lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.headers import SECOND
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import value_for
from kbnitp_ros.nodes.recent import Recent
import numpy as np
from numpy.typing import NDArray


@dataclass
class RobotOut:
    """
    A robot that is out.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        Its cells.
    due : int or None
        When it is given up, nanoseconds of ROS time; None until it has left and the clock runs.
    is_overdue : bool
        Whether it should have been given up at the last look.

    """

    path: NDArray[np.intp]
    due: int | None = None
    is_overdue: bool = False


class RobotsOut(Mapping[DeploymentKey, RobotOut]):
    """
    The robots that are out, by deployment.

    Parameters
    ----------
    values : mapping
        The planner's parameters by name.

    Attributes
    ----------
    left : int
        How many robots have left, whether they are out or not.

    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.left = 0
        self._values = values
        self._out: dict[DeploymentKey, RobotOut] = {}
        # Whose paths are on disk, as long as they are not reported.
        self._recorded = Recent(qos.DEPTH)
        self._left_by_agent: Counter[str] = Counter()
        self._time = 0

    def __getitem__(self, key: DeploymentKey) -> RobotOut:
        """Return a robot that is out."""
        return self._out[key]

    def __iter__(self) -> Iterator[DeploymentKey]:
        """Iterate over the deployments of robots that are out, in the order they left."""
        return iter(self._out)

    def __len__(self) -> int:
        """Return how many are out."""
        return len(self._out)

    @property
    def paths(self) -> dict[DeploymentKey, NDArray[np.intp]]:
        """Return the paths of robots that are out, by deployment."""
        return {key: robot.path for key, robot in self._out.items()}

    @property
    def agents(self) -> set[str]:
        """Return the agents whose robots are out."""
        return {key.agent for key in self._out}

    @property
    def forgotten(self) -> int:
        """How many deployments nobody hears again: their publishers keep them no longer."""
        return sum(max(0, left - qos.DEPTH) for left in self._left_by_agent.values())

    def leave(self, key: DeploymentKey, path: NDArray[np.intp]) -> None:
        """Take note of a robot that leaves."""
        self._out[key] = RobotOut(path)
        self.left += 1
        self._left_by_agent[key.agent] += 1

    def record(self, key: DeploymentKey) -> None:
        """Take note that the path of a robot is on disk, so that it leaves."""
        self._recorded.add(key)

    def is_recorded(self, key: DeploymentKey) -> bool:
        """Return whether the path of a robot is on disk, as far as known."""
        return key in self._recorded

    def end(self, key: DeploymentKey) -> None:
        """Take note that a robot was reported."""
        self._out.pop(key, None)
        self._recorded.discard(key)

    def overdue(self, now: int) -> list[DeploymentKey]:
        """
        Return the robots that should have been back for long.

        Parameters
        ----------
        now : int
            ROS time in nanoseconds; 0 as long as a simulated clock has not started.

        """
        jump, self._time = min(0, now - self._time), now
        if now <= 0:
            return []
        overdue = []
        for key, robot in list(self._out.items()):
            if self._values['recorded'] and not self.is_recorded(key):
                continue
            # Robots do not come home sooner because the clock was set back.
            robot.due = self._due(now, key.agent, robot) if robot.due is None else robot.due + jump
            was_overdue, robot.is_overdue = robot.is_overdue, now > robot.due
            # What came while a plan was made is heard between two looks.
            if was_overdue and robot.is_overdue:
                overdue.append(key)
        return overdue

    def _due(self, now: int, agent: str, robot: RobotOut) -> int:
        """Return when a robot that leaves now is given up, in nanoseconds."""
        steps, period = robot.path.size - 1, value_for(self._values, 'step_period', agent)
        wait = steps * period + self._values['return_deadline']
        due: int = now + round(wait * SECOND)
        return due
