# SPDX-License-Identifier: Apache-2.0
"""The evidence of a mission in its log, read in one pass: paths, departures and reports."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Any

from kbnitp_ros.base.state import BaseState, LackingError, LOGGED, MissingError
from kbnitp_ros.core import DeploymentKey, Grid, Ledger, ORDINARY, Report, RobotType
from kbnitp_ros.core.inference.record import MissionRecord, Verdict
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import LoggedMessage
from kbnitp_ros.log.roles import MAX_SHOWN, MissionLog, Role
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.deployments import read_cells, Source
from kbnitp_ros.messages.headers import content_hash
from kbnitp_ros.messages.operator_actions import (
    Action,
    OperatorAction,
    OperatorState,
    read_operator_action,
)
from kbnitp_ros.messages.remarks import Remark
from kbnitp_ros.messages.topics import BELIEF, REMARKS


def fold_evidence(
    deployments: MissionRecord,
    messages: Iterable[tuple[Role, LoggedMessage]],
    mission: int | None,
) -> int:
    """Record the paths, reports and statuses of a mission; return the last epoch on record."""
    last = 0
    for role, logged in messages:
        if role.name == 'standings':
            last = max(last, logged.said.epoch)
        elif is_of_mission(role, logged, mission):
            # What was refused before is refused again.
            with suppress(ValueError):
                record(deployments, role, logged)
    return last


def record(deployments: MissionRecord, role: Role, logged: LoggedMessage) -> bool:
    """Record a path, report or status as an estimator does; return whether evidence changed."""
    if role.name == 'status':
        key, status = logged.said
        return deployments.record_status(key, status.state, status.stamp)
    if role.name == 'report':
        return deployments.record_report(*logged.said)
    if role.name in REMARKS:
        assert isinstance(deployments, Ledger)
        logged.said.record(deployments)
        return True
    path = read_cells(deployments.grid, logged.message)
    return deployments.record_path(logged.said[0], path, content_hash(logged.message))


def first_belief(log: MissionLog) -> Snapshot | None:
    """Return the first readable belief; None if there is none."""
    return next((each.said for _, each in log.read('belief')), None)


def required_belief(log: MissionLog) -> Snapshot:
    """Return the first readable belief; raise a LogError if there is none."""
    if belief := first_belief(log):
        return belief
    raise LogError(
        f'{log.path} has no readable beliefs: it must have messages of type {BELIEF} on '
        f'{log.roles.names["belief"]}'
    )


def begun(prior: Snapshot) -> Ledger:
    """Return the ledger of a recorded mission before its first deployment."""
    try:
        ledger = prior.ledger()
    except ValueError as error:
        raise LogError(f'the beliefs on record cannot be computed: {error}') from error
    if prior.version != ledger.estimator.version:
        raise LogError(
            f'the beliefs were computed by version {prior.version} of {prior.method}, and this '
            f'kbnitp_ros computes version {ledger.estimator.version}: use the kbnitp_ros that '
            'recorded the log'
        )
    return ledger


def last_belief(log: MissionLog) -> Snapshot | None:
    """Return the recorded belief with the most deployments; the latest if several have as many."""
    last: Snapshot | None = None
    for _, logged in log.read('belief'):
        if last is None or logged.said.deployments >= last.deployments:
            last = logged.said
    return last


def check_same_field(
    log: MissionLog, grid: Grid, robot_types: Mapping[str, RobotType]
) -> Snapshot | None:
    """Return the first recorded belief; raise ValueError if its grid or bases differ."""
    belief = first_belief(log)
    if belief and belief.grid != grid:
        raise ValueError(
            f'{log.path} is of a mission on {belief.grid}, but the parameters set {grid}'
        )
    for agent, robot_type in robot_types.items():
        before = belief.agent_base(agent) if belief else grid.at(robot_type.base).base
        if before != (now := grid.at(robot_type.base).base):
            raise ValueError(
                f'{log.path} is of a mission in which the base of {agent} is {before}, but the '
                f'parameters set {now}: bases cannot change: set prior.log to this log instead of '
                'resume'
            )
    return belief


class RecordedMission(BaseState):
    """The state of a recorded mission, with all that was ever said of its paths and reports."""

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
        mission: int | None = None,
        values: Mapping[str, Any] = LOGGED,
    ) -> None:
        super().__init__(grid, max_steps, robot_types, values)
        # Start of the mission whose paths are accepted, nanoseconds; None for all missions.
        self.mission = mission
        # First belief of the mission, if it was read.
        self.prior: Snapshot | None = None
        # Step limits accepted: the common limit, with agents that may have their own.
        self._limits = [(max_steps, robot_types)]
        # Serialized paths by deployment, and serialized actions of the operator by stamp.
        self.messages: dict[DeploymentKey | int, bytes] = {}
        # Serialized reports of agents by deployment, and those of the planner, by deployment and
        # hash of the message.
        self.said_by_agent: dict[DeploymentKey, dict[int, bytes]] = defaultdict(dict)
        self.given_up: dict[tuple[DeploymentKey, int], bytes] = {}
        # Time of receipt of each report, nanoseconds.
        self.reported: dict[tuple[DeploymentKey, int], int] = {}
        # Index of each path among the paths, reports and statuses.
        self.places: dict[DeploymentKey, int] = {}
        self._count = 0
        # Remarks of people by the hash of the message, in order.
        self.said: dict[int, Remark] = {}
        # Messages that no estimator accepts, with the reason.
        self.refused: list[str] = []
        # All reports, by hash of the message.
        self._reports: dict[tuple[DeploymentKey, int], Report] = {}

    def allow(self, max_steps: int, robot_types: Mapping[str, RobotType]) -> None:
        """Accept paths up to these step limits, too."""
        if (max_steps, robot_types) not in self._limits:
            self._limits.append((max_steps, robot_types))
        self.max_steps = max(self.max_steps, max_steps)

    def most_steps(self, key: DeploymentKey) -> int:
        """Return the maximum number of steps of a deployment's path."""
        types = ((each.get(key.agent, ORDINARY), common) for common, each in self._limits)
        return max(common if own.max_steps is None else own.max_steps for own, common in types)

    def take(self, role: Role, logged: LoggedMessage) -> None:
        """Take a path, report, status, standings, action, or the step limits of a belief."""
        if role.name == 'operator':
            action = read_operator_action(self.grid, logged.message)
            if self.take_action(action):
                self.messages[action.stamp] = logged.data
        elif role.name in REMARKS:
            # A recorder that was restarted receives them again.
            remark = self.said.setdefault(logged.said.content, logged.said)
            if isinstance(remark.said, tuple):
                self.annotations[remark.content] = remark.said
        elif role.name == 'belief':
            self.allow(logged.said.max_steps, logged.said.robot_types)
        elif is_of_mission(role, logged, self.mission):
            try:
                self._take_evidence(role, logged)
            except ValueError as error:
                self.refused.append(f'{logged.topic}: {error}'[:MAX_SHOWN])

    def _take_evidence(self, role: Role, logged: LoggedMessage) -> None:
        if role.name == 'standings':
            # An estimator that lacks evidence is followed once it has it.
            with suppress(MissingError, LackingError):
                self.follow(logged.said)
            return
        self._count += 1
        # What is on record was acknowledged.
        if role.name == 'status':
            key, status = logged.said
            try:
                with suppress(MissingError):
                    self.take_status(key, status)
            finally:
                self.take_recorded(key, status.content)
        elif role.name == 'report':
            key, report = logged.said
            name = key, report.content
            self.reported.setdefault(name, logged.log_time)
            self._reports.setdefault(name, report)
            if logged.message.source == Source.AGENT:
                self.said_by_agent[key].setdefault(report.content, logged.data)
            else:
                self.given_up.setdefault(name, logged.data)
            self.take_recorded(key, report.content)
            self.record_report(key, report)
        else:
            key, path = logged.said[0], read_cells(self.grid, logged.message)
            content = content_hash(logged.message)
            try:
                self.take_path(key, path, content, logged.log_time)
                self.take_recorded(key, content)
            finally:
                if key in self.paths:
                    self.messages.setdefault(key, logged.data)
                    self.places.setdefault(key, self._count - 1)

    def find_report(self, key: DeploymentKey, stamp: int) -> Report | None:
        """Return a deployment's first report with this stamp, or else the report that counts."""
        reports = (each for (name, _), each in self._reports.items() if name == key)
        return next((each for each in reports if each.stamp == stamp), self.report(key))

    @property
    def actions(self) -> list[OperatorAction]:
        """Return the operator's actions in recorded order, without starts of the planner."""
        actions = self.operator.actions.values()
        return [action for action in actions if action.action != Action.START]

    @property
    def unreported_losses(self) -> dict[DeploymentKey, OperatorAction]:
        """Return the actions that gave up robots in flight, and whose losses are not on record."""
        return {
            key: action
            for key, action in self.operator.given_up.items()
            if key in self.in_flight
            and not any(
                report.settled is not None and {*action.settled} <= {*report.settled}
                for report in self.heard.get(key, ())
            )
        }

    @property
    def survived(self) -> int:
        """Return the number of robots that came back."""
        back = (Verdict.RETURN, Verdict.UNMOVED)
        return sum(standing.verdict in back for standing in self.standings.values())

    @property
    def without_report(self) -> list[DeploymentKey]:
        """Return the deployments with a path but no report."""
        return [key for key in self.paths if not self.heard.get(key)]

    @property
    def without_path(self) -> list[DeploymentKey]:
        """Return the deployments with a report but no path."""
        return list(self._pending)


