# SPDX-License-Identifier: Apache-2.0
"""The fold of paths and reports, as they come, into a belief."""

from __future__ import annotations

from bisect import bisect_left
from copy import copy
from dataclasses import dataclass, field
from typing import NamedTuple

from kbnitp_ros.core.field import Belief, Grid, Observation
from kbnitp_ros.core.inference.estimator import Estimator
import numpy as np
from numpy.typing import ArrayLike

# How far back, as a power of two, an estimator is kept after each deployment. Twice as far back
# it is after every second one, and so on: few are kept, and going back any way to take in a late
# deployment costs little more than the deployments that follow it.
DENSE = 2


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


@dataclass(frozen=True)
class Report:
    """
    What the base learnt of a deployment.

    Attributes
    ----------
    survived : bool
        Whether the robot returned.
    readings : tuple of (int, bool)
        The cell and the target sensor's reading of each step; empty when lost.
    stamp : int
        When the base learnt it, nanoseconds of ROS time. What is learnt again later is the same.

    """

    survived: bool
    readings: tuple[tuple[int, bool], ...] = ()
    stamp: int = field(default=0, compare=False)


class Ledger:
    """
    The deployments of a mission and the belief that they give, each counted exactly once.

    Paths and reports come in any order and may come again. The belief is always, bit for bit,
    that of an estimator that takes in the deployments whose path and report are both known one
    after another in deployment order, so the order of arrival does not matter. A return outdoes
    a loss of the same deployment: the robot was only late.

    Parameters
    ----------
    grid : Grid
        What the paths are checked against.
    max_steps : int
        The most steps a path may have.
    estimator : Estimator
        Before the first deployment.

    Attributes
    ----------
    deployments : list of DeploymentKey
        Those in the belief, in deployment order.
    newest : DeploymentKey or None
        Whose evidence was taken in last; None before the first.
    newest_stamp : int
        Of the report that told of it, nanoseconds of ROS time.
    duplicates : int
        Paths and reports that said nothing new.

    """

    def __init__(self, grid: Grid, max_steps: int, estimator: Estimator) -> None:
        self.grid = grid
        self.max_steps = max_steps
        self.deployments: list[DeploymentKey] = []
        self.newest: DeploymentKey | None = None
        self.newest_stamp = 0
        self.duplicates = 0
        # Thousands of deployments are kept, so each in few bytes: the cells of its path, and its
        # readings as bits, None when the robot was lost.
        self._cell_type = np.min_scalar_type(grid.cells - 1)
        self._paths: dict[DeploymentKey, bytes] = {}
        self._outcomes: dict[DeploymentKey, bytes | None] = {}
        self._waiting: dict[DeploymentKey, list[Report]] = {}
        # Some of those on the way to the belief, by how many deployments they have taken in.
        self._estimators = {0: estimator}

    @property
    def estimator(self) -> Estimator:
        """As it is after the deployments held."""
        return self._estimators[len(self.deployments)]

    @property
    def belief(self) -> Belief:
        """Given the deployments held."""
        return self.estimator.belief

    @property
    def waiting(self) -> int:
        """How many reports wait for their path."""
        return sum(map(len, self._waiting.values()))

    @property
    def out(self) -> int:
        """How many paths wait for their report."""
        return len(self._paths) - len(self._outcomes)

    def returned(self, key: DeploymentKey) -> bool:
        """Return whether the robot of a deployment held came back."""
        return self._outcomes[key] is not None

    def copy(self) -> Ledger:
        """Return a ledger that goes on by itself from here."""
        other = copy(self)
        other.deployments = self.deployments.copy()
        other._paths, other._outcomes = self._paths.copy(), self._outcomes.copy()
        other._waiting = {key: reports.copy() for key, reports in self._waiting.items()}
        return other

    def record_path(self, key: DeploymentKey, path: ArrayLike) -> bool:
        """
        Take note of a deployment's path.

        Parameters
        ----------
        key : DeploymentKey
            The deployment.
        path : array_like of int, shape (steps + 1,)
            Cells, the base first and last.

        Returns
        -------
        bool
            Whether the belief changed, because a report was waiting for this.

        Raises
        ------
        ValueError
            If no robot could take the path, the deployment is known with another one, or none of
            the reports that were waiting can be taken in; those are then dropped.

        """
        cells = self.grid.check_path(path, self.max_steps).astype(self._cell_type).tobytes()
        if key in self._paths:
            if cells != self._paths[key]:
                raise ValueError(f'path of deployment {key} is known and differs: the first holds')
            self.duplicates += 1
            return False
        self._paths[key] = cells
        refusals = []
        for report in self._waiting.pop(key, ()):
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
            Whether the belief changed; not if the report says nothing new or its path is unknown.

        Raises
        ------
        ValueError
            If the report does not fit its path, is impossible together with the deployments
            held, or tells of another return than the one known.

        """
        if key not in self._paths:
            waiting = self._waiting.setdefault(key, [])
            if report in waiting:
                self.duplicates += 1
            else:
                waiting.append(report)
            return False
        outcome = self._outcome(key, report)
        if key in self._outcomes:
            known = self._outcomes[key]
            if outcome is None or outcome == known:
                self.duplicates += 1
                return False
            if known is not None:
                raise ValueError(
                    f'report of deployment {key} is known and differs: the first return holds'
                )
        self._take_in(key, outcome)
        self.newest, self.newest_stamp = key, report.stamp
        return True

    def _outcome(self, key: DeploymentKey, report: Report) -> bytes | None:
        """Return the readings of a report that fits its path as bits; None if it is of a loss."""
        check_report(key, np.frombuffer(self._paths[key], self._cell_type), report)
        if not report.survived:
            return None
        return np.packbits([detected for _, detected in report.readings]).tobytes()

    def _take_in(self, key: DeploymentKey, outcome: bytes | None) -> None:
        """Go back to before a deployment, and from there on with this outcome of it."""
        place = bisect_left(self.deployments, deployment_order(key), key=deployment_order)
        start = max(count for count in self._estimators if count <= place)
        estimators = {count: each for count, each in self._estimators.items() if count <= start}
        first_later = place + (key in self._outcomes)
        later = self.deployments[first_later:]
        deployments = [*self.deployments[start:place], key, *later]
        for count, each in enumerate(deployments, start + 1):
            estimator = estimators[count - 1].copy()
            try:
                estimator.assimilate(
                    self._observation(each, outcome if each == key else self._outcomes[each])
                )
            except ValueError as error:
                if each == key:
                    raise
                raise ValueError(
                    f'report of deployment {key} does not go with that of {each}, which is held: '
                    f'{error}'
                ) from error
            estimators[count] = estimator
            estimators = {kept: estimators[kept] for kept in estimators if is_kept(kept, count)}
        self._estimators = estimators
        self._outcomes[key] = outcome
        self.deployments[start:] = deployments

    def _observation(self, key: DeploymentKey, outcome: bytes | None) -> Observation:
        path = np.frombuffer(self._paths[key], self._cell_type)
        if outcome is None:
            return Observation(path, False)
        bits = np.frombuffer(outcome, np.uint8)
        return Observation(path, True, np.unpackbits(bits, count=path.size - 1).astype(bool))


def check_report(key: DeploymentKey, path: ArrayLike, report: Report) -> None:
    """
    Check that a report can be of a robot which took this path.

    Parameters
    ----------
    key : DeploymentKey
        The deployment, to be named in errors.
    path : array_like of int, shape (steps + 1,)
        Its cells.
    report : Report
        How it is said to have ended.

    Raises
    ------
    ValueError
        If a robot that came back has not one reading for each step, of the cell of that step, or
        one that was lost has any.

    """
    steps = np.asarray(path)[1:].tolist()
    read = [cell for cell, _ in report.readings]
    if report.survived and read != steps:
        raise ValueError(
            f'readings of deployment {key} are of the {len(read)} cells {read}: there must be '
            f'one for each of the {len(steps)} steps of its path, to {steps}'
        )
    if read and not report.survived:
        raise ValueError(
            f'readings of deployment {key} has {len(read)} values: '
            'a robot that was lost brings none'
        )


def is_kept(count: int, deployments: int) -> bool:
    """Return whether to keep the estimator after `count` deployments when there are so many."""
    spacing: int = 2 ** max(0, (deployments - count).bit_length() - DENSE)
    return count % spacing == 0
