# SPDX-License-Identifier: Apache-2.0
"""The mission that paths and beliefs belong to."""

from __future__ import annotations

from typing import Any

from kbnitp_ros.base.state import MAX_ROBOTS
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import check_mission, named, shown


class MissionTracker:
    """The mission of a node, and the rules of its estimator."""

    def __init__(self) -> None:
        # Start of the mission, nanoseconds; None until a robot is known to have been sent.
        self.mission: int | None = None
        # Mission, and `Snapshot.rules`, of the last belief; None before the first belief.
        self._last: int | None = None
        self._rules: dict[str, Any] | None = None
        # Missions of received priors: a restarted estimator publishes the prior of a new mission.
        self._priors: set[int] = set()

    def begin(self, mission: int) -> int:
        """Return the mission of new paths; begin the given mission if none has begun."""
        if self.mission is None:
            self.mission = mission
        return self.mission

    def check_path(self, mission: int) -> None:
        """Check that a path is of this mission or, before it begins, of a mission with a prior."""
        check_mission(mission, self.mission)
        if self.mission is None and mission not in self._priors:
            raise ValueError(
                f'it belongs to {named(mission)}, but no belief of that mission was received: '
                'if a bag is played, play it in another ROS domain or namespace'
            )

    def check_belief(self, snapshot: Snapshot, authors: int) -> None:
        """Check that a belief fits this mission and its estimator."""
        if snapshot.deployments > MAX_ROBOTS:
            raise ValueError(
                f'deployments is {snapshot.deployments}: a mission has at most {MAX_ROBOTS}'
            )
        self._check_mission(snapshot, authors)
        if self._rules is None or authors <= 1:
            return
        for name, theirs in snapshot.rules().items():
            if theirs != (ours := self._rules[name]):
                raise ValueError(
                    f'{name} changed from {shown(str(ours))} to {shown(str(theirs))}: {authors} '
                    'nodes publish beliefs: stop all but one'
                )

    def _check_mission(self, snapshot: Snapshot, authors: int) -> None:
        own = self.mission
        if own is None:
            if self._last is None or snapshot.mission in self._priors:
                return
            # An estimator restarted in a running mission first publishes a new mission's prior.
            if authors <= 1 and snapshot.deployments:
                return
            own = self._last
        # The prior of a restarted estimator belongs to a later mission.
        if snapshot.deployments or snapshot.mission < own:
            check_mission(snapshot.mission, own)

    def accept_belief(self, snapshot: Snapshot) -> None:
        """Note the mission and the rules of a belief."""
        if snapshot.deployments and self.mission is None:
            self.mission = snapshot.mission
        elif not snapshot.deployments:
            self._priors.add(snapshot.mission)
        self._last, self._rules = snapshot.mission, snapshot.rules()