def read_resumed(
    log: MissionLog,
    grid: Grid,
    max_steps: int,
    robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    values: Mapping[str, Any] = LOGGED,
) -> RecordedMission:
    """Read the record of a mission, to resume it on this grid with these robots."""
    prior = check_same_field(log, grid, robot_types)
    record = RecordedMission(grid, max_steps, robot_types, mission_start(log), values)
    record.prior = prior
    if prior:
        record.allow(prior.max_steps, prior.robot_types)
    roles = 'path', 'report', 'status', 'standings', 'operator', 'annotations'
    for role, logged in log.read(*roles):
        with log.leaving_out(logged):
            record.take(role, logged)
    return record


def read_newest_round(
    log: MissionLog, record: RecordedMission
) -> tuple[Snapshot, list[DeploymentKey]] | None:
    """Return the belief that the newest round was planned on, and the round's deployments."""
    # Beliefs do not count refused orders.
    keys = record.kept_orders
    planned_on = None
    for _, logged in log.read('belief'):
        held = logged.said.deployments
        if held < len(keys) and logged.said.stamp <= keys[held].stamp:
            planned_on = logged.said
    if planned_on is None:
        return None
    first = planned_on.deployments
    newest = {*keys[first:]}
    return planned_on, [
        key
        for key in record.orders
        if key in newest or (key not in keys and key.stamp >= planned_on.stamp)
    ]


