# SPDX-License-Identifier: Apache-2.0
"""The state of a mission at its base: a fold over all that is said of it."""

from __future__ import annotations

from collections import Counter, defaultdict, OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from kbnitp_ros.core import DeploymentKey, Grid, Observation, Report, RobotType
from kbnitp_ros.core.inference.record import (
    deployment_order,
    MissionRecord,
    OPEN,
    OrderState,
    Standing,
    Verdict,
)
from kbnitp_ros.messages.deployments import AgentStatus
from kbnitp_ros.messages.operator_actions import Action, OperatorAction, OperatorState
from kbnitp_ros.messages.standings import Standings
import numpy as np
from numpy.typing import ArrayLike, NDArray

K = TypeVar('K')
V = TypeVar('V')

# Maximum number of robots of a mission.
MAX_ROBOTS = 20_000

# Number of returns without a step, one after another, after which an agent gets no more orders.
MAX_STILL = 2

# Maximum numbers of acknowledgements and of statuses kept until their paths arrive.
MAX_REMEMBERED = 1000

# Parameters of a mission that is read from its log: robots depart once the log has their status.
LOGGED: Mapping[str, Any] = MappingProxyType({'recorded': True, 'presume_departure': False})


class MissingError(ValueError):
    """A message refers to another message that has not arrived or is not in the log."""


class LackingError(ValueError):
    """An estimator lacks evidence that its predecessor had judged."""


class EvidenceName(NamedTuple):
    """The name of the evidence that counts, which beliefs, decisions and draws state."""

    # Start of the estimator, nanoseconds.
    epoch: int
    # Number of judgements since then that changed the evidence.
    changes: int


@dataclass
class Robot:
    """A robot in flight: its path was sent, and its deployment is not over."""

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
    # Whether only the operator can declare the robot lost: it was in another field, or away from
    # its base without its journal.
    is_left_to_operator: bool = False

    def await_again(self) -> None:
        """Give the robot its whole time again."""
        self.due, self.is_overdue = None, False


