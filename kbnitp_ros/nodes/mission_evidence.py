# SPDX-License-Identifier: Apache-2.0
"""The draws and decisions that a planner computes from the evidence of its mission."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from threading import Lock
from typing import Any

from kbnitp_ros.base.state import BaseState
from kbnitp_ros.configuration import make_goal
from kbnitp_ros.core import Belief, Decision, DeploymentKey, Goal, HazardDraws, Ledger, Report
from kbnitp_ros.messages.beliefs import Snapshot
import numpy as np


class MissionEvidence:
    """The draws and decisions that are computed from the evidence of a mission."""

    def __init__(self, values: Mapping[str, Any], state: BaseState) -> None:
        self._values = values
        self._state = state
        self._prior: Snapshot | None = None
        # The lock of the fields below.
        self._folding = Lock()
        # The ledger, its prior, and the reports in the ledger.
        self._ledger: Ledger | None = None
        self._begun_with: Snapshot | None = None
        self._taken: dict[DeploymentKey, Report] = {}
        # The last draws, and the belief that they belong to.
        self._drawn: tuple[Belief, HazardDraws] | None = None

    @property
    def goal(self) -> Goal | None:
        """Return the goal of the mission; None to map the field."""
        return make_goal(self._values, self._state.grid)

    def begin(self, prior: Snapshot) -> None:
        """Use an estimator's first belief as prior, unless the last prior had the same rules."""
        if self._prior is None or self._prior.rules() != prior.rules():
            self._prior = prior

    def draws(self, known: Snapshot) -> HazardDraws | None:
        """Return draws of the hazards for a belief; None if it does not match the evidence."""
        # Reading existing draws needs no lock.
        drawn = self._drawn
        if drawn and is_same(drawn[0], known.belief):
            return drawn[1]
        with self._folding:
            ledger = self._ledger_now()
            if ledger is None or not is_same(ledger.belief, known.belief):
                return None
            draws = HazardDraws.of(ledger.estimator, len(ledger.deployments))
            self._drawn = known.belief, draws
            return draws

    @property
    def are_joint(self) -> bool:
        """Return whether draws are samples of the joint distribution of all cells."""
        return self._ledger is not None and self._ledger.estimator.draws_are_exact

    def decision(self, known: Snapshot) -> Decision | None:
        """Return the decision given a belief; None without a goal, or if evidence is missing."""
        goal, draws = self.goal, None
        if goal is not None:
            draws = self.draws(known)
        if goal is None or draws is None:
            return None
        return goal.decide(self._state.grid, draws, known.model, self._values['max_steps'])

    def _ledger_now(self) -> Ledger | None:
        """Return the ledger with all evidence; None before the prior has been received."""
        prior = self._prior
        if prior is None:
            return None
        if self._ledger is None or prior is not self._begun_with:
            self._ledger, self._begun_with, self._taken = prior.ledger(), prior, {}
            self._drawn = None
        for key, report in list(self._state.reports.items()):
            if self._taken.get(key) is not report:
                self._taken[key] = report
                # The estimator reports refused evidence.
                with suppress(ValueError):
                    self._ledger.record_path(key, self._state.paths[key])
                    self._ledger.record_report(key, report)
        return self._ledger


def is_same(one: Belief, other: Belief) -> bool:
    """Return whether two beliefs are equal, bit for bit."""
    return one is other or np.array_equal(one.joint, other.joint)
