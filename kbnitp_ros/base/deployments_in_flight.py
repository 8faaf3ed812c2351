# SPDX-License-Identifier: Apache-2.0
"""Which robots were sent, which of them have departed, and who may still come home."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
import time
from typing import Any, TypeVar

from kbnitp_ros.configuration import value_for
from kbnitp_ros.configuration.table import MOST_ROBOTS
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.log.record import Departures
from kbnitp_ros.messages.deployments import AgentStatus, OrderState
from kbnitp_ros.messages.headers import SECOND
import numpy as np
from numpy.typing import NDArray

# Seconds after the first refusal and, since each that follows doubles it, at the most.
FIRST, LONGEST = 1.0, 60.0


class Refusals:
    """The agents that refused their last orders: another one would be refused for the same."""

    def __init__(self) -> None:
        self._pauses: dict[str, float] = {}
        self._until: dict[str, float] = {}

    def add(self, agent: str) -> None:
        """Take note that an agent refused an order."""
        pause = min(2 * self._pauses[agent], LONGEST) if agent in self._pauses else FIRST
        self._pauses[agent], self._until[agent] = pause, time.monotonic() + pause

    def clear(self, agent: str) -> None:
        """Take note that a robot of an agent departed."""
        self._pauses.pop(agent, None)
        self._until.pop(agent, None)

    def is_left_alone(self, agent: str) -> bool:
        """Return whether an agent is sent no order yet."""
        return time.monotonic() < self._until.get(agent, 0.0)


# How long the nodes of a base have to take in a return, in seconds.
TAKEN_IN = 5.0


class LateReturns:
    """The robots that were given up and may still come home."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = values
        self._until: dict[DeploymentKey, float] = {}

    def expect(self, key: DeploymentKey, path: NDArray[np.intp]) -> None:
        """Await a robot that was given up on a path, shape (steps + 1,)."""
        self._until[key] = time.monotonic() + longest_absence(self._values, key.agent, path)

    def end(self, key: DeploymentKey) -> None:
        """Await no robot that is home, once that has been taken in."""
        if key in self._until:
            self._until[key] = min(self._until[key], time.monotonic() + TAKEN_IN)

    @property
    def awaited(self) -> dict[DeploymentKey, float]:
        """Return the robots that may still come home, and for how many seconds."""
        now = time.monotonic()
        return {key: until - now for key, until in self._until.items() if until > now}


K = TypeVar('K')
V = TypeVar('V')

# How many messages that are on disk, or tell of unknown deployments, are remembered until what
# they belong to is heard.
MOST_UNHEARD = 1000


@dataclass
class DeploymentInFlight:
    """A robot that was sent and not reported yet, nor refused its order."""

    # Its cells. Shape (steps + 1,).
    path: NDArray[np.intp]
    # Hash of the message that sent it.
    content: int
    # Whether that is on disk, so that its agent takes it.
    is_recorded: bool = False
    # Hash of the status by which it departs; None as long as it was not heard.
    departure: int | None = None
    # Whether it is known to have left the base.
    has_departed: bool = False
    # Hash of the path that is on disk instead of it, until that path is heard.
    recorded_content: int | None = None
    # When it times out, in nanoseconds; None until it has departed and the clock runs.
    due: int | None = None
    # Whether it had timed out at the last look.
    is_overdue: bool = False


