# SPDX-License-Identifier: Apache-2.0
"""What is known of deployments: which path each was sent on and how it ended."""

from __future__ import annotations

from collections.abc import KeysView, Mapping
from copy import copy
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from kbnitp_ros.core.field import Grid, Observation, ORDINARY, RobotType
import numpy as np
from numpy.typing import ArrayLike, NDArray

Self = TypeVar('Self', bound='Deployments')

# The most bytes of reports that are pending, since their paths may never come; how many of these
# stay when it is reached; and what a report and a reading take.
MOST_PENDING = 50_000_000
LEFT_PENDING = 45_000_000
REPORT, READING = 1000, 100

# How many times as many steps as its orders may have a robot can have made.
LONGEST_WALK = 10


class DeploymentKey(NamedTuple):
    """
    What tells a deployment from all others.

    Attributes
    ----------
    agent : str
        Name of the robot.
    stamp : int
        When its path was published, nanoseconds of ROS time.

    """

    agent: str
    stamp: int

    def __str__(self) -> str:
        return f'{self.agent} at {self.stamp // 10**9}.{self.stamp % 10**9:09d}'


def deployment_order(key: DeploymentKey) -> tuple[int, str]:
    """Return what deployments are sorted by: their stamps, then their agents."""
    return key.stamp, key.agent


class Ending(NamedTuple):
    """
    How a deployment ended; of two endings of one deployment the greater one says more.

    Attributes
    ----------
    survived : bool
        Whether the robot returned: one that was given up may only be late.
    steps_survived : int
        Of a lost robot, how many steps of its path it is known to have survived.
    located : float
        How closely it is known where: minus the sum of `lost_at`, of which the largest is 1;
        -inf where all steps are alike.
    lost_at : tuple of float
        These, so that of two that say as much the same one counts whatever comes first.

    """

    survived: bool
    steps_survived: int = 0
    located: float = -np.inf
    lost_at: tuple[float, ...] = ()


@dataclass(frozen=True)
class Report:
    """
    What the base learnt of a deployment.

    Attributes
    ----------
    survived : bool
        Whether the robot returned.
    readings : tuple of (int, int)
        The cell and the target sensor's reading of each step that the robot made, -1 where it did
        not look; empty when lost.
    stamp : int
        When the base learnt it, nanoseconds of ROS time. What is learnt again later is the same.
    steps_survived : int
        Of a lost robot, how many steps of its path it is known to have survived.
    content : int
        Hash of the message that said so, by which a log names it; 0 if there is none.
    lost_at : tuple of float
        Of a lost robot, how well what was observed fits a loss in each step of its path; empty if
        all are alike.

    """

    survived: bool
    readings: tuple[tuple[int, int], ...] = ()
    stamp: int = field(default=0, compare=False)
    steps_survived: int = 0
    content: int = field(default=0, compare=False)
    lost_at: tuple[float, ...] = ()


def ending_of(outcome: Observation) -> Ending:
    """Return how a deployment ended."""
    lost_at = () if outcome.lost_at is None else tuple(outcome.lost_at.tolist())
    located = -sum(lost_at) if lost_at else -np.inf
    return Ending(outcome.survived, outcome.steps_survived, located, lost_at)


