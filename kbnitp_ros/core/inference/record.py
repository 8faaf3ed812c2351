# SPDX-License-Identifier: Apache-2.0
"""The record of a mission: paths, reports, statuses, and the standing of each deployment."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from kbnitp_ros.core.field.check import in_short, typed, whole_number
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import of_each, ORDINARY, RobotType
from kbnitp_ros.core.inference.annotation import Annotation
import numpy as np
from numpy.typing import ArrayLike, NDArray

Self = TypeVar('Self', bound='MissionRecord')

# Maximum bytes of pending reports, and bytes that are kept if the maximum is exceeded.
MAX_PENDING, LEFT_PENDING = 50_000_000, 45_000_000
# Approximate bytes of a report, and of each of its readings.
REPORT, READING = 1000, 100

# Maximum number of statuses kept until their paths arrive, and of different reports of a
# deployment: of those that are refused, of valid ones and of the operator's each.
MAX_STATUSES = 1000
MAX_REPORTS = 20

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


class OrderState(IntEnum):
    """The state of an order, as in kbnitp_msgs/AgentStatus."""

    ACCEPTED = 1
    DEPARTED = 2
    REFUSED = 3


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
        Hash of the report's message, which identifies it in a log; 0 without a message. Ignored in
        comparisons.
    lost_at : tuple of float
        Likelihood of a loss in each step of a lost robot's path; empty if all are alike.
    entered : tuple of bool
        For each step whether the robot vouches for its cell; empty if it vouches for all.
    field_id : str
        `Grid.id` of the agent's field; '' if it is not stated.
    settled : tuple of int, optional
        Of a robot that the operator gives up: hashes of the refused reports that the operator
        knew of. None for all other reports.
    unreadable : str
        Why the message cannot be read; '' for a message that can. An unreadable report counts for
        nothing, but it may show that its robot is back.

    """

    survived: bool
    readings: tuple[tuple[int, int], ...] = ()
    stamp: int = field(default=0, compare=False)
    steps_survived: int = 0
    content: int = field(default=0, compare=False)
    lost_at: tuple[float, ...] = ()
    entered: tuple[bool, ...] = ()
    field_id: str = ''
    settled: tuple[int, ...] | None = None
    unreadable: str = ''


class Verdict(IntEnum):
    """The evidence of a deployment, as in kbnitp_msgs/Standing."""

    # Nothing yet: a reported loss waits for the departure of its robot.
    OPEN = 0
    # The robot came back, with or without a step into another cell.
    RETURN = 1
    UNMOVED = 2
    # The robot was lost.
    LOSS = 3
    # The robot was given up, and the model rules out a loss: it is lost, and no evidence.
    CLOSED = 4
    # A report is refused, and nothing else counts: the deployment is not over.
    HELD = 5
    # The agent refused the order, so that the robot stayed at the base.
    VOID = 6
    # A person withdrew it: sent, not lost, and no evidence of the field.
    WITHDRAWN = 7

    @property
    def is_over(self) -> bool:
        """Return whether the deployment has ended."""
        return self not in (Verdict.OPEN, Verdict.HELD)

    @property
    def is_evidence(self) -> bool:
        """Return whether the belief holds the deployment."""
        return self in (Verdict.RETURN, Verdict.UNMOVED, Verdict.LOSS, Verdict.WITHDRAWN)

    @property
    def is_loss(self) -> bool:
        """Return whether the robot counts as lost."""
        return self in (Verdict.LOSS, Verdict.CLOSED)


class Cause(IntEnum):
    """Why a report is refused, as in kbnitp_msgs/Standing."""

    NONE = 0
    # The message cannot be read.
    UNREADABLE = 1
    # The robot was in another field.
    FIELD = 2
    # The report does not fit its path.
    PATH = 3
    # The model rules it out, given the evidence of earlier deployments.
    IMPOSSIBLE = 4
    # Another report of the same deployment counts.
    CONTRADICTED = 5
    # The agent refused the order, so that the robot cannot have been lost.
    ORDER_REFUSED = 6
    # The robot is reported lost, and a refused report shows that it is back.
    IS_BACK = 7
    # The robot was lost while the field was changed, before or after.
    CHANGED = 8


class Refusal(NamedTuple):
    """A report that does not count, by the hash of its message, and the reason."""

    content: int
    cause: Cause
    why: str


