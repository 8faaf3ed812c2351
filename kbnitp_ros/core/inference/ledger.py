# SPDX-License-Identifier: Apache-2.0
"""The fold of paths and reports, as they come, into a belief."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from types import MappingProxyType

from kbnitp_ros.core.field import Belief, Grid, Observation, RobotType
from kbnitp_ros.core.inference.deployments import (
    deployment_order,
    DeploymentKey,
    Deployments,
    Report,
)
from kbnitp_ros.core.inference.estimator import Estimator

# How far back, as a power of two, an estimator is kept after each deployment. Twice as far back
# it is after every second one, and so on: few are kept, and going back any way to assimilate a
# late deployment costs little more than the deployments that follow it.
DENSE = 2


class Ledger(Deployments):
    """
    The deployments of a mission and the belief that they give, each counted exactly once.

    The belief is always, bit for bit, that of an estimator that assimilates the deployments whose
    path and report are both known one after another in deployment order, so the order of arrival
    does not matter. A report that is impossible together with the deployments held is refused.

    Parameters
    ----------
    grid, max_steps, robot_types
        As of `Deployments`.
    estimator : Estimator
        Before the first deployment.

    Attributes
    ----------
    deployments : list of DeploymentKey
        Those in the belief, in deployment order.
    newest : DeploymentKey or None
        Whose evidence was assimilated last; None before the first.
    newest_stamp : int
        Of the report that told of it, nanoseconds of ROS time.
    report_contents : dict of DeploymentKey to int
        Hashes of the messages that the reports in the belief came with, 0 where there was none.
    assimilations : int
        How many deployments its estimators assimilated, those again that came before a late one.

    """

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        estimator: Estimator,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    ) -> None:
        super().__init__(grid, max_steps, robot_types)
        self.deployments: list[DeploymentKey] = []
        self.newest: DeploymentKey | None = None
        self.newest_stamp = 0
        self.report_contents: dict[DeploymentKey, int] = {}
        self.assimilations = 0
        # Some of those on the way to the belief, by how many deployments they have assimilated.
        self._estimators = {0: estimator}

    @property
    def estimator(self) -> Estimator:
        """As it is after the deployments held."""
        return self._estimators[len(self.deployments)]

    @property
    def belief(self) -> Belief:
        """Given the deployments held."""
        return self.estimator.belief

    def copy(self) -> Ledger:
        """Return a ledger that goes on by itself from here."""
        other = super().copy()
        other.deployments = self.deployments.copy()
        other.report_contents = self.report_contents.copy()
        return other

    def _hear_again(self, key: DeploymentKey, report: Report) -> None:
        # The message heard before may have died with its publisher and a recorder.
        self.report_contents[key] = report.content

    def _assimilate(self, key: DeploymentKey, outcome: Observation, report: Report) -> None:
        """Go back to before a deployment, and from there on with this outcome of it."""
        place = bisect_left(self.deployments, deployment_order(key), key=deployment_order)
        start = max(count for count in self._estimators if count <= place)
        estimators = {count: each for count, each in self._estimators.items() if count <= start}
        first_later = place + (key in self._outcomes)
        later = self.deployments[first_later:]
        deployments = [*self.deployments[start:place], key, *later]
        for count, each in enumerate(deployments, start + 1):
            self.assimilations += 1
            estimator = estimators[count - 1].copy()
            try:
                estimator.assimilate(
                    outcome if each == key else self._outcomes[each], self.robot_type(each)
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
        self.deployments[start:] = deployments
        self.newest, self.newest_stamp = key, report.stamp
        self.report_contents[key] = report.content


def is_kept(count: int, deployments: int) -> bool:
    """Return whether to keep the estimator after `count` deployments when there are so many."""
    spacing: int = 2 ** max(0, (deployments - count).bit_length() - DENSE)
    return count % spacing == 0