def mission_start(log: MissionLog) -> int | None:
    """Return the start of the mission of a log, in nanoseconds; None if it has no belief."""
    stated: dict[int, None] = {}
    sent: dict[int, None] = {}
    for role, logged in log.read('belief', 'path'):
        if role.name == 'belief':
            stated.pop(logged.said.mission, None)
            stated[logged.said.mission] = None
        else:
            sent.setdefault(logged.said[1])
        for mission in sent:
            if mission in stated:
                return mission
    return next(reversed(stated), None)


def read_no_go(log: MissionLog, grid: Grid) -> list[tuple[int, ...]]:
    """Return the no-go cells of a mission, at first none, after each action of its operator."""
    no_go: list[tuple[int, ...]] = [()]
    state = OperatorState()
    for _, logged in log.read('operator', corrupt=[]):
        with log.leaving_out(logged):
            state.apply(read_operator_action(grid, logged.message))
            no_go.append(state.no_go)
    return no_go


def is_of_mission(role: Role, logged: LoggedMessage, mission: int | None) -> bool:
    """Return False for a path of another mission; other messages state no mission."""
    return mission is None or role.name != 'path' or logged.said[1] == mission


def read_ledger(log: MissionLog) -> Ledger:
    """Return the ledger of a recorded mission, with all its evidence."""
    prior = required_belief(log)
    if prior.deployments:
        raise LogError(
            f'{log.path} begins with a belief that holds {prior.deployments} deployments: the '
            'prior is not on record'
        )
    ledger, mission = begun(prior), mission_start(log)
    fold_evidence(ledger, log.read('path', 'report', 'status', *REMARKS), mission)
    return ledger
