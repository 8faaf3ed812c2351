# SPDX-License-Identifier: Apache-2.0
"""The evidence of a mission in its log, read in one pass: paths, departures and reports."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from kbnitp_ros.base.state import BaseState, LOGGED, MissingError
from kbnitp_ros.core import DeploymentKey, Grid, Ledger, Observation, ORDINARY, Report, RobotType
from kbnitp_ros.core.inference.record import MissionRecord
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import LoggedMessage
from kbnitp_ros.log.roles import BELIEF, MAX_SHOWN, MissionLog, Role
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.deployments import read_cells
from kbnitp_ros.messages.headers import content_hash
from kbnitp_ros.messages.operator_actions import OperatorAction, read_operator_action
from numpy.typing import ArrayLike


def record(deployments: MissionRecord, role: Role, logged: LoggedMessage) -> bool:
    """Record a path or report as an estimator does; return whether an outcome changed."""
    content = content_hash(logged.message)
    if role.name == 'report':
        key, report = logged.said
        return deployments.record_report(key, replace(report, content=content))
    path = read_cells(deployments.grid, logged.message)
    return deployments.record_path(logged.said[0], path, content)


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


# The kbnitp_ros that has an earlier version of a method.
EARLIER = {('kappa_bnitp_sampled', 2): ', 1.0'}


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
            f'recorded the log{EARLIER.get((prior.method, prior.version), "")}'
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
        # Time of receipt of each report by its stamp, nanoseconds.
        self.reported: dict[tuple[DeploymentKey, int], int] = {}
        # Messages that no estimator accepts, with the reason.
        self.refused: list[str] = []
        # All paths and all reports, by hash of the message; reports that match a path, by stamp.
        self._paths_read: dict[tuple[DeploymentKey, int], ArrayLike] = {}
        self._reports_read: dict[tuple[DeploymentKey, int], Report] = {}
        self._by_stamp: dict[DeploymentKey, dict[int, Report]] = defaultdict(dict)

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
        """Take a path, report, status, action, or the step limits of a belief."""
        if role.name == 'operator':
            action = read_operator_action(self.grid, logged.message)
            if self.take_action(action):
                self.messages[action.stamp] = logged.data
        elif role.name == 'belief':
            self.allow(logged.said.max_steps, logged.said.robot_types)
        elif is_of_mission(role, logged, self.mission):
            try:
                self._take_evidence(role, logged)
            except ValueError as error:
                self.refused.append(f'{logged.topic}: {error}'[:MAX_SHOWN])

    def _take_evidence(self, role: Role, logged: LoggedMessage) -> None:
        # What is on record was acknowledged.
        if role.name == 'status':
            key, status = logged.said
            with suppress(MissingError):
                self.take_status(key, status)
            self.take_recorded(key, status.content)
        elif role.name == 'report':
            key, report = logged.said
            self.reported.setdefault((key, report.stamp), logged.log_time)
            self.record_report(key, replace(report, content=content_hash(logged.message)))
        else:
            key, path = logged.said[0], read_cells(self.grid, logged.message)
            content = content_hash(logged.message)
            self._paths_read.setdefault((key, content), path)
            try:
                self.take_path(key, path, content, logged.log_time)
                self.take_recorded(key, content)
            finally:
                if key in self.paths:
                    self.messages.setdefault(key, logged.data)

    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """Record a report, also if another report of the same deployment counts."""
        self._reports_read.setdefault((key, report.content), report)
        return super().record_report(key, report)

    def _outcome(self, key: DeploymentKey, report: Report) -> Observation:
        outcome = super()._outcome(key, report)
        self._by_stamp[key].setdefault(report.stamp, report)
        return outcome

    def _assimilate(self, key: DeploymentKey, outcome: Observation, report: Report) -> None:
        super()._assimilate(key, outcome, report)
        if key in self.contradicted:
            self.refused.append(self.contradicted[key][:MAX_SHOWN])

    def find_report(self, key: DeploymentKey, stamp: int) -> Report:
        """Return a deployment's first report with this stamp, or else the report that counts."""
        return self._by_stamp[key].get(stamp, self.reports[key])

    def named(
        self, key: DeploymentKey, path: int, report: int, stamp: int
    ) -> tuple[ArrayLike, Report]:
        """Return the path and report with these hashes, which a belief with this stamp names."""
        if (key, path) not in self._paths_read:
            raise ValueError(f'path of deployment {key} is not on record')
        if found := self._reports_read.get((key, report)):
            return self._paths_read[key, path], found
        missing = f'report of deployment {key} is not on record'
        if min(self._by_stamp[key], default=stamp) > stamp:
            raise MissingError(f'{missing}, but a later report is')
        raise ValueError(missing)

    def has(self, key: DeploymentKey, path: int, report: int) -> bool:
        """Return whether the path and the report with these hashes are on record."""
        return (key, path) in self._paths_read and (key, report) in self._reports_read

    @property
    def actions(self) -> list[OperatorAction]:
        """Return the operator's actions in recorded order."""
        return [*self.operator.actions.values()]

    @property
    def survived(self) -> int:
        """Return the number of robots reported as returned."""
        return sum(report.survived for report in self.reports.values())

    @property
    def without_report(self) -> list[DeploymentKey]:
        """Return the deployments with a path but no report."""
        return [key for key in self.paths if key not in self.reports]

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
    record = RecordedMission(grid, max_steps, robot_types, read_mission(log), values)
    record.prior = prior
    if prior:
        record.allow(prior.max_steps, prior.robot_types)
    for role, logged in log.read('path', 'report', 'status', 'operator'):
        with log.leaving_out(logged):
            record.take(role, logged)
    return record


def read_newest_round(
    log: MissionLog, record: RecordedMission
) -> tuple[Snapshot, list[DeploymentKey]] | None:
    """Return the belief that the newest round was planned on, and the round's deployments."""
    # Beliefs do not count refused orders.
    keys = [key for key in record.orders if key not in record.departures.refused]
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


def read_mission(log: MissionLog) -> int | None:
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
    ledger, mission = begun(prior), read_mission(log)
    for role, logged in log.read('path', 'report'):
        if is_of_mission(role, logged, mission):
            # Evidence that raises here was refused by the estimator, too.
            with suppress(ValueError):
                record(ledger, role, logged)
    return ledger
