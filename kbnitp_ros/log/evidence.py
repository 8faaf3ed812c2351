# SPDX-License-Identifier: Apache-2.0
"""What a log has on record of the deployments: their paths and their reports."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from kbnitp_ros.core import DeploymentKey, Grid, Ledger, Report
from kbnitp_ros.messages.deployments import agent_of, key_of_path, read_path, read_report
import numpy as np
from numpy.typing import NDArray

# A deployment and how it ended, as one message had it.
Reported = tuple[DeploymentKey, Report]


class Evidence:
    """
    Paths and reports by deployment, each once however often it was recorded.

    Attributes
    ----------
    complete : dict
        Its keys are the deployments with both, in the order in which they became so.
    refused : list of str
        What no estimator takes, and why.

    """

    def __init__(self) -> None:
        self.complete: dict[DeploymentKey, None] = {}
        self.refused: list[str] = []
        # Those that differ: what is published again says nothing new.
        self._paths: dict[DeploymentKey, list[Any]] = {}
        self._reports: dict[DeploymentKey, list[Report]] = {}
        self._by_agent: dict[str, list[Reported]] = {}

    def take_path(self, topic: str, message: Any) -> None:
        """Keep a nav_msgs/Path if it came on AGENT/path; it is read when its grid is known."""
        key = key_of_path(topic, message)
        if key is None:
            return
        known = self._paths.setdefault(key, [])
        if message not in known:
            if known:
                self.refused.append(f'a second path of deployment {key}, which differs')
            known.append(message)
            self._complete(key)

    def take_report(self, topic: str, message: Any) -> None:
        """Keep a DeploymentReport."""
        try:
            key, report = read_report(message, agent_of(topic))
        except ValueError as error:
            self.refused.append(f'a report on {topic}: {error}')
            return
        known = self._reports.setdefault(key, [])
        if any(report == each and report.stamp == each.stamp for each in known):
            return
        if report.survived and any(each.survived and each != report for each in known):
            self.refused.append(f'a second return of deployment {key}, which differs')
        known.append(report)
        self._by_agent.setdefault(key.agent, []).append((key, report))
        self._complete(key)

    def _complete(self, key: DeploymentKey) -> None:
        if key in self._paths and key in self._reports:
            self.complete[key] = None

    def has(self, key: DeploymentKey, stamp: int) -> bool:
        """Return whether a deployment's path and its report of this time are on record."""
        return key in self.complete and any(each.stamp == stamp for each in self._reports[key])

    def news(self, ledger: Ledger) -> list[list[Reported]]:
        """Return what would be new to a ledger of what was reported of each agent, in order."""
        returned = {key: ledger.returned(key) for key in ledger.deployments}
        return [
            [
                (key, report)
                for key, report in said
                if key in self.complete and report.survived > returned.get(key, -1)
            ]
            for said in self._by_agent.values()
        ]

    def tell(self, ledger: Ledger, key: DeploymentKey, report: Report) -> bool:
        """
        Tell a ledger of a deployment's paths and of one of its reports.

        Returns
        -------
        bool
            Whether its belief changed.

        Raises
        ------
        ValueError
            If the ledger takes none of the paths, or refuses the report.

        """
        refusals = []
        for message in self._paths[key]:
            try:
                ledger.record_path(key, read_path(ledger.grid, key.agent, message)[1])
                break
            except ValueError as error:
                refusals.append(error)
        else:
            raise refusals[0]
        return ledger.record_report(key, report)

    def path(self, key: DeploymentKey, grid: Grid) -> NDArray[np.intp]:
        """
        Return the cells of a deployment's first path, shape (steps + 1,).

        Raises
        ------
        ValueError
            If it does not lie on the grid.

        """
        return read_path(grid, key.agent, self._paths[key][0])[1]

    def report(self, key: DeploymentKey) -> Report:
        """Return the report of a complete deployment that counts: of a return if there is one."""
        said, steps = self._reports[key], len(self._paths[key][0].poses) - 1
        fitting = (each for each in said if each.survived and len(each.readings) == steps)
        return next(fitting, said[0])

    def report_of(self, key: DeploymentKey, stamp: int) -> Report:
        """
        Return the report of a deployment that the base learnt at this time, or else the last one.

        A report that was not on disk yet when recorder and agent died is on record as it was made
        again, later; the belief knew of the first.

        Raises
        ------
        ValueError
            If none is on record, or not the path.

        """
        for what, known in (('path', self._paths), ('report', self._reports)):
            if key not in known:
                raise ValueError(f'{what} of deployment {key} is not on record')
        said = self._reports[key]
        made_again = replace(said[-1], stamp=stamp)
        return next((report for report in said if report.stamp == stamp), made_again)

    @property
    def survived(self) -> int:
        """How many of the complete deployments came back."""
        return sum(self.report(key).survived for key in self.complete)

    @property
    def without_report(self) -> list[DeploymentKey]:
        """Deployments whose end is not on record: the robot was still out."""
        return [key for key in self._paths if key not in self._reports]

    @property
    def without_path(self) -> list[DeploymentKey]:
        """Deployments whose end is on record but not their path."""
        return [key for key in self._reports if key not in self._paths]