class Deployments:
    """
    The paths and outcomes of deployments, of each the one that counts.

    Paths and reports come in any order and may come again. The first path that a robot could take
    holds. Which of several reports that fit it counts does not depend on their order: a return
    outdoes a loss, since the robot was only late, and of two losses that with the later contact
    counts, or if that is the same the one that tells more closely where. Two returns can only
    differ if two robots have one name: then that with more readings counts. All who judge evidence
    judge it here: a refused report changes nothing for any of them.

    Parameters
    ----------
    grid : Grid
        What the paths are checked against.
    max_steps : int
        The most steps a path may have.
    robot_types : mapping of str to RobotType
        Of the robots of each agent whose robots are not like all others, with their bases.

    Attributes
    ----------
    duplicates : int
        Paths and reports that said nothing new.
    lost : int
        How many deployments are known to have ended with a lost robot.
    contradicted : dict of DeploymentKey to str
        Deployments of which several returns differ, and what to say of that.
    path_contents : dict of DeploymentKey to int
        Hashes of the messages that the known paths came with, 0 where there was none.

    """

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    ) -> None:
        self.grid = grid
        self.max_steps = max_steps
        self.robot_types = dict(robot_types)
        self.duplicates = 0
        self.lost = 0
        self.contradicted: dict[DeploymentKey, str] = {}
        self.path_contents: dict[DeploymentKey, int] = {}
        self._paths: dict[DeploymentKey, NDArray[np.intp]] = {}
        self._outcomes: dict[DeploymentKey, Observation] = {}
        self._pending: dict[DeploymentKey, dict[Report, None]] = {}
        self._pending_count = self._pending_bytes = 0
        self._newest_path = 0

    @property
    def paths(self) -> KeysView[DeploymentKey]:
        """Deployments whose path is known, in the order in which it became so."""
        return self._paths.keys()

    @property
    def pending(self) -> int:
        """How many reports are pending, since their path is not known."""
        return self._pending_count

    @property
    def in_flight(self) -> int:
        """How many robots are in flight: their path is known and their report is not."""
        return len(self._paths) - len(self._outcomes)

    def robot_type(self, key: DeploymentKey) -> RobotType:
        """Return the type of the robot that makes a deployment."""
        return self.robot_types.get(key.agent, ORDINARY)

    def most_steps(self, key: DeploymentKey) -> int:
        """Return the most steps that the path of a deployment may have."""
        own = self.robot_type(key).max_steps
        return self.max_steps if own is None else own

    def check_path(self, key: DeploymentKey, path: ArrayLike) -> NDArray[np.intp]:
        """
        Return the path of a deployment as an array of cells, shape (steps + 1,).

        Raises
        ------
        ValueError
            If none of its agent's robots could take it, from their base and back.

        """
        grid = self.grid.at(self.robot_type(key).base)
        return grid.check_path(path, self.most_steps(key))

    def ending(self, key: DeploymentKey) -> Ending:
        """Return how a deployment ended that was reported."""
        return ending_of(self._outcomes[key])

    def path(self, key: DeploymentKey) -> NDArray[np.intp]:
        """Return the cells of a known path, shape (steps + 1,)."""
        return self._paths[key]

    def observation(self, key: DeploymentKey) -> Observation:
        """Return what came of a deployment that was reported."""
        return self._outcomes[key]

    def copy_pending_of(self, other: Deployments) -> None:
        """Copy the pending reports of another."""
        self._pending = {key: reports.copy() for key, reports in other._pending.items()}
        self._pending_count, self._pending_bytes = other._pending_count, other._pending_bytes

    def copy(self: Self) -> Self:
        """Return a copy that goes on by itself from here."""
        other = copy(self)
        other._paths, other._outcomes = self._paths.copy(), self._outcomes.copy()
        other._pending = {key: reports.copy() for key, reports in self._pending.items()}
        other.contradicted = self.contradicted.copy()
        other.path_contents = self.path_contents.copy()
        return other

    def record_path(self, key: DeploymentKey, path: ArrayLike, content: int = 0) -> bool:
        """
        Take note of a deployment's path.

        Parameters
        ----------
        key : DeploymentKey
            The deployment.
        path : array_like of int, shape (steps + 1,)
            Cells, the base first and last.
        content : int
            Hash of the message that it came with, by which a log names it.

        Returns
        -------
        bool
            Whether the deployment's outcome is known now, because a report was pending.

        Raises
        ------
        ValueError
            If no robot could take the path, the deployment is known with another one, or none of
            the pending reports can be assimilated; those are then dropped.

        """
        cells = self.check_path(key, path)
        if key in self._paths:
            if not np.array_equal(cells, self._paths[key]):
                raise ValueError(f'path of deployment {key} is known and differs: the first holds')
            self.duplicates += 1
            return False
        self._paths[key] = cells
        self.path_contents[key] = content
        refusals = []
        self._newest_path = max(self._newest_path, key.stamp)
        for report in self._take_pending(key):
            try:
                self.record_report(key, report)
            except ValueError as error:
                refusals.append(error)
        if refusals and key not in self._outcomes:
            raise refusals[0]
        return key in self._outcomes

    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """
        Take note of a deployment's report; a refusal leaves everything as it was.

        Returns
        -------
        bool
            Whether the outcome is another one now; not if the report says nothing new or its path
            is unknown.

        Raises
        ------
        ValueError
            If the report does not fit its path, tells of another return than the one known, which
            counts, or is refused by `_assimilate`; or if more than `MOST_PENDING` bytes are
            pending: then those are dropped that no planner's stamp fits, furthest from the newest
            path.

        """
        if key not in self._paths:
            self._keep_pending(key, report)
            return False
        outcome = self._outcome(key, report)
        known = self._outcomes.get(key)
        differs = known is not None and known != outcome and self.ending(key) == ending_of(outcome)
        if differs:
            self.contradicted[key] = (
                f'reports of deployment {key} differ: that with more readings counts '
                f'(do two robots have the name {key.agent}?)'
            )
        if known is not None and not outdoes(outcome, known):
            if differs:
                raise ValueError(self.contradicted[key])
            self.duplicates += 1
            if known == outcome:
                self._hear_again(key, report)
            return False
        self._assimilate(key, outcome, report)
        self._outcomes[key] = outcome
        self.lost += (not outcome.survived) - (known is not None and not known.survived)
        return True

    def _keep_pending(self, key: DeploymentKey, report: Report) -> None:
        """Keep a report until its path is known."""
        pending = self._pending.setdefault(key, {})
        if report in pending:
            self.duplicates += 1
            return
        pending[report] = None
        self._pending_count += 1
        self._pending_bytes += size_of(report)
        if self._pending_bytes <= MOST_PENDING:
            return
        before = self._pending_count
        # Sorting keeps the order of what came first.
        by_distance = sorted(self._pending, key=lambda each: -abs(each.stamp - self._newest_path))
        for dropped in by_distance:
            self._take_pending(dropped)
            if self._pending_bytes <= LEFT_PENDING:
                break
        raise ValueError(
            f'{before - self._pending_count} reports of deployments whose paths are not known, '
            f'such as {by_distance[0]}: at most {MOST_PENDING // 10**6} MB of them are kept'
        )

    def _take_pending(self, key: DeploymentKey) -> list[Report]:
        """Return the reports of a deployment that were pending, and keep them no longer."""
        reports = list(self._pending.pop(key, ()))
        self._pending_count -= len(reports)
        self._pending_bytes -= sum(map(size_of, reports))
        return reports

    def _assimilate(self, key: DeploymentKey, outcome: Observation, report: Report) -> None:
        """Do what a new outcome entails, before it is known; may raise ValueError."""

    def _hear_again(self, key: DeploymentKey, report: Report) -> None:
        """Do what a report entails that says the same as the one that counts."""

    def _outcome(self, key: DeploymentKey, report: Report) -> Observation:
        """Return what a report tells; raises ValueError if no robot can have made it."""
        return observation_of(report, key, self.path(key), self.grid, self.most_steps(key))


