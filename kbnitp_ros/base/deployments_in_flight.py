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

# Number of returns without a step, one after another, after which an agent gets no more orders.
MAX_STILL = 2

# Beginning of the reason of a deployment whose report the estimator refuses.
REFUSED = 'the estimator refuses its report: '

# Maximum numbers of acknowledgements and of statuses kept until their paths arrive.
MAX_REMEMBERED = 1000


@dataclass
class DeploymentInFlight:
    """A deployment in flight: its path was sent, and no report or refusal has arrived."""

    # Cells of the path, shape (steps + 1,).
    path: NDArray[np.intp]
    # Hash of the path message.
    content: int
    # Time at which the path was sent, nanoseconds.
    sent_at: int
    # Whether the path is on disk, so that the agent may accept it.
    is_recorded: bool = False
    # Hash of the status that reports the departure; None before the departure.
    departure: int | None = None
    # Whether the robot is known to have departed.
    has_departed: bool = False
    # Hash of another planner's path that was recorded instead; None once that path has arrived.
    recorded_content: int | None = None
    # Time at which the robot times out, nanoseconds; None before its departure.
    due: int | None = None
    # Whether the deployment had timed out at the last check.
    is_overdue: bool = False
    # Whether only the operator can declare the robot lost: it was heard to be back, or it was in
    # another field.
    is_left_to_operator: bool = False


