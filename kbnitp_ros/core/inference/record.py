# SPDX-License-Identifier: Apache-2.0
"""The record of a mission's evidence: paths, reports and outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from kbnitp_ros.core.field.check import in_short, typed, whole_number
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import of_each, ORDINARY, RobotType
import numpy as np
from numpy.typing import ArrayLike, NDArray

Self = TypeVar('Self', bound='MissionRecord')

# Maximum bytes of pending reports, and bytes that are kept if the maximum is exceeded.
MAX_PENDING, LEFT_PENDING = 50_000_000, 45_000_000
# Approximate bytes of a report, and of each of its readings.
REPORT, READING = 1000, 100

# Maximum steps of a robot's walk, in multiples of the maximum steps of its paths.
MAX_WALK = 10


class DeploymentKey(NamedTuple):
    """
    The key of a deployment.

    Attributes
    ----------
    agent : str
        Name of the robot.
    stamp : int
        Time when its path was published, nanoseconds of ROS time.

    """

    agent: str
    stamp: int

    def __str__(self) -> str:
        return f'{self.agent} at {self.stamp // 10**9}.{self.stamp % 10**9:09d}'


def deployment_order(key: DeploymentKey) -> tuple[int, str]:
    """Return the sorting key of deployments: stamp, then agent."""
    return key.stamp, key.agent


@dataclass(frozen=True)
class Report:
    """
    The outcome of a deployment as reported to the base.

    Attributes
    ----------
    survived : bool
        Whether the robot returned.
    readings : tuple of (int, int)
        The cell and the reading of the target sensor for each step of the robot, -1 for a step
        without a reading; empty for a lost robot.
    stamp : int
        Time when the base received the report, nanoseconds of ROS time; ignored in comparisons.
    steps_survived : int
        Number of steps that a lost robot is known to have survived.
    content : int
        Hash of the report's message, which identifies it in a log; 0 without a message.
    lost_at : tuple of float
        Likelihood of a loss in each step of a lost robot's path; empty if all are alike.
    entered : tuple of bool
        For each step whether the robot vouches for its cell; empty if it vouches for all.
    field_id : str
        `Grid.id` of the agent's field; '' if it is not stated. Ignored in comparisons.

    """

    survived: bool
    readings: tuple[tuple[int, int], ...] = ()
    stamp: int = field(default=0, compare=False)
    steps_survived: int = 0
    content: int = field(default=0, compare=False)
    lost_at: tuple[float, ...] = ()
    entered: tuple[bool, ...] = ()
    field_id: str = field(default='', compare=False)


class MissionRecord:
    """
    The paths and reports of a mission, in any order, with one outcome for each deployment.

    The first valid path of a deployment counts. If reports differ, whichever came first, a return
    counts rather than a loss, since the robot was only late; of two losses the one with the later
    contact or, at equal contacts, the narrower `lost_at`; of two returns (of robots that share a
    name) the one with more readings. All evidence is validated here: a refused report changes
    nothing.

    Parameters
    ----------
    grid : Grid
        Field that paths are checked against.
    max_steps : int
        Maximum steps of a path.
    robot_types : mapping of str to RobotType
        Robot types, with bases, of agents that are not of the common type.

    Attributes
    ----------
    paths : dict of DeploymentKey to ndarray of int, shape (steps + 1,)
        Known paths, in order of arrival.
    outcomes : dict of DeploymentKey to Observation
        Outcomes of the deployments with a known path and report.
    path_contents : dict of DeploymentKey to int
        Hashes of the messages of the known paths; 0 without a message.
    contradicted : dict of DeploymentKey to str
        Deployments with contradicting returns, each with a sentence that explains it.
    held : dict of DeploymentKey to str
        Deployments without an outcome whose robots were not lost in this field, although their
        reports are refused, each with the reason.
    duplicates : int
        Number of duplicate paths and reports.
    lost : int
        Number of robots known to be lost.
    pending : int
        Number of reports whose path is not known yet.

    """

    @typed
    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    ) -> None:
        self.grid = grid
        self.max_steps = whole_number('max_steps', max_steps, 1)
        if not isinstance(robot_types, Mapping):
            words = f'robot_types is {in_short(robot_types)}: it must be a mapping of names'
            raise TypeError(words)
        of_each(len(robot_types), [*robot_types.values()])
        self.robot_types = dict(robot_types)
        self.paths: dict[DeploymentKey, NDArray[np.intp]] = {}
        self.outcomes: dict[DeploymentKey, Observation] = {}
        self.path_contents: dict[DeploymentKey, int] = {}
        self.contradicted: dict[DeploymentKey, str] = {}
        self.held: dict[DeploymentKey, str] = {}
        self.duplicates = self.lost = self.pending = 0
        self._pending: dict[DeploymentKey, dict[Report, None]] = {}
        self._pending_bytes = 0
        self._newest_path = 0

    def robot_type(self, key: DeploymentKey) -> RobotType:
        """Return the robot type of a deployment."""
        return self.robot_types.get(key.agent, ORDINARY)

    def most_steps(self, key: DeploymentKey) -> int:
        """Return the maximum number of steps of a deployment's path."""
        own = self.robot_type(key).max_steps
        return self.max_steps if own is None else own

    def check_path(self, key: DeploymentKey, path: ArrayLike) -> NDArray[np.intp]:
        """Return a path as cells; raise ValueError if it is invalid for the deployment's robot."""
        grid = self.grid.at(self.robot_type(key).base)
        return grid.check_path(path, self.most_steps(key))

    def copy_pending(self, other: MissionRecord) -> None:
        """Copy the pending reports of another record."""
        self._pending = {key: reports.copy() for key, reports in other._pending.items()}
        self.pending, self._pending_bytes = other.pending, other._pending_bytes

    def copy(self: Self) -> Self:
        """Return an independent copy."""
        other = copy(self)
        other.paths, other.outcomes = self.paths.copy(), self.outcomes.copy()
        other.path_contents = self.path_contents.copy()
        other.contradicted = self.contradicted.copy()
        other.held = self.held.copy()
        other.copy_pending(self)
        return other

    @typed
    def record_path(self, key: DeploymentKey, path: ArrayLike, content: int = 0) -> bool:
        """Record a path; return whether a pending report now gives the deployment an outcome."""
        cells = self.check_path(key, path)
        if key in self.paths:
            if not np.array_equal(cells, self.paths[key]):
                raise ValueError(f'path of deployment {key} differs from its first path')
            self.duplicates += 1
            return False
        self.paths[key] = cells
        self.path_contents[key] = content
        refusals = []
        self._newest_path = max(self._newest_path, key.stamp)
        for report in self._take_pending(key):
            try:
                self.record_report(key, report)
            except ValueError as error:
                refusals.append(error)
        if refusals and key not in self.outcomes:
            raise refusals[0]
        return key in self.outcomes

    @typed
    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """Record a report; return whether the outcome changes. Refused reports change nothing."""
        if key not in self.paths:
            self._keep_pending(key, report)
            return False
        try:
            return self._record(key, report)
        except ValueError as error:
            if key not in self.outcomes and is_back(report, self.grid):
                self.held[key] = str(error)
            raise

    def _record(self, key: DeploymentKey, report: Report) -> bool:
        """Record the report of a known path; return whether the outcome changes."""
        outcome = self._outcome(key, report)
        known = self.outcomes.get(key)
        differs = (
            known is not None
            and ending_key(known) == ending_key(outcome)
            and not is_same_outcome(known, outcome)
        )
        if differs:
            self.contradicted[key] = (
                f'reports of deployment {key} differ: the one with more readings counts '
                f'(do two robots have the name {key.agent}?)'
            )
        if known is not None and outcome_rank(outcome) <= outcome_rank(known):
            if differs:
                raise ValueError(self.contradicted[key])
            self.duplicates += 1
            if known == outcome:
                self._hear_again(key, report)
            return False
        self._assimilate(key, outcome, report)
        self.outcomes[key] = outcome
        self.held.pop(key, None)
        self.lost += (not outcome.survived) - (known is not None and not known.survived)
        return True

    def forget(self, key: DeploymentKey) -> None:
        """Forget the outcome of a deployment, so that its next report counts."""
        if outcome := self.outcomes.pop(key, None):
            self.lost -= not outcome.survived
        self.contradicted.pop(key, None)

    def _keep_pending(self, key: DeploymentKey, report: Report) -> None:
        """Keep a report until its path is known."""
        pending = self._pending.setdefault(key, {})
        if report in pending:
            self.duplicates += 1
            return
        pending[report] = None
        self.pending += 1
        self._pending_bytes += report_size(report)
        if self._pending_bytes <= MAX_PENDING:
            return
        before = self.pending
        # The sort is stable: earlier reports stay first.
        by_distance = sorted(self._pending, key=lambda each: -abs(each.stamp - self._newest_path))
        for dropped in by_distance:
            self._take_pending(dropped)
            if self._pending_bytes <= LEFT_PENDING:
                break
        raise ValueError(
            f'{before - self.pending} reports of deployments with unknown paths are '
            f'dropped, such as {by_distance[0]}: at most {MAX_PENDING // 10**6} MB are kept'
        )

    def _take_pending(self, key: DeploymentKey) -> list[Report]:
        """Return and remove the pending reports of a deployment."""
        reports = list(self._pending.pop(key, ()))
        self.pending -= len(reports)
        self._pending_bytes -= sum(map(report_size, reports))
        return reports

    def _assimilate(self, key: DeploymentKey, outcome: Observation, report: Report) -> None:
        """Assimilate a new outcome before it is recorded; may raise ValueError."""

    def _hear_again(self, key: DeploymentKey, report: Report) -> None:
        """Handle a duplicate report."""

    def _outcome(self, key: DeploymentKey, report: Report) -> Observation:
        """Return the outcome of a report; raise ValueError if the report is impossible."""
        return make_observation(report, key, self.paths[key], self.grid, self.most_steps(key))


