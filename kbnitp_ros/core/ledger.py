# SPDX-License-Identifier: Apache-2.0
"""The fold of paths and reports, as they come, into a belief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from kbnitp_ros.core.belief import Belief
from kbnitp_ros.core.estimator import Estimator
from kbnitp_ros.core.grid import Grid
from kbnitp_ros.core.observation import Observation
import numpy as np
from numpy.typing import ArrayLike, NDArray


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

    """

    survived: bool
    readings: tuple[tuple[int, bool], ...] = ()


class Ledger:
    """
    The deployments of a mission, each taken into the belief exactly once.

    Paths and reports come in any order between the two and may come again. A refusal leaves
    everything as it was.

    Parameters
    ----------
    grid : Grid
        What the paths are checked against.
    max_steps : int
        The most steps a path may have.
    estimator : Estimator
        Takes in each deployment whose path and report are both known.

    Attributes
    ----------
    held : list of DeploymentKey
        The deployments in the belief, in the order they were taken in.
    duplicates : int
        Paths and reports that said again what was known.

    """

    def __init__(self, grid: Grid, max_steps: int, estimator: Estimator) -> None:
        self.grid = grid
        self.max_steps = max_steps
        self.estimator = estimator
        self.held: list[DeploymentKey] = []
        self.duplicates = 0
        self._paths: dict[DeploymentKey, NDArray[np.intp]] = {}
        self._reports: dict[DeploymentKey, Report] = {}
        self._waiting: dict[DeploymentKey, Report] = {}

    @property
    def belief(self) -> Belief:
        """Given the deployments held."""
        return self.estimator.belief

    @property
    def waiting(self) -> int:
        """How many reports wait for their path."""
        return len(self._waiting)

    @property
    def out(self) -> int:
        """How many paths wait for their report."""
        return len(self._paths) - len(self._reports)

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
            Whether the belief changed, because the report was waiting for this.

        Raises
        ------
        ValueError
            If no robot could take the path, the deployment is known with another one, or the
            report that was waiting does not fit; that report is then dropped.

        """
        cells = self.grid.check_path(path, self.max_steps)
        known = self._paths.get(key)
        if known is not None:
            if not np.array_equal(known, cells):
                raise ValueError(f'path of deployment {key} is known and differs: the first holds')
            self.duplicates += 1
            return False
        self._paths[key] = cells
        if key not in self._waiting:
            return False
        return self._take_in(key, self._waiting.pop(key))

    def record_report(self, key: DeploymentKey, report: Report) -> bool:
        """
        Take note of a deployment's report.

        Returns
        -------
        bool
            Whether the belief changed; not if the report is a duplicate or its path is unknown.

        Raises
        ------
        ValueError
            If the report does not fit its path, is impossible under the belief, or contradicts
            the one known.

        """
        known = self._reports.get(key) or self._waiting.get(key)
        if known is not None:
            if known != report:
                raise ValueError(
                    f'report of deployment {key} is known and differs: the first holds'
                )
            self.duplicates += 1
            return False
        if key not in self._paths:
            self._waiting[key] = report
            return False
        return self._take_in(key, report)

    def _take_in(self, key: DeploymentKey, report: Report) -> bool:
        path = self._paths[key]
        read = [cell for cell, _ in report.readings]
        if report.survived and read != path[1:].tolist():
            raise ValueError(
                f'readings of deployment {key} are of the {len(read)} cells {read}: there must be '
                f'one for each of the {len(path) - 1} steps of its path, to {path[1:].tolist()}'
            )
        if read and not report.survived:
            raise ValueError(
                f'readings of deployment {key} has {len(read)} values: '
                'a robot that was lost brings none'
            )
        detected = np.array([detected for _, detected in report.readings], dtype=bool)
        readings = detected if report.survived else None
        self.estimator.assimilate(Observation(path, report.survived, readings))
        self._reports[key] = report
        self.held.append(key)
        return True