def outdoes(outcome: Observation, known: Observation) -> bool:
    """Return whether an outcome counts instead of the one known."""
    ending, before = ending_of(outcome), ending_of(known)
    return ending > before if ending != before else told(outcome) > told(known)


def told(outcome: Observation) -> tuple[int, list[int], list[int]]:
    """Return how many readings a return has, and what tells it from others with as many."""
    readings = [] if outcome.readings is None else outcome.readings.tolist()
    return sum(each >= 0 for each in readings), readings, outcome.path.tolist()


def size_of(report: Report) -> int:
    """Return how many bytes a report takes in memory, about."""
    return REPORT + READING * (len(report.readings) + len(report.lost_at))


def observation_of(
    report: Report, key: DeploymentKey, path: NDArray[np.intp], grid: Grid, max_steps: int
) -> Observation:
    """
    Return what a report tells of a deployment.

    Parameters
    ----------
    report : Report
        The way that a robot really went is that of its readings.
    key : DeploymentKey
        The deployment, to be named in errors.
    path : ndarray of int, shape (steps + 1,)
        Its orders.
    grid : Grid
        Where it went.
    max_steps : int
        The most steps of a path.

    Raises
    ------
    ValueError
        If a robot that returned has not one reading for each step of a walk from the base back to
        it, or if one that was lost brings any; if the walk is longer than `LONGEST_WALK` times
        `max_steps`, or if more steps are said to be survived than a lost robot can have, or
        `lost_at` is not that of a loss on its path.

    """
    read = [reading for _, reading in report.readings]
    walk = path
    if report.survived:
        if len(read) > LONGEST_WALK * max_steps:
            raise ValueError(
                f'readings of deployment {key} has {len(read)} values: at most '
                f'{LONGEST_WALK} * max_steps = {LONGEST_WALK * max_steps} may be'
            )
        try:
            base = int(path[0])
            walk = grid.at(base).check_path([base, *(cell for cell, _ in report.readings)])
        except ValueError as error:
            raise ValueError(
                f'readings of deployment {key} has {len(read)} values: there must be one for each '
                f'step of a walk from the base back to it, of the cell it led to; {error}'
            ) from error
    try:
        readings = np.array(read) if read else None
        lost_at = np.array(report.lost_at) if report.lost_at else None
        return Observation(walk, report.survived, readings, report.steps_survived, lost_at)
    except ValueError as error:
        raise ValueError(f'report of deployment {key}: {error}') from error
