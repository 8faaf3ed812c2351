# SPDX-License-Identifier: Apache-2.0
"""What a log has on record of the deployments: their paths and their reports."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from kbnitp_ros.core import DeploymentKey, Grid, Kind, Outcome, Register, Report
from kbnitp_ros.log.bag import LoggedMessage, read_log, same_types
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.deployments import agent_of, key_of_path, read_path, read_report

BELIEF = 'kbnitp_msgs/msg/BeliefMaps'
GRID = 'nav_msgs/msg/OccupancyGrid'
MODEL = 'kbnitp_msgs/msg/ModelBelief'
PATH = 'nav_msgs/msg/Path'
REPORT = 'kbnitp_msgs/msg/DeploymentReport'

# Of a refusal, in characters: a report may name any number of cells.
LONGEST = 500

# A deployment and how it ended, as one message had it.
Reported = tuple[DeploymentKey, Report]


def record(register: Register, logged: LoggedMessage) -> bool:
    """
    Tell a register of a path or a report on record, as the estimator is told when it comes.

    Returns
    -------
    bool
        Whether an outcome is another one now.

    Raises
    ------
    ValueError
        If it is refused.

    """
    agent = agent_of(logged.topic)
    if logged.type_name == REPORT:
        return register.record_report(*read_report(logged.message, agent))
    if key_of_path(logged.topic, logged.message) is None:
        return False
    return register.record_path(*read_path(register.grid, agent, logged.message))


def first_belief(log: str | Path) -> Snapshot | None:
    """
    Return the first belief on record; None if there is none that can be read.

    Raises
    ------
    LogError
        If the log cannot be read.

    """
    with same_types(log):
        for logged in read_log(log, (BELIEF,)):
            with suppress(ValueError):
                return read_belief_maps(logged.message)
    return None


def last_belief(log: str | Path) -> Snapshot | None:
    """
    Return the last of the beliefs on record that hold the most deployments; None if there is none.

    Raises
    ------
    LogError
        If the log cannot be read.

    """
    last, most = None, -1
    with same_types(log):
        for logged in read_log(log, (BELIEF,)):
            with suppress(ValueError):
                if logged.message.deployments >= most:
                    last = read_belief_maps(logged.message)
                    most = last.deployments
    return last


def check_same_field(log: str | Path, grid: Grid) -> Snapshot | None:
    """
    Return the first belief on record, after a check that it is on this grid.

    Raises
    ------
    LogError
        If the log cannot be read.
    ValueError
        If it is on another grid.

    """
    belief = first_belief(log)
    if belief and belief.grid != grid:
        raise ValueError(f'{log} is of a mission on {belief.grid}: the parameters say {grid}')
    return belief


class Evidence(Register):
    """
    The deployments of a log, judged as the estimator judges them.

    Attributes
    ----------
    said : list of (DeploymentKey, Report)
        What fits its path: of each deployment all returns that differ and the first loss after
        each number of steps known to be survived, in the order in which path and report were both
        on record.
    reports : dict
        By deployment, in the order in which they were reported: the reports that count.
    refused : list of str
        What no estimator takes, and why.

    """

    def __init__(
        self, grid: Grid, max_steps: int, kinds: Mapping[str, Kind] = MappingProxyType({})
    ) -> None:
        super().__init__(grid, max_steps, kinds)
        # The most steps of all robots, and of those that have a number of their own.
        self._rules = [(max_steps, own_steps(kinds))]
        self.said: list[Reported] = []
        self.reports: dict[DeploymentKey, Report] = {}
        self.refused: list[str] = []
        self._said: set[tuple[DeploymentKey, Outcome]] = set()
        self._by_stamp: dict[tuple[DeploymentKey, int], list[Report]] = {}
        self._misfits: dict[DeploymentKey, str] = {}

    def allow(self, max_steps: int, kinds: Mapping[str, Kind]) -> None:
        """Take paths that are as long as the estimator of some belief takes them."""
        if (rules := (max_steps, own_steps(kinds))) not in self._rules:
            self._rules.append(rules)
        self.max_steps = max(self.max_steps, max_steps)

    def most_steps(self, key: DeploymentKey) -> int:
        """Return the most steps that the path of a deployment may have."""
        return max(own.get(key.agent, max_steps) for max_steps, own in self._rules)

    def take(self, logged: LoggedMessage) -> None:
        """Take note of a path or a report, or of why it is refused."""
        try:
            record(self, logged)
        except ValueError as error:
            self.refused.append(f'{logged.topic}: {error}'[:LONGEST])

    def _outcome(self, key: DeploymentKey, report: Report) -> Outcome:
        try:
            outcome = super()._outcome(key, report)
        except ValueError as error:
            self._misfits.setdefault(key, str(error)[:LONGEST])
            raise
        at_once = self._by_stamp.setdefault((key, report.stamp), [])
        if report not in at_once:
            at_once.append(report)
        said = key, outcome
        if said not in self._said:
            self._said.add(said)
            self.said.append((key, report))
        return outcome

    def _take_in(self, key: DeploymentKey, outcome: Outcome, report: Report) -> None:
        self.reports[key] = report
        if key in self.contradicted:
            self.refused.append(self.contradicted[key][:LONGEST])

    def report_of(self, key: DeploymentKey, stamp: int) -> Report:
        """Return the first of what `reports_at` does."""
        return self.reports_at(key, stamp)[0]

    def reports_at(self, key: DeploymentKey, stamp: int) -> list[Report]:
        """
        Return the reports of a deployment of this time, or else the one that counts.

        A report that was not on disk yet when recorder and agent died is on record as it was made
        again, later; the belief knew of the first.

        Raises
        ------
        ValueError
            If none that fits is on record, or not the path.

        """
        if key not in self.paths:
            raise ValueError(f'path of deployment {key} is not on record')
        if key not in self.reports:
            raise ValueError(
                self._misfits.get(key, f'report of deployment {key} is not on record')
            )
        return self._by_stamp.get((key, stamp)) or [replace(self.reports[key], stamp=stamp)]

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
        return list(self._waiting)


def own_steps(kinds: Mapping[str, Kind]) -> dict[str, int]:
    """Return the most steps of the robots of agents that have such a number of their own."""
    return {agent: kind.max_steps for agent, kind in kinds.items() if kind.max_steps is not None}