class DeploymentsInFlight(dict[DeploymentKey, DeploymentInFlight]):
    """The deployments in flight by key, in the order in which they were sent."""

    def __init__(self, values: Mapping[str, Any], kept: int) -> None:
        super().__init__()
        self._values = values
        self.kept = kept
        self._sent: set[DeploymentKey] = set()
        # The state of all orders.
        self.departures = Departures()
        # Acknowledgements and statuses received before this planner sends their paths, as
        # after a restart.
        self._recorded: OrderedDict[tuple[DeploymentKey, int], None] = OrderedDict()
        self._unknown: OrderedDict[DeploymentKey, AgentStatus] = OrderedDict()
        # Missions of deployments that other planners sent.
        self._others: dict[DeploymentKey, int] = {}
        self._sent_by_agent: Counter[str] = Counter()
        self._time = 0
        # Deployments that are neither evidence nor losses until the operator decides, with the
        # reason: their robots are known to be back, or not to have left.
        self.held: dict[DeploymentKey, str] = {}
        # Deployments that ended, by name, since an estimator may refuse their reports later.
        self._ended: dict[str, tuple[DeploymentKey, DeploymentInFlight]] = {}
        # Deployments that came back without a step, and their number since the last other ending,
        # by agent.
        self.unmoved: set[DeploymentKey] = set()
        self._still: Counter[str] = Counter()

    @property
    def paths(self) -> dict[DeploymentKey, NDArray[np.intp]]:
        """Return the paths in flight, by deployment."""
        return {key: robot.path for key, robot in self.items()}

    @property
    def sent(self) -> int:
        """Return the number of robots sent, without refused orders."""
        return len(self._sent)

    @property
    def still_agents(self) -> list[str]:
        """Return the agents whose last robots came back without a step."""
        return [agent for agent, times in self._still.items() if times >= MAX_STILL]

    def release(self, *agents: str) -> None:
        """Give orders again to agents whose robots came back without a step."""
        for agent in agents:
            del self._still[agent]

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
        """Return the number of deployments whose messages the publishers no longer keep."""
        return sum(max(0, sent - self.kept) for sent in self._sent_by_agent.values())

    def send(
        self, key: DeploymentKey, path: NDArray[np.intp], content: int, sent_at: int = 0
    ) -> None:
        """Record that a robot was sent; `content` is the hash of its path message."""
        self[key] = DeploymentInFlight(path, content, sent_at)
        self._sent.add(key)
        self._others.pop(key, None)
        self._sent_by_agent[key.agent] += 1
        if (status := self._unknown.pop(key, None)) is not None:
            self.take(key, status)

    def add_path(
        self, key: DeploymentKey, path: NDArray[np.intp], content: int, mission: int
    ) -> bool:
        """Record a received path; return whether it replaces the path of a robot in flight."""
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
        """Record an acknowledgement; return whether another path was recorded for the robot."""
        robot = self.get(key)
        if robot is None or content != robot.content:
            # The acknowledgement may be of a departure instead of a path.
            remember(self._recorded, (key, content), None)
        if robot is None:
            return False
        self._depart_if_recorded(key, robot)
        if robot.is_recorded:
            # Of two paths with the same stamp, only the first one counts.
            return False
        robot.is_recorded = content == robot.content
        robot.recorded_content = None if robot.is_recorded else content
        return not robot.is_recorded

    def take(self, key: DeploymentKey, status: AgentStatus) -> bool:
        """Record an agent's status of an order; return whether the status is new."""
        is_known = key in self._sent or key in self._others or self.departures.is_refused(key)
        if not is_known:
            remember(self._unknown, key, status)
            raise ValueError(
                f'status {status.state.name} of deployment {key}: this planner has not sent it'
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

    def hold(self, key: DeploymentKey, why: str, *, is_left_to_operator: bool) -> bool:
        """Hold a deployment that is not over; return whether the reason is new."""
        robot = self.get(key)
        if robot is None:
            return False
        robot.is_left_to_operator |= is_left_to_operator
        self._await_again(robot)
        is_new = self.held.get(key) != why
        self.held[key] = why
        return is_new

    def follow(self, refused: Mapping[str, str]) -> list[DeploymentKey]:
        """Hold the deployments whose reports the estimator refuses; return those that are new."""
        # A later report of the same deployment may have been accepted.
        for key in [key for key, why in self.held.items() if why.startswith(REFUSED)]:
            if str(key) not in refused:
                self.end(key)
        new = [self._ended.pop(name) for name in refused if name in self._ended]
        for key, robot in new:
            self[key] = robot
            self.unmoved.discard(key)
            self.hold(key, f'{REFUSED}{refused[str(key)]}', is_left_to_operator=True)
        return [key for key, _ in new]

    def leave(self, agent: str) -> None:
        """Await the robots of an agent that stood at its base."""
        for key in [key for key in self.held if key.agent == agent]:
            if not self[key].is_left_to_operator:
                del self.held[key]
                self._await_again(self[key])

    @staticmethod
    def _await_again(robot: DeploymentInFlight) -> None:
        robot.due, robot.is_overdue = None, False

    def end(self, key: DeploymentKey, reported: int | None = None, moved: bool = True) -> None:
        """Remove a deployment that was reported by its agent or given up."""
        self.held.pop(key, None)
        if key in self:
            self._ended[str(key)] = key, self[key]
            self._still[key.agent] = 0 if moved else self._still[key.agent] + 1
        self.unmoved.discard(key)
        if not moved:
            self.unmoved.add(key)
        if self.departures.is_refused(key):
            # The agent refused the order, but a robot that returned must have departed.
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
            if robot.is_left_to_operator or not self.has_departed(key):
                continue
            # Shift the timeout if the clock was set back.
            if robot.due is None:
                away = longest_absence(self._values, key.agent, robot.path)
                robot.due = now + round(away * SECOND)
            else:
                robot.due += jump
            was_overdue, robot.is_overdue = robot.is_overdue, now > robot.due
            # Time out at the second check, since reports that arrived during a search are read
            # between the checks.
            if was_overdue and robot.is_overdue:
                overdue.append(key)
        return overdue


def longest_absence(values: Mapping[str, Any], agent: str, path: NDArray[np.intp]) -> float:
    """Return the timeout of a silent robot on a path, in seconds."""
    steps, period = path.size - 1, value_for(values, 'step_period', agent)
    seconds: float = steps * period + values['return_deadline']
    return seconds


def check_periods(values: Mapping[str, Any], agents: Iterable[str]) -> None:
    """Check that silent robots do not time out before their paths end."""
    for agent in agents:
        if values['silent_loss'] and value_for(values, 'step_period', agent) == 0.0:
            raise ValueError(
                f'silent_loss is true and step_period is 0 for {agent}: its robot would count as '
                f'lost {values["return_deadline"]} s after it departs (return_deadline), however '
                'long its path is; set step_period to the seconds that it needs for a step'
            )


def remember(known: OrderedDict[K, V], key: K, value: V) -> None:
    """Add an entry, and drop the oldest beyond `MAX_REMEMBERED`."""
    known[key] = value
    if len(known) > MAX_REMEMBERED:
        known.popitem(last=False)