class BaseState(MissionRecord):
    """The standings of a mission, its robots in flight, and what the operator ordered."""

    # What counts of a deployment follows from the standings alone, which an estimator publishes.

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
        values: Mapping[str, Any] = LOGGED,
    ) -> None:
        super().__init__(grid, max_steps, robot_types)
        self.values = values
        # The evidence that counts, and the events of its epoch that were followed; the epoch is 0
        # before the first standings.
        self.evidence = EvidenceName(0, 0)
        self.events = 0
        # What the operator ordered.
        self.operator = OperatorState()
        # The robots in flight, in the order in which they were sent.
        self.in_flight: dict[DeploymentKey, Robot] = {}
        # Time at which each path was sent, nanoseconds.
        self.sent: dict[DeploymentKey, int] = {}
        # Deployments that came back without a step; number of deployments that are over, apart
        # from refused orders; orders that were refused.
        self.unmoved: set[DeploymentKey] = set()
        self.ended = 0
        self.void: set[DeploymentKey] = set()
        # Hashes of the remarks of people that were judged.
        self.remarks: frozenset[int] = frozenset()
        # Deployments with a report or a refusal that was not judged, in order of arrival.
        self.unjudged: dict[DeploymentKey, None] = {}
        # The first status of each order with each state.
        self._said: dict[DeploymentKey, dict[OrderState, AgentStatus]] = defaultdict(dict)
        # Acknowledgements and statuses received before this planner sends their paths, as
        # after a restart.
        self._acknowledged: OrderedDict[tuple[DeploymentKey, int], None] = OrderedDict()
        self._early: OrderedDict[tuple[DeploymentKey, OrderState], AgentStatus] = OrderedDict()
        # Deployments by agent, and the stamp up to which returns without a step are forgiven.
        self._by_agent: dict[str, list[DeploymentKey]] = defaultdict(list)
        self._forgiven: Counter[str] = Counter()
        # Missions of deployments that other planners sent.
        self._others: dict[DeploymentKey, int] = {}
        # Deployments that are judged, and whose paths are not known.
        self._pathless: set[DeploymentKey] = set()
        # Robots whose deployments are over, since an estimator may take that back.
        self._over: dict[DeploymentKey, Robot] = {}
        self._time = 0

    # Events: paths, acknowledgements, statuses, reports, standings and actions.

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
                self._by_agent[key.agent].append(key)
                self._others.pop(key, None)
                self._pathless.discard(key)
                for state in OrderState:
                    if status := self._early.pop((key, state), None):
                        # Contradictions were refused when they arrived.
                        with suppress(ValueError):
                            self.take_status(key, status)
                if self.standings.get(key, OPEN).verdict.is_over:
                    self._over[key] = self.in_flight.pop(key)
                self._note_unjudged(key)

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
            remember(self._early, (key, status.state), status)
            raise MissingError(
                f'status {status.state.name} of deployment {key}: this planner has not sent it'
            )
        said = self._said[key]
        known = said.get(status.state)
        if known and (known.stamp, known.content) <= (status.stamp, status.content):
            if status.state is OrderState.DEPARTED and status.content != known.content:
                raise ValueError(
                    f'another departure of deployment {key} counts (do two robots have the name '
                    f'{key.agent}?)'
                )
            return False
        said[status.state] = status
        self.record_status(key, status.state, status.stamp)
        self._note_unjudged(key)
        if robot := self.in_flight.get(key):
            self._depart_if_recorded(key, robot)
        if known is None and {OrderState.REFUSED, OrderState.DEPARTED} <= said.keys():
            raise ValueError(
                f'deployment {key} was refused by its agent and has departed, which counts (do '
                f'two robots have the name {key.agent}?)'
            )
        return known is None

    def _depart_if_recorded(self, key: DeploymentKey, robot: Robot) -> None:
        if departed := self._said[key].get(OrderState.DEPARTED):
            is_recorded = (key, departed.content) in self._acknowledged
            robot.has_departed |= is_recorded or not self.values['recorded']

    def take_action(self, action: OperatorAction) -> bool:
        """Take an action of the operator; return whether it is new."""
        if not self.operator.apply(action):
            return False
        if action.action == Action.RESUME:
            for agent in self._by_agent:
                self.forgive(agent)
        return True

    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """Record a report, which waits to be judged; raise ValueError if it cannot count."""
        try:
            return super().record_report(key, report)
        finally:
            self._note_unjudged(key)

    def follow(self, said: Standings) -> bool:
        """
        Follow the standings of an estimator; return whether anything is new.

        Raises
        ------
        MissingError
            If standings before these were missed: complete ones are needed.
        LackingError
            If a later estimator has not judged all that its predecessor had.
        ValueError
            If they are of an earlier estimator.

        """
        own = self.evidence.epoch
        if said.epoch < own:
            raise ValueError(
                f'epoch is {said.epoch}: standings of an estimator that began at {own} count'
            )
        if said.epoch == own and said.events <= self.events:
            return False
        if said.since and (said.epoch > own or said.since != self.events):
            raise MissingError(
                f'since is {said.since}: {self.events} events of epoch {own} were followed, so '
                'that standings in between are missing'
            )
        if said.is_complete:
            absent = self.standings.keys() - said.standings.keys()
            lacking = [key for key in absent if self.standings[key].judged]
            unsaid = self.remarks.difference(said.remarks)
            if (lacking or unsaid) and said.epoch > own:
                what = f'{len(unsaid)} remarks of people'
                if lacking:
                    first = min(lacking, key=deployment_order)
                    what = f'{len(lacking)} judged deployments, such as {first},'
                raise LackingError(
                    f'{what} are missing: the estimator was started without the evidence of this '
                    'mission; start it with the parameter resume set to the log'
                )
            for key in absent:
                self.stand(key, OPEN)
        self.evidence = EvidenceName(said.epoch, said.changes)
        self.events, self.remarks = said.events, frozenset(said.remarks)
        for key, standing in said.standings.items():
            self.stand(key, standing)
        return True

    def stand(self, key: DeploymentKey, standing: Standing) -> None:
        """Set what counts of a deployment."""
        before = self.standings.get(key, OPEN).verdict
        super().stand(key, standing)
        verdict = standing.verdict
        counts = (Verdict.OPEN, Verdict.HELD, Verdict.VOID)
        self.ended += (verdict not in counts) - (before not in counts)
        for place, member in ((self.unmoved, Verdict.UNMOVED), (self.void, Verdict.VOID)):
            place.discard(key)
            if verdict is member:
                place.add(key)
        if key not in self.paths:
            self._pathless.add(key)
            return
        if verdict.is_over and key in self.in_flight:
            self._over[key] = self.in_flight.pop(key)
        elif not verdict.is_over and key in self._over:
            robot = self.in_flight[key] = self._over.pop(key)
            robot.await_again()
            robot.is_recorded |= (key, self.path_contents[key]) in self._acknowledged
            self._depart_if_recorded(key, robot)
        self._note_unjudged(key)

    def _note_unjudged(self, key: DeploymentKey) -> None:
        """Note whether a report or a refusal of a deployment was not judged yet."""
        standing = self.standings.get(key, OPEN)
        reports = {report.content for report in self.heard.get(key, ())}
        is_refused = self.is_refused(key) and standing.verdict is Verdict.OPEN
        if key in self.paths and (is_refused or reports - standing.judged):
            self.unjudged[key] = None
        else:
            self.unjudged.pop(key, None)

    def hold(self, key: DeploymentKey, why: str, *, is_left_to_operator: bool) -> None:
        """Hold a deployment whose robot was heard of: it is not lost."""
        if robot := self.in_flight.get(key):
            robot.is_left_to_operator |= is_left_to_operator
            robot.await_again()
            self.held[key] = why

    def leave(self, agent: str) -> None:
        """Await the robots of an agent that stood at its base."""
        for key in [key for key in self.held if key.agent == agent and key in self.in_flight]:
            is_judged = self.standings.get(key, OPEN).verdict is Verdict.HELD
            if not is_judged and not self.in_flight[key].is_left_to_operator:
                del self.held[key]
                self.in_flight[key].await_again()

    def forgive(self, agent: str) -> None:
        """Give orders again to an agent whose robots came back without a step."""
        if sent := self._by_agent.get(agent):
            self._forgiven[agent] = max(self._forgiven[agent], sent[-1].stamp)

    # Answers.

    @property
    def orders(self) -> list[DeploymentKey]:
        """Return the deployments with a known path, in deployment order."""
        return sorted(self.paths, key=deployment_order)

    @property
    def kept_orders(self) -> list[DeploymentKey]:
        """Return `orders` without those that were refused."""
        return [key for key in self.orders if key not in self.void]

    @property
    def robots_left(self) -> int:
        """Return the number of robots sent, without refused orders."""
        return len(self.paths) + len(self._pathless) - len(self.void)

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

    def is_on_record(self, key: DeploymentKey) -> bool:
        """Return whether all that waits to be judged of a deployment is acknowledged."""
        if not self.values['recorded']:
            return True
        standing = self.standings.get(key, OPEN)
        waiting = {report.content for report in self.heard.get(key, ())} - standing.judged
        if self.is_refused(key) and standing.verdict is Verdict.OPEN:
            waiting.add(self._said[key][OrderState.REFUSED].content)
        return all((key, content) in self._acknowledged for content in waiting)

    def has_departed(self, key: DeploymentKey) -> bool:
        """Return whether a robot reported its departure, or was reported itself."""
        return OrderState.DEPARTED in self.statuses.get(key, ()) or bool(self.heard.get(key))

    def status(self, key: DeploymentKey) -> AgentStatus | None:
        """Return the status of an order that counts: of a departure before any other."""
        said = self._said.get(key, {})
        order = (OrderState.DEPARTED, OrderState.REFUSED, OrderState.ACCEPTED)
        return next((said[state] for state in order if state in said), None)

    def report(self, key: DeploymentKey) -> Report | None:
        """Return the report by which a deployment stands; None without one."""
        standing = self.standings.get(key, OPEN)
        if standing.verdict in (Verdict.OPEN, Verdict.HELD, Verdict.VOID):
            return None
        reports = self.heard.get(key, ())
        return next((each for each in reports if each.content == standing.report), None)

    def heard_hashes(self, key: DeploymentKey) -> tuple[int, ...]:
        """Return the hashes of all reports of a deployment, which the operator settles."""
        return tuple(sorted(report.content for report in self.heard.get(key, ())))

    def outcome(self, key: DeploymentKey) -> Observation | None:
        """Return the outcome of a robot; None if nothing counts."""
        report = self.report(key)
        if report is None:
            return None
        outcome = self.heard[key][report].outcome
        known = self.annotations.get(self.standings[key].annotation)
        return outcome if known is None else known[1].applied(self.paths[key], outcome)

    @property
    def outcomes(self) -> dict[DeploymentKey, Observation]:
        """Return the outcomes of the deployments that are over, in deployment order."""
        found = ((key, self.outcome(key)) for key in self.orders)
        return {key: outcome for key, outcome in found if outcome is not None}

    @property
    def gone_agents(self) -> set[str]:
        """Return the agents whose last robot is out, or lost as the operator said."""
        last = (sent[-1] for sent in self._by_agent.values())
        back = (Verdict.RETURN, Verdict.UNMOVED)
        return {
            key.agent
            for key in last
            if key in self.in_flight
            or (
                key in self.operator.given_up and self.standings.get(key, OPEN).verdict not in back
            )
        }

    @property
    def still_agents(self) -> list[str]:
        """Return the agents whose last robots came back without a step."""
        still = []
        for agent, sent in self._by_agent.items():
            ended = (key for key in reversed(sent) if key in self._over and key not in self.void)
            last = [key for key, _ in zip(ended, range(MAX_STILL))]
            is_still = all(
                key in self.unmoved and key.stamp > self._forgiven[agent] for key in last
            )
            if is_still and len(last) == MAX_STILL:
                still.append(agent)
        return still

    def known(self, mission: int) -> int:
        """Return the number of known deployments of a mission, from any planner."""
        return self.robots_left + sum(each == mission for each in self._others.values())

    def overdue(self, now: int, longest: Callable[[DeploymentKey], int]) -> list[DeploymentKey]:
        """Return the robots that have timed out, `longest` nanoseconds after their departure."""
        jump, self._time = min(0, now - self._time), now
        if now <= 0:
            return []
        overdue = []
        for key, robot in self.in_flight.items():
            is_reported = key in self.unjudged or key in self.standings
            if robot.is_left_to_operator or is_reported or not self.is_away(key):
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
