# SPDX-License-Identifier: Apache-2.0
"""Robots in flight."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.table import MAX_ROBOTS
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.record import Departures
from kbnitp_ros.messages.deployments import AgentStatus, OrderState
from kbnitp_ros.messages.headers import SECOND
import numpy as np
from numpy.typing import NDArray

K = TypeVar('K')
V = TypeVar('V')

# Maximum number of recorded or unknown deployments remembered until their paths arrive.
MAX_REMEMBERED = 1000


@dataclass
class DeploymentInFlight:
    """A deployment in flight: sent, and neither reported nor refused."""

    # Cells of the path, shape (steps + 1,).
    path: NDArray[np.intp]
    # Hash of the message that sent it.
    content: int
    # Whether the path is on disk, so that the agent may accept it.
    is_recorded: bool = False
    # Hash of the status that reports the departure; None before.
    departure: int | None = None
    # Whether the robot is known to have departed.
    has_departed: bool = False
    # Hash of the path recorded in its place, until that path arrives.
    recorded_content: int | None = None
    # When it times out, nanoseconds; None until it has departed and the clock runs.
    due: int | None = None
    # Whether the deployment had timed out at the last check.
    is_overdue: bool = False


class DeploymentsInFlight(dict[DeploymentKey, DeploymentInFlight]):
    """The deployments in flight, by key in their order."""

    def __init__(self, values: Mapping[str, Any], kept: int) -> None:
        super().__init__()
        self._values = values
        self.kept = kept
        self._sent: set[DeploymentKey] = set()
        # The state of all orders.
        self.departures = Departures()
        # Acknowledgements without a path, and statuses of unknown orders: a restarted planner may
        # send these again.
        self._recorded: OrderedDict[tuple[DeploymentKey, int], None] = OrderedDict()
        self._unknown: OrderedDict[DeploymentKey, AgentStatus] = OrderedDict()
        # Missions of deployments that other planners sent.
        self._others: dict[DeploymentKey, int] = {}
        self._sent_by_agent: Counter[str] = Counter()
        self._time = 0

    @property
    def paths(self) -> dict[DeploymentKey, NDArray[np.intp]]:
        """Return the paths in flight, by deployment."""
        return {key: robot.path for key, robot in self.items()}

    @property
    def sent(self) -> int:
        """Return the number of robots sent that have departed or may still depart."""
        return len(self._sent)

    @property
    def undeparted(self) -> list[DeploymentKey]:
        """Return the deployments whose agents have not reported a departure."""
        if self._values['presume_departure']:
            return []
        return [key for key in self if not self.has_departed(key)]

    def has_departed(self, key: DeploymentKey) -> bool:
        """Return whether a robot in flight is known to have departed."""
        robot = self[key]
        is_on_record = robot.is_recorded or not self._values['recorded']
        return robot.has_departed or (self._values['presume_departure'] and is_on_record)

    def known(self, mission: int) -> int:
        """Return the number of known deployments of a mission, from any planner."""
        return self.sent + sum(each == mission for each in self._others.values())

    @property
    def forgotten(self) -> int:
        """Return the number of deployments that their publishers no longer keep."""
        return sum(max(0, sent - self.kept) for sent in self._sent_by_agent.values())

    def send(self, key: DeploymentKey, path: NDArray[np.intp], content: int) -> None:
        """Add a robot sent on a path by a message with this hash."""
        self[key] = DeploymentInFlight(path, content)
        self._sent.add(key)
        self._others.pop(key, None)
        self._sent_by_agent[key.agent] += 1
        if (status := self._unknown.pop(key, None)) is not None:
            self.take(key, status)

    def add_path(
        self, key: DeploymentKey, path: NDArray[np.intp], content: int, mission: int
    ) -> bool:
        """Add a path; return whether it replaces the one that the robot was sent on."""
        if key in self._sent:
            robot = self.get(key)
            if robot is None or content != robot.recorded_content:
                return False
            robot.path, robot.content = path, content
            robot.is_recorded, robot.recorded_content = True, None
            return True
        if len(self._others) >= MAX_ROBOTS:
            raise ValueError(
                f'more than {MAX_ROBOTS} paths of other planners were received: stop all but one'
            )
        self._others[key] = mission
        return False

    def record(self, key: DeploymentKey, content: int) -> bool:
        """Record an acknowledgement; return whether the robot's path changes by it."""
        robot = self.get(key)
        if robot is None or content != robot.content:
            # It may be a departure, reported before the path arrives.
            remember(self._recorded, (key, content), None)
        if robot is None:
            return False
        self._depart_if_recorded(key, robot)
        if robot.is_recorded:
            # Of two paths with one stamp the first one is on disk.
            return False
        robot.is_recorded = content == robot.content
        robot.recorded_content = None if robot.is_recorded else content
        return not robot.is_recorded

    def take(self, key: DeploymentKey, status: AgentStatus) -> bool:
        """Add an agent's status of an order; return whether it is new."""
        is_known = key in self._sent or key in self._others or self.departures.is_refused(key)
        if not is_known:
            remember(self._unknown, key, status)
            raise ValueError(
                f'deployment {key} is {status.state.name}, but this planner knows no path of it'
            )
        if not self.departures.take(key, status):
            return False
        robot = self.get(key)
        if robot is None:
            return True
        if status.state is OrderState.REFUSED:
            del self[key]
            self._sent.discard(key)
        elif status.state is OrderState.DEPARTED:
            robot.departure = status.content
            self._depart_if_recorded(key, robot)
        return True

    def _depart_if_recorded(self, key: DeploymentKey, robot: DeploymentInFlight) -> None:
        if robot.departure is not None:
            is_recorded = (key, robot.departure) in self._recorded
            robot.has_departed |= is_recorded or not self._values['recorded']

    def end(self, key: DeploymentKey, reported: int | None = None) -> None:
        """Remove a robot that its agent reported, or that was given up."""
        if self.departures.is_refused(key):
            # A returned robot must have departed.
            self._sent.add(key)
        self.pop(key, None)
        self.departures.end(key, reported)

    def overdue(self, now: int) -> list[DeploymentKey]:
        """Return the robots in flight that have timed out."""
        jump, self._time = min(0, now - self._time), now
        if now <= 0:
            return []
        overdue = []
        for key, robot in list(self.items()):
            if not self.has_departed(key):
                continue
            # A clock that was set back does not delay timeouts.
            if robot.due is None:
                away = longest_absence(self._values, key.agent, robot.path)
                robot.due = now + round(away * SECOND)
            else:
                robot.due += jump
            was_overdue, robot.is_overdue = robot.is_overdue, now > robot.due
            # Messages that came during a search are read between two checks.
            if was_overdue and robot.is_overdue:
                overdue.append(key)
        return overdue


def longest_absence(values: Mapping[str, Any], agent: str, path: NDArray[np.intp]) -> float:
    """Return how long a silent robot may be away on a path, in seconds."""
    steps, period = path.size - 1, value_for(values, 'step_period', agent)
    seconds: float = steps * period + values['return_deadline']
    return seconds


def check_periods(values: Mapping[str, Any], agents: Iterable[str]) -> None:
    """Check that the deadlines of silent robots cover their paths."""
    for agent in agents:
        if values['silent_loss'] and value_for(values, 'step_period', agent) == 0.0:
            raise ValueError(
                f'silent_loss is true and step_period is 0 for {agent}: its robot would count as '
                f'lost {values["return_deadline"]} s after it departs (return_deadline), however '
                'long its path is; set step_period to the seconds that it needs for a step'
            )


def remember(known: OrderedDict[K, V], key: K, value: V) -> None:
    """Add an entry, and drop the oldest of too many."""
    known[key] = value
    if len(known) > MAX_REMEMBERED:
        known.popitem(last=False)
