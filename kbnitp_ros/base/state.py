# SPDX-License-Identifier: Apache-2.0
"""The state of a mission at its base: a fold over paths, statuses, reports and actions."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

from kbnitp_ros.core import DeploymentKey, Grid, Observation, Report, RobotType
from kbnitp_ros.core.inference.record import deployment_order, MissionRecord
from kbnitp_ros.messages.deployments import AgentStatus, OrderState
from kbnitp_ros.messages.operator_actions import Action, OperatorAction, OperatorState
import numpy as np
from numpy.typing import ArrayLike, NDArray

K = TypeVar('K')
V = TypeVar('V')

# Maximum number of robots of a mission.
MAX_ROBOTS = 20_000

# Number of returns without a step, one after another, after which an agent gets no more orders.
MAX_STILL = 2

# Beginnings of the reasons of held deployments: the report cannot be, or the estimator refuses it.
IMPOSSIBLE = 'its report is refused: '
REFUSED = 'the estimator refuses its report: '

# Maximum numbers of acknowledgements and of statuses kept until their paths arrive.
MAX_REMEMBERED = 1000

# Parameters of a mission that is read from its log: robots depart once the log has their status.
LOGGED: Mapping[str, Any] = MappingProxyType({'recorded': True, 'presume_departure': False})


class MissingError(ValueError):
    """A message refers to another message that has not arrived or is not in the log."""


class Departures:
    """The state of all orders, derived from the agents' statuses and reports."""

    def __init__(self) -> None:
        # Robots that have departed and have no report yet.
        self.out: set[DeploymentKey] = set()
        # Orders that their agents refused, so that the robots stay at the base.
        self.refused: set[DeploymentKey] = set()
        self._statuses: dict[DeploymentKey, AgentStatus] = {}
        # Time of the reported return by the agent's clock; None for a loss, or if unknown.
        self._reported: dict[DeploymentKey, int | None] = {}

    def take(self, key: DeploymentKey, status: AgentStatus) -> bool:
        """Record a status; return whether it is new. Raise ValueError for a contradiction."""
        known = self._statuses.get(key)
        if known is not None and not self._follows(key, status, known):
            return False
        if key in self._reported:
            reported = self._reported[key]
            is_late = reported is not None and status.stamp > reported
            if status.state is OrderState.REFUSED or is_late:
                raise ValueError(
                    f'status {status.state.name} of deployment {key} contradicts its report, '
                    'which counts'
                )
        elif status.state is OrderState.DEPARTED:
            self.out.add(key)
        elif status.state is OrderState.REFUSED:
            self.refused.add(key)
        self._statuses[key] = status
        return True

    @staticmethod
    def _follows(key: DeploymentKey, status: AgentStatus, known: AgentStatus) -> bool:
        """Return whether a status is newer than `known`; raise ValueError for a contradiction."""
        if status == known or status.state is known.state is OrderState.ACCEPTED:
            return False
        if known.state is OrderState.ACCEPTED:
            return True
        if status.state is OrderState.ACCEPTED and status.stamp <= known.stamp:
            # A restarted agent repeats its earlier statuses.
            return False
        raise ValueError(
            f'status {status.state.name} of deployment {key} contradicts the earlier status '
            f'{known.state.name}, which counts (do two robots have the name {key.agent}?)'
        )

    def end(self, key: DeploymentKey, reported: int | None) -> None:
        """Record that a deployment ended; `reported` is the time of a return, None for a loss."""
        self._reported[key] = self._reported.get(key) if reported is None else reported
        self.out.discard(key)
        if reported is not None and key in self.refused:
            # The agent refused the order, but a robot that returned must have departed.
            self.refused.remove(key)
            del self._statuses[key]

    def status(self, key: DeploymentKey) -> AgentStatus | None:
        """Return the last status of an order; None if there is none."""
        return self._statuses.get(key)

    def is_at_base(self, key: DeploymentKey) -> bool:
        """Return whether the last status of an order says that its robot is at the base."""
        status = self._statuses.get(key)
        return status is not None and status.state is not OrderState.DEPARTED

    def check_loss(self, key: DeploymentKey) -> None:
        """Check that a loss is possible; raise `MissingError` if no departure is reported."""
        if key in self.refused:
            raise ValueError(
                f'deployment {key} is reported lost, but its agent refused it: '
                f'{self._statuses[key].reason}'
            )
        if self.is_at_base(key) and key not in self._reported:
            raise MissingError(
                f'deployment {key} is reported lost, but its agent has not reported its departure'
            )


@dataclass
class Robot:
    """A robot in flight: its path was sent, and no report or refusal has arrived."""

    # Whether the path is on disk, so that the agent may accept it.
    is_recorded: bool = False
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

    def await_again(self) -> None:
        """Give the robot its whole time again."""
        self.due, self.is_overdue = None, False


