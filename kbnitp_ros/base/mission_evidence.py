# SPDX-License-Identifier: Apache-2.0
"""The evidence of a mission at the base, with the draws and decisions computed from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from threading import Lock
from typing import Any

from kbnitp_ros.configuration import make_goal
from kbnitp_ros.core import (
    Belief,
    Decision,
    DeploymentKey,
    Goal,
    Grid,
    HazardDraws,
    Ledger,
    Report,
    RobotType,
)
from kbnitp_ros.core.inference.record import MissionRecord
from kbnitp_ros.messages.beliefs import Snapshot
import numpy as np
from numpy.typing import ArrayLike

# A function that records a path or a report.
Event = Callable[[MissionRecord], bool]


class MissionEvidence:
    """The evidence of a mission, with the draws and decisions computed from it."""

    def __init__(
        self, grid: Grid, values: Mapping[str, Any], robot_types: Mapping[str, RobotType]
    ) -> None:
        self._grid = grid
        self._values = values
        # The paths and reports that count.
        self.record = MissionRecord(grid, values['max_steps'], robot_types)
        self._prior: Snapshot | None = None
        # All paths and reports so far, in the order of arrival.
        self._events: list[Event] = []
        # The lock of the fields below.
        self._folding = Lock()
        # The ledger, its prior, and the number of events applied to the ledger.
        self._ledger: Ledger | None = None
        self._begun_with: Snapshot | None = None
        self._taken = 0
        # The last draws, and the belief that they belong to.
        self._drawn: tuple[Belief, HazardDraws] | None = None

    @property
    def goal(self) -> Goal | None:
        """Return the goal of the mission; None to map the field."""
        return make_goal(self._values, self._grid)

    def begin(self, prior: Snapshot) -> None:
        """Use an estimator's first belief as prior, unless the last prior had the same rules."""
        if self._prior is None or self._prior.rules() != prior.rules():
            self._prior = prior

    def note_path(self, key: DeploymentKey, path: ArrayLike, content: int = 0) -> None:
        """Record the path of a robot."""
        self._note(lambda deployments: deployments.record_path(key, path, content))

    def note_report(self, key: DeploymentKey, report: Report) -> None:
        """Record the report of a robot."""
        self._note(lambda deployments: deployments.record_report(key, report))

    def _note(self, event: Event) -> None:
        # The estimator reports refused evidence.
        with suppress(ValueError):
            event(self.record)
        self._events.append(event)

    @property
    def evidence(self) -> int:
        """Return the number of paths and reports recorded."""
        return len(self._events)

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
        return goal.decide(self._grid, draws, known.model, self._values['max_steps'])

    def _ledger_now(self) -> Ledger | None:
        """Return the ledger with all evidence; None before the prior has been received."""
        prior = self._prior
        if prior is None:
            return None
        if self._ledger is None or prior is not self._begun_with:
            self._ledger, self._begun_with, self._taken = prior.ledger(), prior, 0
            self._drawn = None
        taken = self._taken
        for event in self._events[taken:]:
            self._taken += 1
            with suppress(ValueError):
                event(self._ledger)
        return self._ledger


def is_same(one: Belief, other: Belief) -> bool:
    """Return whether two beliefs are equal, bit for bit."""
    return one is other or np.array_equal(one.joint, other.joint)
