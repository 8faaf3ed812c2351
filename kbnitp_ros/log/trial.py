# SPDX-License-Identifier: Apache-2.0
"""A ledger that can be told something on trial."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Hashable, Iterable, Mapping
from contextlib import suppress
from types import MappingProxyType

from kbnitp_ros.core import (
    deployment_order,
    DeploymentKey,
    Estimator,
    Grid,
    Kind,
    Ledger,
    Outcome,
    Report,
)
from kbnitp_ros.log.evidence import Evidence, Reported


class TrialLedger(Ledger):
    """
    The ledger of an estimator, as far as it is known what that took in.

    What it is told stays on trial until it is kept or taken back, which costs no more than the
    telling did.

    Parameters
    ----------
    grid, max_steps, estimator, kinds
        As for a `Ledger`.
    evidence : Evidence
        Knows the paths.

    Attributes
    ----------
    known : dict
        By list of reports, how many of it are known to be held, from the first on.

    """

    def __init__(
        self,
        grid: Grid,
        max_steps: int,
        estimator: Estimator,
        evidence: Evidence,
        kinds: Mapping[str, Kind] = MappingProxyType({}),
    ) -> None:
        super().__init__(grid, max_steps, estimator, kinds)
        self.known: dict[Hashable, int] = {}
        self._evidence = evidence
        self._on_trial: list[tuple[DeploymentKey, Outcome | None, dict[int, Estimator]]] = []
        self._before = self.newest, self.newest_stamp

    def tell(self, taken: Iterable[Reported], last: Reported) -> None:
        """
        Take in some reports on trial, and one last, from the one before the last what is possible.

        Raises
        ------
        ValueError
            If the last one is refused.

        """
        for key, report in taken:
            with suppress(ValueError):
                self._tell(key, report)
        key, report = last
        self._tell(key, report)
        # It may have been known to an estimator that was restarted and heard it anew.
        self.newest, self.newest_stamp = key, report.stamp

    def _tell(self, key: DeploymentKey, report: Report) -> None:
        if key not in self.paths:
            self.record_path(key, self._evidence.path(key))
        self.record_report(key, report)

    def _take_in(self, key: DeploymentKey, outcome: Outcome, report: Report) -> None:
        before = key, self._outcomes.get(key), self._estimators
        super()._take_in(key, outcome, report)
        self._on_trial.append(before)

    def holds(self, key: DeploymentKey, report: Report) -> bool:
        """Return whether a report says nothing new."""
        if key not in self._outcomes:
            return False
        if key in self._evidence.contradicted:
            return not self._outdoes(key, self._outcome(key, report), self._outcomes[key])
        return report.ending <= self.ending(key)

    def knows(self, key: DeploymentKey) -> bool:
        """Return whether a deployment is held, however it ended."""
        return key in self._outcomes

    def keep(self) -> list[DeploymentKey]:
        """Keep what was told on trial; return the deployments of which that changed something."""
        changed = [key for key, *_ in self._on_trial]
        self._on_trial.clear()
        self._before = self.newest, self.newest_stamp
        return changed

    def take_back(self) -> None:
        """Be again as before the trial."""
        while self._on_trial:
            key, known, self._estimators = self._on_trial.pop()
            self._set_outcome(key, known)
            if known is None:
                del self.deployments[
                    bisect_left(self.deployments, deployment_order(key), key=deployment_order)
                ]
        self.newest, self.newest_stamp = self._before
