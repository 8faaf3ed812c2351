# SPDX-License-Identifier: Apache-2.0
"""Which paths and beliefs are of one mission, and which beliefs are of one estimator."""

from __future__ import annotations

from typing import Any

from kbnitp_ros.configuration import MOST_ROBOTS
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import shown
from kbnitp_ros.messages.missions import check_mission, named


class PathsUnknownError(ValueError):
    """A belief holds deployments whose paths are not known, or not yet."""


class MissionTracker:
    """The mission that a node takes part in, and the beliefs of its estimator."""

    def __init__(self) -> None:
        # When it began, in nanoseconds; None as long as no robot is known to have left.
        self.mission: int | None = None
        # The belief that holds the most deployments, of these the last; None before the first.
        self.newest: Snapshot | None = None
        # What the estimator of the newest belief was started with; None before the first.
        self._rules: dict[str, Any] | None = None
        # The missions of all priors so far: one that an estimator states when it starts anew.
        self._priors: set[int] = set()
        # How many deployments the first belief held of which no path was known.
        self._unknown: int | None = None

    def begin(self, mission: int) -> int:
        """Return the mission to send paths of: this one, unless paths of another were sent."""
        if self.mission is None:
            self.mission = mission
        return self.mission

    def check_path(self, mission: int) -> None:
        """Check that a path can be of this mission."""
        check_mission(mission, self.mission)
        if self.mission is None and mission not in self._priors:
            raise ValueError(
                f'it belongs to {named(mission)}, but no belief of that mission was received: '
                'play bags on another ROS domain or in another namespace'
            )

    def check_belief(self, snapshot: Snapshot, authors: int, known: int) -> None:
        """Check that the estimator of this mission can have published a belief."""
        # A belief may come before its publisher is counted, so its contents decide: none holds
        # more deployments than paths were sent, but the first one heard of an estimator that is
        # alone. The paths then died with the planner before.
        if snapshot.deployments > MOST_ROBOTS:
            raise ValueError(
                f'deployments is {snapshot.deployments}: a mission has at most {MOST_ROBOTS}'
            )
        self._check_mission(snapshot, authors)
        remedy = f'{authors} nodes publish beliefs: stop all but one'
        is_first_of_one = self._unknown is None and authors <= 1
        most = known + (self._unknown or 0)
        if snapshot.deployments > most and not is_first_of_one:
            why = f', and {remedy}' if authors > 1 else ''
            raise PathsUnknownError(
                f'deployments is {snapshot.deployments}: the paths of only {most} are known{why}'
            )
        if self._rules is None or authors <= 1:
            return
        for name, theirs in snapshot.rules().items():
            if theirs != (ours := self._rules[name]):
                raise ValueError(
                    f'{name} is {shown(str(theirs))}: it was {shown(str(ours))} before, and '
                    f'{remedy}'
                )

    def _check_mission(self, snapshot: Snapshot, authors: int) -> None:
        own = self.mission
        if own is None:
            if self.newest is None or snapshot.mission in self._priors:
                return
            # An estimator that starts anew in a mission under way states another one first.
            if authors <= 1 and snapshot.deployments:
                return
            own = self.newest.mission
        # The prior of an estimator that started anew is that of a mission begun later.
        if snapshot.deployments or snapshot.mission < own:
            check_mission(snapshot.mission, own)

    def accept_belief(self, snapshot: Snapshot, known: int) -> bool:
        """Keep a belief if it is the newest, and say so."""
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

    def forget_newest(self) -> None:
        """Take the next belief of the same estimator for the newest, whatever it holds."""
        self.newest = None