def ending_key(outcome: Observation) -> tuple[bool, int, float, list[float]]:
    """Return a sort key of outcomes: the more is known of how a deployment ended, the greater."""
    lost_at = [] if outcome.lost_at is None else outcome.lost_at.tolist()
    # The largest value is 1, so a smaller sum locates the loss more closely; without `lost_at` the
    # loss is not located at all.
    located = -sum(lost_at) if lost_at else -np.inf
    return outcome.survived, outcome.steps_survived, located, lost_at


def is_same_outcome(one: Observation, other: Observation) -> bool:
    """Return whether two outcomes are equal, apart from steps that only one of them counts."""
    # An agent of an earlier version vouches for all its steps.
    if one == other or one.readings is None or other.readings is None:
        return one == other
    if one.entered is None is other.entered or not np.array_equal(one.path, other.path):
        return False
    both = one.is_entered & other.is_entered
    return np.array_equal(one.readings[both], other.readings[both])


def outcome_rank(outcome: Observation) -> tuple[Any, ...]:
    """Return a sort key of a deployment's reported outcomes; the greatest counts."""
    readings = [] if outcome.readings is None else outcome.readings.tolist()
    read, entered = sum(each >= 0 for each in readings), int(outcome.is_entered.sum())
    return ending_key(outcome), read, entered, readings, outcome.path.tolist()


