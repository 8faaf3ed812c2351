# SPDX-License-Identifier: Apache-2.0
"""What a log has on record of the deployments: their paths and their reports."""

from __future__ import annotations

from typing import Any

from kbnitp_ros.core import DeploymentKey, Grid, Ledger, Report
from kbnitp_ros.messages.deployments import read_path, read_report
from kbnitp_ros.messages.headers import from_stamp
import numpy as np
from numpy.typing import NDArray


class Evidence:
    """
    Paths and reports by deployment.

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

    def take_path(self, topic: str, message: Any) -> None:
        """Keep a nav_msgs/Path if it came on AGENT/path; it is read when its grid is known."""
        parent, _, name = topic.rpartition('/')
        if name == 'path':
            key = DeploymentKey(parent.rpartition('/')[2], from_stamp(message.header.stamp))
            self._keep('path', self._paths, key, message)

    def take_report(self, topic: str, message: Any) -> None:
        """Keep a DeploymentReport."""
        try:
            key, report = read_report(message)
        except ValueError as error:
            self.refused.append(f'a report on {topic}: {error}')
        else:
            self._keep('report', self._reports, key, report)

    def _keep(
        self, what: str, known: dict[DeploymentKey, list[Any]], key: DeploymentKey, said: Any
    ) -> None:
        if said in known.setdefault(key, []):
            return
        if known[key]:
            self.refused.append(f'a second {what} of deployment {key}, which differs')
        known[key].append(said)
        if key in self._paths and key in self._reports:
            self.complete[key] = None

    def tell(self, ledger: Ledger, key: DeploymentKey) -> str:
        """
        Have a ledger take in a deployment: of its paths and reports the first it does not refuse.

        Returns
        -------
        str
            Why it takes in none; empty if it holds the deployment now.

        """
        for what, known in (('path', self._paths), ('report', self._reports)):
            if key not in known:
                return f'{what} of deployment {key} is not on record'
        said = (*self._paths[key], *self._reports[key])
        refusals = [refusal(ledger, key, each) for each in said]
        return '' if key in ledger.held else next(filter(None, refusals))

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
        """Return the first report of a deployment."""
        return self._reports[key][0]

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


def refusal(ledger: Ledger, key: DeploymentKey, said: Any) -> str:
    """Return why a ledger does not take a path or a report; empty if it does."""
    try:
        if isinstance(said, Report):
            ledger.record_report(key, said)
        else:
            ledger.record_path(key, read_path(ledger.grid, key.agent, said)[1])
    except ValueError as error:
        return str(error)
    return ''
