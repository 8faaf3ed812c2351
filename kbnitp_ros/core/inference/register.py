# SPDX-License-Identifier: Apache-2.0
"""What is known of deployments: which path each was sent on and how it ended."""

from __future__ import annotations

from collections.abc import KeysView
from copy import copy
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from kbnitp_ros.core.field import Grid, Observation
import numpy as np
from numpy.typing import ArrayLike, NDArray

R = TypeVar('R', bound='Register')

# How many reports may wait for their paths, which may never come.
MOST_WAITING = 20_000


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


class Register:
    """
    The paths and outcomes of deployments, of each the one that counts.

    Paths and reports come in any order and may come again. The first path that a robot could take
    holds. So does the first report that fits it, but a return outdoes a loss: the robot was only
    late. All who judge evidence judge it here: a refused report changes nothing for any of them.

    Parameters
    ----------
    grid : Grid
        What the paths are checked against.
    max_steps : int
        The most steps a path may have.

    Attributes
    ----------
    duplicates : int
        Paths and reports that said nothing new.

    """

    def __init__(self, grid: Grid, max_steps: int) -> None:
        self.grid = grid
        self.max_steps = max_steps
        self.duplicates = 0
        # Thousands of deployments are kept, so each in few bytes: the cells of its path, and its
        # readings as bits, None when the robot was lost.
        self._cell_type = np.min_scalar_type(grid.cells - 1)
        self._paths: dict[DeploymentKey, bytes] = {}
        self._outcomes: dict[DeploymentKey, bytes | None] = {}
        self._waiting: dict[DeploymentKey, dict[Report, None]] = {}

    @property
    def paths(self) -> KeysView[DeploymentKey]:
        """Deployments whose path is known, in the order in which it became so."""
        return self._paths.keys()

    @property
    def waiting(self) -> int:
        """How many reports wait for their path."""
        return sum(map(len, self._waiting.values()))

    @property
    def out(self) -> int:
        """How many paths wait for their report."""
        return len(self._paths) - len(self._outcomes)

    def returned(self, key: DeploymentKey) -> bool:
        """Return whether the robot of a deployment that was reported came back."""
        return self._outcomes[key] is not None

    def path(self, key: DeploymentKey) -> NDArray[np.intp]:
        """Return the cells of a known path, shape (steps + 1,)."""
        return np.frombuffer(self._paths[key], self._cell_type).astype(np.intp)

    def observation(self, key: DeploymentKey) -> Observation:
        """Return what came of a deployment that was reported."""
        return self._observation(key, self._outcomes[key])

    def await_paths_of(self, other: Register) -> None:
        """Have the reports wait that wait for their paths in another register."""
        self._waiting = {key: reports.copy() for key, reports in other._waiting.items()}

    def copy(self: R) -> R:
        """Return a register that goes on by itself from here."""
        other = copy(self)
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
            Whether the deployment's outcome is known now, because a report was waiting for this.

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
            Whether the outcome is another one now; not if the report says nothing new or its path
            is unknown.

        Raises
        ------
        ValueError
            If the report does not fit its path, tells of another return than the one known, or is
            refused by `_take_in`; or if too many wait for their paths: then those of the oldest
            deployment are dropped.

        """
        if key not in self._paths:
            waiting = self._waiting.setdefault(key, {})
            if report in waiting:
                self.duplicates += 1
            waiting.setdefault(report)
            if self.waiting > MOST_WAITING:
                oldest = next(iter(self._waiting))
                del self._waiting[oldest]
                raise ValueError(
                    f'report of deployment {oldest} has waited for its path in vain: '
                    f'at most {MOST_WAITING} reports may wait'
                )
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
        self._take_in(key, outcome, report)
        self._outcomes[key] = outcome
        return True

    def _take_in(self, key: DeploymentKey, outcome: bytes | None, report: Report) -> None:
        """Do what a new outcome entails, before it is known; may raise ValueError."""

    def _outcome(self, key: DeploymentKey, report: Report) -> bytes | None:
        """Return the readings of a report that fits its path as bits; None if it is of a loss."""
        check_report(key, np.frombuffer(self._paths[key], self._cell_type), report)
        if not report.survived:
            return None
        return np.packbits([detected for _, detected in report.readings]).tobytes()

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