def is_back(report: Report, grid: Grid) -> bool:
    """Return whether a report, even if it is refused, shows that no robot was lost in a field."""
    return report.survived or report.field_id not in ('', grid.id)


def report_size(report: Report) -> int:
    """Return the approximate bytes of a report in memory."""
    return REPORT + READING * (len(report.readings) + len(report.lost_at) + len(report.entered))


def make_observation(
    report: Report, key: DeploymentKey, path: NDArray[np.intp], grid: Grid, max_steps: int
) -> Observation:
    """Return the observation from a report and a path; ValueError if the report is impossible."""
    if report.field_id not in ('', grid.id):
        raise ValueError(
            f'deployment {key} was made in another field: field_id is {report.field_id!r}, and '
            f'here it is {grid.id!r}; give the robot the field of the base, and report again'
        )
    read = [reading for _, reading in report.readings]
    walk = path
    if report.survived:
        if len(read) > MAX_WALK * max_steps:
            raise ValueError(
                f'readings of deployment {key} has {len(read)} values: at most '
                f'{MAX_WALK} * max_steps = {MAX_WALK * max_steps} are allowed'
            )
        try:
            base = int(path[0])
            walk = grid.at(base).check_path([base, *(cell for cell, _ in report.readings)])
        except ValueError as error:
            raise ValueError(
                f'readings of deployment {key} has {len(read)} values: there must be one for each '
                f'step of a closed walk from the base, with the cell entered; {error}'
            ) from error
    try:
        readings = np.array(read) if read else None
        lost_at = np.array(report.lost_at) if report.lost_at else None
        entered = np.array(report.entered) if report.entered else None
        return Observation(
            walk, report.survived, readings, report.steps_survived, lost_at, entered
        )
    except ValueError as error:
        raise ValueError(f'report of deployment {key}: {error}') from error
