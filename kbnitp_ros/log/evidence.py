# SPDX-License-Identifier: Apache-2.0
"""What a log has on record of the deployments: their paths and their reports."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from kbnitp_ros.bag import LogError, LoggedMessage
from kbnitp_ros.core import (
    DeploymentKey,
    Deployments,
    Grid,
    Ledger,
    Observation,
    Report,
    RobotType,
)
from kbnitp_ros.log.roles import BELIEF, LONGEST, MissionLog, Role
from kbnitp_ros.messages.beliefs import (
    Assimilated,
    read_belief_maps,
    read_robot_types,
    Snapshot,
)
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.deployments import read_path, read_report
from numpy.typing import ArrayLike


def record(deployments: Deployments, role: Role, message: Any) -> bool:
    """Record a path or report as an estimator does; return whether an outcome changed."""
    content = content_hash(message)
    if role.name == 'report':
        key, report = read_report(message, role.agent)
        return deployments.record_report(key, replace(report, content=content))
    return deployments.record_path(*read_path(deployments.grid, role.agent, message), content)


def first_belief(log: MissionLog) -> Snapshot | None:
    """Return the first belief on record; None if there is none that can be read."""
    return next((read_belief_maps(each.message) for _, each in log.read('belief')), None)


def required_belief(log: MissionLog) -> Snapshot:
    """Return the first belief on record; raise a LogError if none can be read."""
    if belief := first_belief(log):
        return belief
    raise LogError(
        f'{log.path} has no beliefs on record that can be read: it must have messages of type '
        f'{BELIEF} on {log.roles.names["belief"]}'
    )


def begun(prior: Snapshot) -> Ledger:
    """Return the ledger of a mission on record before its first deployment."""
    try:
        ledger = prior.ledger()
    except ValueError as error:
        raise LogError(f'the beliefs on record cannot be computed: {error}') from error
    if prior.version != ledger.estimator.version:
        raise LogError(
            f'beliefs are on record by version {prior.version} of {prior.method}: this '
            f'kbnitp_ros computes version {ledger.estimator.version}; replay it with one that '
            'computes that'
        )
    return ledger


def last_belief(log: MissionLog) -> Snapshot | None:
    """Return the last of the recorded beliefs that hold the most deployments."""
    last, most = None, -1
    for _, logged in log.read('belief'):
        if logged.message.deployments >= most:
            last, most = logged.message, logged.message.deployments
    return None if last is None else read_belief_maps(last)


def check_same_field(
    log: MissionLog, grid: Grid, robot_types: Mapping[str, RobotType]
) -> Snapshot | None:
    """Return the first recorded belief; raise ValueError if its grid or bases are others."""
    belief = first_belief(log)
    if belief and belief.grid != grid:
        raise ValueError(f'{log.path} is of a mission on {belief.grid}: the parameters say {grid}')
    for agent, robot_type in robot_types.items():
        before = belief.base_of(agent) if belief else grid.at(robot_type.base).base
        if before != (now := grid.at(robot_type.base).base):
            raise ValueError(
                f'{log.path} is of a mission in which the base of {agent} is {before}, and by the '
                f'parameters it is {now}: a base is fixed for a mission; begin another one, with '
                'prior.log'
            )
    return belief


class GapError(ValueError):
    """A belief on record that nothing can be compared with, since the log lacks something."""


class Evidence(Deployments):
    """The deployments of a log, judged as the estimator judges them."""

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    ) -> None:
        super().__init__(grid, max_steps, robot_types)
        # The most steps of all robots, and of those that have a number of their own.
        self._rules = [(max_steps, own_steps(robot_types))]
        # By deployment, in the order in which they were reported: the reports that count.
        self.reports: dict[DeploymentKey, Report] = {}
        # What no estimator takes, and why.
        self.refused: list[str] = []
        # All that was read, by the hashes of the messages; by their times, the reports that fit.
        self._paths_read: dict[tuple[DeploymentKey, int], ArrayLike] = {}
        self._reports_read: dict[tuple[DeploymentKey, int], Report] = {}
        self._by_stamp: dict[DeploymentKey, dict[int, Report]] = defaultdict(dict)

    def allow(self, max_steps: int, robot_types: Mapping[str, RobotType]) -> None:
        """Take paths that are as long as the estimator of some belief takes them."""
        if (rules := (max_steps, own_steps(robot_types))) not in self._rules:
            self._rules.append(rules)
        self.max_steps = max(self.max_steps, max_steps)

    def pass_belief(self, belief: Any) -> None:
        """Go past a kbnitp_msgs/BeliefMaps; if it is none that is said when it is read."""
        with suppress(ValueError):
            self.allow(belief.max_steps, read_robot_types(belief.own))

    def most_steps(self, key: DeploymentKey) -> int:
        """Return the most steps that the path of a deployment may have."""
        return max(own.get(key.agent, max_steps) for max_steps, own in self._rules)

    def take(self, role: Role, logged: LoggedMessage) -> None:
        """Take note of a path or a report, or of why it is refused."""
        with self.refusals(logged.topic):
            record(self, role, logged.message)

    @contextmanager
    def refusals(self, topic: str) -> Iterator[None]:
        """Take note of why a message is refused."""
        try:
            yield
        except ValueError as error:
            self.refused.append(f'{topic}: {error}'[:LONGEST])

    def record_path(self, key: DeploymentKey, path: ArrayLike, content: int = 0) -> bool:
        """Take note of a path, also of one that is not the first of its deployment."""
        self._paths_read.setdefault((key, content), path)
        return super().record_path(key, path, content)

    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """Take note of a report, also of one that does not count."""
        self._reports_read.setdefault((key, report.content), report)
        return super().record_report(key, report)

    def _outcome(self, key: DeploymentKey, report: Report) -> Observation:
        outcome = super()._outcome(key, report)
        self._by_stamp[key].setdefault(report.stamp, report)
        return outcome

    def _assimilate(self, key: DeploymentKey, outcome: Observation, report: Report) -> None:
        self.reports[key] = report
        if key in self.contradicted:
            self.refused.append(self.contradicted[key][:LONGEST])

    def report_of(self, key: DeploymentKey, stamp: int) -> Report:
        """Return the first report of a deployment of this time, or else the one that counts."""
        return self._by_stamp[key].get(stamp, self.reports[key])

    def named(self, evidence: Assimilated, stamp: int) -> tuple[ArrayLike, Report]:
        """Return the path and the report of a deployment that a belief of a time names."""
        key = evidence.key
        if (key, evidence.path) not in self._paths_read:
            raise ValueError(f'path of deployment {key} is not on record')
        if found := self._reports_read.get((key, evidence.report)):
            return self._paths_read[key, evidence.path], found
        missing = f'report of deployment {key} is not on record'
        if min(self._by_stamp[key], default=stamp) > stamp:
            raise GapError(f'{missing}, but a later one')
        raise ValueError(missing)

    @property
    def survived(self) -> int:
        """How many of the deployments reported came back."""
        return sum(report.survived for report in self.reports.values())

    @property
    def without_report(self) -> list[DeploymentKey]:
        """Deployments whose end is not on record: the robot was still out."""
        return [key for key in self.paths if key not in self.reports]

    @property
    def without_path(self) -> list[DeploymentKey]:
        """Deployments whose end is on record but not their path."""
        return list(self._pending)


def own_steps(robot_types: Mapping[str, RobotType]) -> dict[str, int]:
    """Return the most steps of the robots of agents that have such a number of their own."""
    return {
        agent: robot_type.max_steps
        for agent, robot_type in robot_types.items()
        if robot_type.max_steps is not None
    }
