# SPDX-License-Identifier: Apache-2.0
"""The mission that paths and beliefs belong to."""

from __future__ import annotations

from typing import Any

from kbnitp_ros.base.state import MAX_ROBOTS, MissingError
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import check_mission, named, shown


class MissionTracker:
    """The mission of a node, and the beliefs of its estimator."""

    def __init__(self) -> None:
        # Start of the mission, nanoseconds; None until a robot is known to have been sent.
        self.mission: int | None = None
        # The latest belief with the most deployments; None before the first belief.
        self.newest: Snapshot | None = None
        # `Snapshot.rules` of the newest belief; None before the first belief.
        self._rules: dict[str, Any] | None = None
        # Missions of received priors: a restarted estimator publishes the prior of a new mission.
        self._priors: set[int] = set()
        # Number of deployments in the first belief whose paths this node did not know.
        self._unknown: int | None = None

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

    def check_belief(self, snapshot: Snapshot, authors: int, known: int) -> None:
        """Check that a belief fits this mission, its deployments and its estimator."""
        # A belief may arrive before its publisher is discovered, so the content is checked: a
        # belief must not hold more deployments than paths were sent. Only the first belief of a
        # single estimator may hold more: an earlier planner sent the other paths.
        if snapshot.deployments > MAX_ROBOTS:
            raise ValueError(
                f'deployments is {snapshot.deployments}: a mission has at most {MAX_ROBOTS}'
            )
        self._check_mission(snapshot, authors)
        remedy = f'{authors} nodes publish beliefs: stop all but one'
        is_first_of_one = self._unknown is None and authors <= 1
        most = known + (self._unknown or 0)
        if snapshot.deployments > most and not is_first_of_one:
            why = f'; {remedy}' if authors > 1 else ''
            raise MissingError(
                f'the belief holds {snapshot.deployments} deployments, but this node knows '
                f'the paths of only {most}{why}'
            )
        if self._rules is None or authors <= 1:
            return
        for name, theirs in snapshot.rules().items():
            if theirs != (ours := self._rules[name]):
                raise ValueError(
                    f'{name} changed from {shown(str(ours))} to {shown(str(theirs))}: {remedy}'
                )

    def _check_mission(self, snapshot: Snapshot, authors: int) -> None:
        own = self.mission
        if own is None:
            if self.newest is None or snapshot.mission in self._priors:
                return
            # An estimator restarted in a running mission first publishes a new mission's prior.
            if authors <= 1 and snapshot.deployments:
                return
            own = self.newest.mission
        # The prior of a restarted estimator belongs to a later mission.
        if snapshot.deployments or snapshot.mission < own:
            check_mission(snapshot.mission, own)

    def accept_belief(self, snapshot: Snapshot, known: int) -> bool:
        """Keep a belief if it is the newest, and return whether it is."""
        if self._unknown is None:
            self._unknown = max(0, snapshot.deployments - known)
        if snapshot.deployments and self.mission is None:
            self.mission = snapshot.mission
        elif not snapshot.deployments:
            self._priors.add(snapshot.mission)
        is_newest = self.newest is None or snapshot.deployments >= self.newest.deployments
        if is_newest:
            self.newest = snapshot
            self._rules = snapshot.rules()
        return is_newest