@dataclass(frozen=True)
class Standing:
    """
    The evidence that counts of a deployment, given all that was heard.

    Attributes
    ----------
    verdict : Verdict
        How the deployment ended, or that it is held.
    report : int
        Hash of the report by which it stands; 0 without a message.
    refusals : tuple of Refusal
        Reports that were refused, the one that decides why a deployment is held first.
    judged : frozenset of int
        Hashes of all reports that were judged.
    order : frozenset of OrderState
        States of the order by then.
    annotation : int
        Hash of the annotation by which it stands; 0 without one.

    """

    verdict: Verdict
    report: int = 0
    refusals: tuple[Refusal, ...] = ()
    judged: frozenset[int] = frozenset()
    order: frozenset[OrderState] = frozenset()
    annotation: int = 0

    @property
    def why(self) -> str:
        """Return the reason of the first refusal; '' without one."""
        return self.refusals[0].why if self.refusals else ''


# The standing of a deployment of which nothing was judged, which no record keeps.
OPEN = Standing(Verdict.OPEN)


class HeardReport(NamedTuple):
    """A report of a deployment with a known path, and the observation that it makes."""

    report: Report
    # None if the report is refused whatever else is known; `refusal` then has the reason.
    outcome: Observation | None
    refusal: Refusal | None

    @property
    def rank(self) -> tuple[Any, ...]:
        """Return a sort key of a deployment's valid reports: the greatest counts."""
        assert self.outcome is not None
        return outcome_rank(self.outcome), self.report.stamp, self.report.content

    @property
    def is_settled(self) -> bool:
        """Return whether the operator gave up the robot."""
        return self.report.settled is not None

    @property
    def kind(self) -> tuple[bool, bool]:
        """Return whether the report is refused, and whether it is the operator's."""
        return self.refusal is not None, self.is_settled


