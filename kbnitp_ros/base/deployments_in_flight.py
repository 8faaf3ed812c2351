# SPDX-License-Identifier: Apache-2.0
"""Which deployments were ordered, which of them are in flight, and when one times out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from kbnitp_ros.configuration import MOST_ROBOTS, value_for
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.headers import SECOND
import numpy as np
from numpy.typing import NDArray


@dataclass
class DeploymentInFlight:
    """
    A robot that was sent and not reported yet.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        Its cells.
    content : int
        Hash of the message that sent it.
    is_recorded : bool
        Whether that is on disk, so that it leaves.
    recorded_content : int or None
        Hash of the path that is on disk instead of it, until that path is heard.
    due : int or None
        When it times out, nanoseconds of ROS time; None until it has left and the clock runs.
    is_overdue : bool
        Whether it had timed out at the last look.

    """

    path: NDArray[np.intp]
    content: int
    is_recorded: bool = False
    recorded_content: int | None = None
    due: int | None = None
    is_overdue: bool = False


class DeploymentsInFlight(Mapping[DeploymentKey, DeploymentInFlight]):
    """
    The robots in flight, by deployment.

    Parameters
    ----------
    values : mapping
        The planner's parameters by name.
    kept : int
        How many paths of an agent their publisher keeps for those who join late.

    """

    def __init__(self, values: Mapping[str, Any], kept: int) -> None:
        self._values = values
        self._kept = kept
        self._in_flight: dict[DeploymentKey, DeploymentInFlight] = {}
        self._sent: set[DeploymentKey] = set()
        # Deployments whose paths others than this planner have sent, and their missions.
        self._others: dict[DeploymentKey, int] = {}
        self._left_by_agent: Counter[str] = Counter()
        self._time = 0

    def __getitem__(self, key: DeploymentKey) -> DeploymentInFlight:
        """Return a robot in flight."""
        return self._in_flight[key]

    def __iter__(self) -> Iterator[DeploymentKey]:
        """Iterate over the deployments in flight, in the order they were ordered."""
        return iter(self._in_flight)

    def __len__(self) -> int:
        """Return how many are in flight."""
        return len(self._in_flight)

    @property
    def paths(self) -> dict[DeploymentKey, NDArray[np.intp]]:
        """Return the paths of robots in flight, by deployment."""
        return {key: robot.path for key, robot in self._in_flight.items()}

    @property
    def agents(self) -> set[str]:
        """Return the agents whose robots are in flight."""
        return {key.agent for key in self._in_flight}

    @property
    def left(self) -> int:
        """How many robots have left, whether they are in flight or not."""
        return len(self._sent)

    def known(self, mission: int) -> int:
        """Return how many deployments of a mission are known, those sent by others included."""
        return self.left + sum(each == mission for each in self._others.values())

    @property
    def forgotten(self) -> int:
        """How many deployments nobody hears again: their publishers keep them no longer."""
        return sum(max(0, left - self._kept) for left in self._left_by_agent.values())

    def leave(self, key: DeploymentKey, path: NDArray[np.intp], content: int) -> None:
        """Take note of a robot that leaves on a path, sent by a message with this content."""
        self._in_flight[key] = DeploymentInFlight(path, content)
        self._sent.add(key)
        self._others.pop(key, None)
        self._left_by_agent[key.agent] += 1

    def hear(self, key: DeploymentKey, path: NDArray[np.intp], content: int, mission: int) -> bool:
        """
        Take note of a path, whoever sent it.

        Returns
        -------
        bool
            Whether a robot in flight takes this path, and not the one that it was sent on.

        Raises
        ------
        ValueError
            If others have sent as many paths as a mission can have.

        """
        if key in self._sent:
            robot = self._in_flight.get(key)
            if robot is None or content != robot.recorded_content:
                return False
            robot.path, robot.content, robot.is_recorded, robot.recorded_content = (
                path,
                content,
                True,
                None,
            )
            return True
        if len(self._others) >= MOST_ROBOTS:
            raise ValueError(
                f'more than {MOST_ROBOTS} paths of other planners were received: stop all but one'
            )
        self._others[key] = mission
        return False

    def record(self, key: DeploymentKey, content: int) -> bool:
        """
        Take note of what path is on disk; those of others do not matter.

        Returns
        -------
        bool
            Whether a robot in flight takes that path, and not the one that it was sent on.

        """
        robot = self._in_flight.get(key)
        if robot is None:
            return False
        robot.is_recorded = content == robot.content
        robot.recorded_content = None if robot.is_recorded else content
        return not robot.is_recorded

    def end(self, key: DeploymentKey) -> None:
        """Take note that a robot was reported."""
        self._in_flight.pop(key, None)

    def overdue(self, now: int) -> list[DeploymentKey]:
        """
        Return the robots in flight that have timed out.

        Parameters
        ----------
        now : int
            ROS time in nanoseconds; 0 as long as a simulated clock has not started.

        """
        jump, self._time = min(0, now - self._time), now
        if now <= 0:
            return []
        overdue = []
        for key, robot in list(self._in_flight.items()):
            if self._values['recorded'] and not robot.is_recorded:
                continue
            # Robots do not come home sooner because the clock was set back.
            robot.due = self._due(now, key.agent, robot) if robot.due is None else robot.due + jump
            was_overdue, robot.is_overdue = robot.is_overdue, now > robot.due
            # What came while a plan was made is heard between two looks.
            if was_overdue and robot.is_overdue:
                overdue.append(key)
        return overdue

    def _due(self, now: int, agent: str, robot: DeploymentInFlight) -> int:
        """Return when a robot that leaves now times out, in nanoseconds."""
        steps, period = robot.path.size - 1, value_for(self._values, 'step_period', agent)
        wait = steps * period + self._values['return_deadline']
        due: int = now + round(wait * SECOND)
        return due