class BaseState(MissionRecord):
    """The evidence of a mission, its robots in flight, and what the operator ordered."""

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
        values: Mapping[str, Any] = LOGGED,
    ) -> None:
        super().__init__(grid, max_steps, robot_types)
        self.values = values
        # The state of all orders, and what the operator ordered.
        self.departures = Departures()
        self.operator = OperatorState()
        # The robots in flight, in the order in which they were sent.
        self.in_flight: dict[DeploymentKey, Robot] = {}
        # Time at which each path was sent, nanoseconds.
        self.sent: dict[DeploymentKey, int] = {}
        # The reports that count, by deployment, in the order of arrival.
        self.reports: dict[DeploymentKey, Report] = {}
        # Deployments that came back without a step, and their number since the last other ending,
        # by agent.
        self.unmoved: set[DeploymentKey] = set()
        self._still: Counter[str] = Counter()
        # Acknowledgements and statuses received before this planner sends their paths, as
        # after a restart.
        self._acknowledged: OrderedDict[tuple[DeploymentKey, int], None] = OrderedDict()
        self._early: OrderedDict[DeploymentKey, AgentStatus] = OrderedDict()
        self._sent_by_agent: Counter[str] = Counter()
        # Missions of deployments that other planners sent.
        self._others: dict[DeploymentKey, int] = {}
        # Deployments that ended, by name, since an estimator may refuse their reports later.
        self._ended: dict[str, tuple[DeploymentKey, Robot]] = {}
        self._time = 0

    # Events: paths, acknowledgements, statuses, reports and actions.

    def take_path(
        self, key: DeploymentKey, path: ArrayLike, content: int = 0, sent_at: int = 0
    ) -> None:
        """Record the path of a robot that was sent; `content` is the hash of its message."""
        is_new = key not in self.paths
        if is_new:
            self.in_flight[key] = Robot()
        try:
            self.record_path(key, path, content)
        finally:
            if is_new and key not in self.paths:
                del self.in_flight[key]
            elif is_new:
                self.sent[key] = sent_at
                self._sent_by_agent[key.agent] += 1
                self._others.pop(key, None)
                if (status := self._early.pop(key, None)) is not None:
                    self.take_status(key, status)

    def take_other_path(
        self, key: DeploymentKey, path: NDArray[np.intp], content: int, mission: int
    ) -> bool:
        """Take another planner's path; return whether it replaces the path of a robot."""
        if key in self.paths:
            robot = self.in_flight.get(key)
            if robot is None or content != robot.recorded_content:
                return False
            self.paths[key], self.path_contents[key] = path, content
            robot.is_recorded, robot.recorded_content = True, None
            return True
        if len(self._others) >= MAX_ROBOTS:
            raise ValueError(
                f'more than {MAX_ROBOTS} paths of other planners were received: stop all but one'
            )
        self._others[key] = mission
        return False

    def take_recorded(self, key: DeploymentKey, content: int) -> bool:
        """Take an acknowledgement; return whether another path was recorded for the robot."""
        robot, sent = self.in_flight.get(key), self.path_contents.get(key)
        if robot is None or content != sent:
            # The acknowledgement may be of a departure instead of a path.
            remember(self._acknowledged, (key, content), None)
        if robot is None:
            return False
        self._depart_if_recorded(key, robot)
        if robot.is_recorded:
            # Of two paths with the same stamp, only the first one counts.
            return False
        robot.is_recorded = content == sent
        robot.recorded_content = None if robot.is_recorded else content
        return not robot.is_recorded

    def take_status(self, key: DeploymentKey, status: AgentStatus) -> bool:
        """Take an agent's status of an order; return whether the status is new."""
        if key not in self.paths and key not in self._others:
            remember(self._early, key, status)
            raise MissingError(
                f'status {status.state.name} of deployment {key}: this planner has not sent it'
            )
        if not self.departures.take(key, status):
            return False
        if status.state is OrderState.REFUSED:
            self.in_flight.pop(key, None)
        elif robot := self.in_flight.get(key):
            self._depart_if_recorded(key, robot)
        return True

    def _depart_if_recorded(self, key: DeploymentKey, robot: Robot) -> None:
        status = self.departures.status(key)
        if status is not None and status.state is OrderState.DEPARTED:
            is_recorded = (key, status.content) in self._acknowledged
            robot.has_departed |= is_recorded or not self.values['recorded']

    def take_action(self, action: OperatorAction) -> bool:
        """Take an action of the operator; return whether it is new."""
        if not self.operator.apply(action):
            return False
        if action.action == Action.RESUME:
            self.release(*self.still_agents)
        return True

    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """Record a report, which ends its deployment unless it is refused."""
        try:
            return super().record_report(key, report)
        except ValueError as error:
            if key in self.held:
                self.hold_refused(key, error)
            raise

    def _assimilate(self, key: DeploymentKey, outcome: Observation, report: Report) -> None:
        self.reports[key] = report
        self.end(key, report.stamp if report.survived else None, moved=not outcome.is_unmoved)

    def end(self, key: DeploymentKey, reported: int | None = None, moved: bool = True) -> None:
        """Remove a deployment that was reported by its agent or given up."""
        self.held.pop(key, None)
        if robot := self.in_flight.pop(key, None):
            self._ended[str(key)] = key, robot
            self._still[key.agent] = 0 if moved else self._still[key.agent] + 1
        self.unmoved.discard(key)
        if not moved:
            self.unmoved.add(key)
        self.departures.end(key, reported)

    def hold(self, key: DeploymentKey, why: str, *, is_left_to_operator: bool) -> None:
        """Hold a deployment that is not over: it counts neither as evidence nor as a loss."""
        if robot := self.in_flight.get(key):
            robot.is_left_to_operator |= is_left_to_operator
            robot.await_again()
            self.held[key] = why

    def hold_refused(self, key: DeploymentKey, why: ValueError) -> None:
        """Hold a deployment whose report is refused; it is left to the operator."""
        self.hold(key, f'{IMPOSSIBLE}{why}', is_left_to_operator=True)

    def follow(self, refused: Mapping[str, str]) -> None:
        """Hold the deployments whose reports the estimator refuses."""
        # A later report of the same deployment may have been accepted.
        for key in [key for key, why in self.held.items() if why.startswith(REFUSED)]:
            if str(key) not in refused:
                self.end(key)
        for key, robot in [self._ended.pop(name) for name in refused if name in self._ended]:
            self.in_flight[key] = robot
            self.unmoved.discard(key)
            self.forget(key)
            self.reports.pop(key, None)
            self.hold(key, f'{REFUSED}{refused[str(key)]}', is_left_to_operator=True)

    def leave(self, agent: str) -> None:
        """Await the robots of an agent that stood at its base."""
        for key in [key for key in self.held if key.agent == agent and key in self.in_flight]:
            if not self.in_flight[key].is_left_to_operator:
                del self.held[key]
                self.in_flight[key].await_again()

    def release(self, *agents: str) -> None:
        """Give orders again to agents whose robots came back without a step."""
        for agent in agents:
            del self._still[agent]

    # Answers.

    @property
    def orders(self) -> list[DeploymentKey]:
        """Return the deployments with a known path, in deployment order."""
        return sorted(self.paths, key=deployment_order)

    @property
    def robots_left(self) -> int:
        """Return the number of robots sent, without refused orders."""
        return len(self.paths) - len(self.departures.refused & self.paths.keys())

    @property
    def paths_in_flight(self) -> dict[DeploymentKey, NDArray[np.intp]]:
        """Return the paths of the robots in flight."""
        return {key: self.paths[key] for key in self.in_flight}

    @property
    def undeparted(self) -> list[DeploymentKey]:
        """Return the robots in flight whose agents have not reported a departure."""
        if self.values['presume_departure']:
            return []
        return [key for key in self.in_flight if not self.is_away(key)]

    def is_away(self, key: DeploymentKey) -> bool:
        """Return whether a robot in flight is known to have departed."""
        robot = self.in_flight[key]
        is_on_record = robot.is_recorded or not self.values['recorded']
        return robot.has_departed or (self.values['presume_departure'] and is_on_record)

    def has_departed(self, key: DeploymentKey) -> bool:
        """Return whether a robot reported its departure, or its outcome is known."""
        status = self.departures.status(key)
        says_so = status is not None and status.state is OrderState.DEPARTED
        return says_so or self.outcome(key) is not None

    def outcome(self, key: DeploymentKey) -> Observation | None:
        """Return the outcome of a robot; None if it is in flight, or stays at the base."""
        return None if key in self.departures.refused else self.outcomes.get(key)

    @property
    def still_agents(self) -> list[str]:
        """Return the agents whose last robots came back without a step."""
        return [agent for agent, times in self._still.items() if times >= MAX_STILL]

    def known(self, mission: int) -> int:
        """Return the number of known deployments of a mission, from any planner."""
        return self.robots_left + sum(each == mission for each in self._others.values())

    def forgotten(self, kept: int) -> int:
        """Return the number of deployments beyond the last `kept` of each agent."""
        return sum(max(0, sent - kept) for sent in self._sent_by_agent.values())

    def overdue(self, now: int, longest: Callable[[DeploymentKey], int]) -> list[DeploymentKey]:
        """Return the robots that have timed out, `longest` nanoseconds after their departure."""
        jump, self._time = min(0, now - self._time), now
        if now <= 0:
            return []
        overdue = []
        for key, robot in self.in_flight.items():
            if robot.is_left_to_operator or not self.is_away(key):
                continue
            # Shift the timeout if the clock was set back.
            robot.due = now + longest(key) if robot.due is None else robot.due + jump
            was_overdue, robot.is_overdue = robot.is_overdue, now > robot.due
            # Time out at the second check, since reports that arrived during a search are read
            # between the checks.
            if was_overdue and robot.is_overdue:
                overdue.append(key)
        return overdue


def remember(known: OrderedDict[K, V], key: K, value: V) -> None:
    """Add an entry, and drop the oldest beyond `MAX_REMEMBERED`."""
    known[key] = value
    if len(known) > MAX_REMEMBERED:
        known.popitem(last=False)
