# SPDX-License-Identifier: Apache-2.0
"""What the base knows of the hazards together: the estimator's fold, made again for draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from threading import Lock
from typing import Any

from kbnitp_ros.configuration import goal_of
from kbnitp_ros.configuration.mission import stop_of
from kbnitp_ros.core import (
    Belief,
    Decision,
    DeploymentKey,
    Goal,
    Grid,
    HazardDraws,
    Ledger,
    MissionRecord,
    Report,
    RobotType,
    Stop,
)
from kbnitp_ros.messages.beliefs import Snapshot
import numpy as np
from numpy.typing import ArrayLike

# A path or a report that deployments take note of.
Event = Callable[[MissionRecord], bool]


class Knowledge:
    """The evidence of a mission, and the draws and decisions that it gives."""

    def __init__(
        self, grid: Grid, values: Mapping[str, Any], robot_types: Mapping[str, RobotType]
    ) -> None:
        self._grid = grid
        self._values = values
        self._deployments = MissionRecord(grid, values['max_steps'], robot_types)
        self._prior: Snapshot | None = None
        # All evidence so far.
        self._events: list[Event] = []
        # Held by whoever changes what is below.
        self._folding = Lock()
        # The ledger, the prior that it began with, and how much of the evidence it has taken in.
        self._ledger: Ledger | None = None
        self._begun_with: Snapshot | None = None
        self._taken = 0
        # The draws made last, and the belief that they go with.
        self._drawn: tuple[Belief, HazardDraws] | None = None

    @property
    def goal(self) -> Goal | None:
        """Return what the mission is to make sure of; None to map the field."""
        return goal_of(self._values, self._grid)

    @property
    def stop(self) -> Stop:
        """Return when it is over before its last robot has left."""
        return stop_of(self._values)

    @property
    def lost(self) -> int:
        """How many robots are known to be lost."""
        return self._deployments.lost

    def begin(self, prior: Snapshot) -> None:
        """Take the first belief of an estimator for the prior."""
        if self._prior is None or self._prior.rules() != prior.rules():
            self._prior = prior

    def note_path(self, key: DeploymentKey, path: ArrayLike, content: int = 0) -> None:
        """Take note of the path of a robot."""
        self._note(lambda deployments: deployments.record_path(key, path, content))

    def note_report(self, key: DeploymentKey, report: Report) -> None:
        """Take note of what became of a robot."""
        self._note(lambda deployments: deployments.record_report(key, report))

    def _note(self, event: Event) -> None:
        # What the estimator refuses is refused here as well, and told by the estimator.
        with suppress(ValueError):
            event(self._deployments)
        self._events.append(event)

    @property
    def evidence(self) -> int:
        """How many paths and reports were taken note of."""
        return len(self._events)

    def draws(self, known: Snapshot) -> HazardDraws | None:
        """Return draws of the hazards that go with a belief; None if it is not known how."""
        # Who has them already does not wait for others.
        if (draws := self._drawn_with(known)) is not None:
            return draws
        with self._folding:
            ledger = self._ledger_now()
            if ledger is not None and is_same(ledger.belief, known.belief):
                draws = HazardDraws.of(ledger.estimator, len(ledger.deployments))
                self._drawn = known.belief, draws
            return self._drawn_with(known)

    def _drawn_with(self, known: Snapshot) -> HazardDraws | None:
        """Return the draws made last if they go with a belief."""
        drawn = self._drawn
        return drawn[1] if drawn and is_same(drawn[0], known.belief) else None

    def decision(self, known: Snapshot) -> Decision | None:
        """Return what may be relied on with a belief; None if that cannot be said."""
        goal, draws = self.goal, None
        if goal is not None:
            draws = self.draws(known)
        if goal is None or draws is None:
            return None
        return goal.decide(self._grid, draws, known.model, self._values['max_steps'])

    def _ledger_now(self) -> Ledger | None:
        """Return the ledger with all evidence; None if the prior is not known."""
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
    """Return whether two beliefs are the same, bit for bit."""
    return one is other or np.array_equal(one.joint, other.joint)