class MissionRecord:
    """
    The paths, reports and statuses of a mission, in any order, and the standings of deployments.

    The first valid path of a deployment counts. `Ledger` judges what counts of each deployment;
    other records follow its standings.

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
    path_contents : dict of DeploymentKey to int
        Hashes of the messages of the known paths; 0 without a message.
    heard : dict of DeploymentKey to dict of Report to HeardReport
        Reports of the deployments with a known path; of equal reports the newest.
    statuses : dict of DeploymentKey to set of OrderState
        States of the orders with a known path.
    standings : dict of DeploymentKey to Standing
        What counts of each deployment that was judged.
    annotations : dict of int to tuple of DeploymentKey and Annotation
        Annotations, by the hash of the message.
    held : dict of DeploymentKey to str
        Held deployments, each with the reason.
    lost : int
        Number of robots that count as lost.
    duplicates : int
        Number of duplicate paths and reports.
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
        self.path_contents: dict[DeploymentKey, int] = {}
        self.heard: dict[DeploymentKey, dict[Report, HeardReport]] = {}
        self.statuses: dict[DeploymentKey, set[OrderState]] = {}
        self.standings: dict[DeploymentKey, Standing] = {}
        self.annotations: dict[int, tuple[DeploymentKey, Annotation]] = {}
        self.held: dict[DeploymentKey, str] = {}
        self.duplicates = self.lost = self.pending = 0
        self._pending: dict[DeploymentKey, dict[Report, Report]] = {}
        self._pending_statuses: OrderedDict[tuple[DeploymentKey, OrderState], int] = OrderedDict()
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
        """Copy the pending reports and statuses of another record."""
        self._pending = {key: reports.copy() for key, reports in other._pending.items()}
        self._pending_statuses = other._pending_statuses.copy()
        self.pending, self._pending_bytes = other.pending, other._pending_bytes

    def copy(self: Self) -> Self:
        """Return an independent copy."""
        other = copy(self)
        other.paths, other.standings = self.paths.copy(), self.standings.copy()
        other.held, other.annotations = self.held.copy(), self.annotations.copy()
        other.path_contents = self.path_contents.copy()
        other.heard = {key: reports.copy() for key, reports in self.heard.items()}
        other.statuses = {key: states.copy() for key, states in self.statuses.items()}
        other.copy_pending(self)
        return other

    def stand(self, key: DeploymentKey, standing: Standing) -> None:
        """Set what counts of a deployment."""
        before = self.standings.pop(key, OPEN)
        if standing.verdict is not Verdict.OPEN:
            self.standings[key] = standing
        self.lost += standing.verdict.is_loss - before.verdict.is_loss
        self.held.pop(key, None)
        if standing.verdict is Verdict.HELD:
            self.held[key] = standing.why

    def is_refused(self, key: DeploymentKey) -> bool:
        """Return whether an agent refused an order, so that its robot is at the base."""
        # A robot that departed after all outranks the refusal.
        states = self.statuses.get(key, set())
        return OrderState.REFUSED in states and OrderState.DEPARTED not in states

    def is_at_base(self, key: DeploymentKey) -> bool:
        """Return whether the statuses of an order say that its robot is at the base."""
        states = self.statuses.get(key, set())
        return bool(states) and OrderState.DEPARTED not in states

    @typed
    def record_path(self, key: DeploymentKey, path: ArrayLike, content: int = 0) -> bool:
        """Record a path; return whether a pending report now counts."""
        cells = self.check_path(key, path)
        if key in self.paths:
            if not np.array_equal(cells, self.paths[key]):
                raise ValueError(f'path of deployment {key} differs from its first path')
            self.duplicates += 1
            return False
        self.paths[key] = cells
        self.path_contents[key] = content
        refusals = []
        changed = False
        self._newest_path = max(self._newest_path, key.stamp)
        for state in OrderState:
            if (stamp := self._pending_statuses.pop((key, state), None)) is not None:
                self.record_status(key, state, stamp)
        for report in self._take_pending(key):
            try:
                changed |= self.record_report(key, report)
            except ValueError as error:
                refusals.append(error)
        if refusals and not changed:
            raise refusals[0]
        return changed

    @typed
    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """
        Record a report; return whether the evidence changes.

        Raises
        ------
        ValueError
            If the report is refused. The deployment is then held unless another report counts.

        """
        if key not in self.paths:
            self._keep_pending(key, report)
            return False
        if (heard := self._hear(key, report)) is None:
            return False
        if heard.refusal:
            raise ValueError(heard.refusal.why)
        return False

    def record_status(self, key: DeploymentKey, state: OrderState, stamp: int = 0) -> bool:
        """Record the state of an order, at a time in ns; return whether the evidence changes."""
        if key in self.paths:
            self.statuses.setdefault(key, set()).add(state)
        else:
            self._pending_statuses[key, state] = stamp
            if len(self._pending_statuses) > MAX_STATUSES:
                self._pending_statuses.popitem(last=False)
        return False

    def _hear(self, key: DeploymentKey, report: Report) -> HeardReport | None:
        """Keep the report of a known path; return None for a duplicate."""
        reports = self.heard.setdefault(key, {})
        known = reports.get(report)
        name = report.stamp, report.content
        if known is not None and name <= (known.report.stamp, known.report.content):
            self.duplicates += 1
            return None
        heard = self._read(key, report)
        # Refused reports leave room for a return and for the operator's decision.
        alike = sum(each.kind == heard.kind for each in reports.values())
        if known is None and alike >= MAX_REPORTS:
            raise ValueError(
                f'report of deployment {key}: {MAX_REPORTS} different reports of its kind were '
                'heard, and no further one is kept'
            )
        # The key has to be the newest of equal reports, too.
        reports.pop(report, None)
        reports[report] = heard
        return heard

    def _read(self, key: DeploymentKey, report: Report) -> HeardReport:
        """Return a report with its observation, or with the reason why it makes none."""
        cause = Cause.PATH
        if report.unreadable:
            cause = Cause.UNREADABLE
        elif report.field_id not in ('', self.grid.id):
            cause = Cause.FIELD
        try:
            outcome = make_observation(
                report, key, self.paths[key], self.grid, self.most_steps(key)
            )
        except ValueError as error:
            return HeardReport(report, None, Refusal(report.content, cause, str(error)))
        return HeardReport(report, outcome, None)

    def _keep_pending(self, key: DeploymentKey, report: Report) -> None:
        """Keep a report until its path is known."""
        pending = self._pending.setdefault(key, {})
        if report in pending:
            self.duplicates += 1
            if (report.stamp, report.content) > (pending[report].stamp, pending[report].content):
                pending[report] = report
            return
        pending[report] = report
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
        reports = [*self._pending.pop(key, {}).values()]
        self.pending -= len(reports)
        self._pending_bytes -= sum(map(report_size, reports))
        return reports


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
    if report.unreadable:
        raise ValueError(report.unreadable)
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