class DeploymentsInFlight(Mapping[DeploymentKey, DeploymentInFlight]):
    """The robots in flight, by deployment: those that were sent and not reported."""

    def __init__(self, values: Mapping[str, Any], kept: int) -> None:
        self._values = values
        self.kept = kept
        self._in_flight: dict[DeploymentKey, DeploymentInFlight] = {}
        self._sent: set[DeploymentKey] = set()
        self._departures = Departures()
        # What is on disk besides paths, and what was said of orders that nobody is known to have
        # sent: a planner that was restarted may send them again.
        self._recorded: OrderedDict[tuple[DeploymentKey, int], None] = OrderedDict()
        self._unknown: OrderedDict[DeploymentKey, AgentStatus] = OrderedDict()
        # Deployments whose paths others than this planner have sent, and their missions.
        self._others: dict[DeploymentKey, int] = {}
        self._sent_by_agent: Counter[str] = Counter()
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
    def sent(self) -> int:
        """How many robots were sent and may leave, or have; whether they are in flight or not."""
        return len(self._sent)

    @property
    def undeparted(self) -> list[DeploymentKey]:
        """Return the robots that may never depart: their agents have not said that they do."""
        if self._values['presume_departure']:
            return []
        return [key for key in self._in_flight if not self.has_departed(key)]

    def has_departed(self, key: DeploymentKey) -> bool:
        """Return whether a robot in flight is known to have left the base."""
        robot = self._in_flight[key]
        is_on_record = robot.is_recorded or not self._values['recorded']
        return robot.has_departed or (self._values['presume_departure'] and is_on_record)

    def known(self, mission: int) -> int:
        """Return how many deployments of a mission are known, those sent by others included."""
        return self.sent + sum(each == mission for each in self._others.values())

    @property
    def forgotten(self) -> int:
        """How many deployments nobody hears again: their publishers keep them no longer."""
        return sum(max(0, sent - self.kept) for sent in self._sent_by_agent.values())

    def send(self, key: DeploymentKey, path: NDArray[np.intp], content: int) -> None:
        """Take note of a robot that is sent on a path, by a message with this content."""
        self._in_flight[key] = DeploymentInFlight(path, content)
        self._sent.add(key)
        self._others.pop(key, None)
        self._sent_by_agent[key.agent] += 1
        if (status := self._unknown.pop(key, None)) is not None:
            self.take(key, status)

    def hear(self, key: DeploymentKey, path: NDArray[np.intp], content: int, mission: int) -> bool:
        """Add a path; return whether a robot takes it in place of the one it was sent on."""
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
        """Record an acknowledgement; return whether a robot takes another path by it."""
        robot = self._in_flight.get(key)
        if robot is None or content != robot.content:
            # It may be a departure, which can be told sooner than the path.
            remember(self._recorded, (key, content), None)
        if robot is None:
            return False
        self._depart_if_recorded(key, robot)
        if robot.is_recorded:
            # Of two paths of one stamp the first is on disk.
            return False
        robot.is_recorded = content == robot.content
        robot.recorded_content = None if robot.is_recorded else content
        return not robot.is_recorded

    def take(self, key: DeploymentKey, status: AgentStatus) -> bool:
        """Take note of what an agent says of an order; return whether it says something new."""
        is_known = key in self._sent or key in self._others or self._departures.is_refused(key)
        if not is_known:
            remember(self._unknown, key, status)
            raise ValueError(
                f'deployment {key} is {status.state.name}, and no path of it was sent, as far as '
                'is known here'
            )
        if not self._departures.take(key, status):
            return False
        robot = self._in_flight.get(key)
        if robot is None:
            return True
        if status.state is OrderState.REFUSED:
            del self._in_flight[key]
            self._sent.discard(key)
        elif status.state is OrderState.DEPARTED:
            robot.departure = status.content
            self._depart_if_recorded(key, robot)
        return True

    def _depart_if_recorded(self, key: DeploymentKey, robot: DeploymentInFlight) -> None:
        if robot.departure is not None:
            is_recorded = (key, robot.departure) in self._recorded
            robot.has_departed |= is_recorded or not self._values['recorded']

    def restore(self, key: DeploymentKey, status: AgentStatus) -> None:
        """Take note of a status that is on record."""
        self.take(key, status)
        if status.state is OrderState.DEPARTED and key in self._in_flight:
            self._in_flight[key].has_departed = True

    def check_loss(self, key: DeploymentKey) -> None:
        """Check that a robot can have been lost, as `Departures` does."""
        self._departures.check_loss(key)

    def end(self, key: DeploymentKey, reported: int | None = None) -> None:
        """Take note that a robot was reported by its agent at a time, or was given up."""
        if self._departures.is_refused(key):
            # Whoever comes back has been away.
            self._sent.add(key)
        self._in_flight.pop(key, None)
        self._departures.end(key, reported)

    def overdue(self, now: int) -> list[DeploymentKey]:
        """Return the robots in flight that have timed out."""
        jump, self._time = min(0, now - self._time), now
        if now <= 0:
            return []
        overdue = []
        for key, robot in list(self._in_flight.items()):
            if not self.has_departed(key):
                continue
            # Robots do not come home later because the clock was set back.
            robot.due = self._due(now, key.agent, robot) if robot.due is None else robot.due + jump
            was_overdue, robot.is_overdue = robot.is_overdue, now > robot.due
            # What came while a plan was made is heard between two looks.
            if was_overdue and robot.is_overdue:
                overdue.append(key)
        return overdue

    def _due(self, now: int, agent: str, robot: DeploymentInFlight) -> int:
        """Return when a robot that departs now times out, in nanoseconds."""
        return now + round(longest_absence(self._values, agent, robot.path) * SECOND)


def longest_absence(values: Mapping[str, Any], agent: str, path: NDArray[np.intp]) -> float:
    """Return how long a silent robot may be away on a path, in seconds."""
    steps, period = path.size - 1, value_for(values, 'step_period', agent)
    seconds: float = steps * period + values['return_deadline']
    return seconds


def check_periods(values: Mapping[str, Any], agents: Iterable[str]) -> None:
    """Check that silent robots are given time for their ways."""
    for agent in agents:
        if values['silent_loss'] and value_for(values, 'step_period', agent) == 0.0:
            raise ValueError(
                f'silent_loss is true and step_period is 0 for {agent}: its robot would count as '
                f'lost {values["return_deadline"]} s after it departs (return_deadline), however '
                'long its path is; set step_period to the seconds that it needs for a step'
            )


def remember(known: OrderedDict[K, V], key: K, value: V) -> None:
    """Remember something, and of too many the newest."""
    known[key] = value
    if len(known) > MOST_UNHEARD:
        known.popitem(last=False)
