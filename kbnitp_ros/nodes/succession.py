# SPDX-License-Identifier: Apache-2.0
"""Which paths and beliefs are of one mission, and which beliefs are of one estimator."""

from __future__ import annotations

from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import shown
from kbnitp_ros.messages.missions import check_mission, named
from kbnitp_ros.nodes.parameters import MOST_ROBOTS

# How many missions a node hears of before it knows which is its own.
MOST_MISSIONS = 100


class Succession:
    """
    The mission that a node takes part in, and the beliefs of its estimator.

    Attributes
    ----------
    mission : int or None
        When it began, in nanoseconds; None as long as no robot is known to have left.
    newest : Snapshot or None
        The belief that holds the most deployments, of these the last; None before the first.

    """

    def __init__(self) -> None:
        self.mission: int | None = None
        self.newest: Snapshot | None = None
        self._heard: set[int] = set()

    def begin(self, mission: int) -> int:
        """Return the mission to send paths of: this one, unless paths of another were sent."""
        if self.mission is None:
            self.mission = mission
        return self.mission

    def hear(self, mission: int) -> None:
        """
        Take note of the mission of a path.

        An estimator that starts anew names another one before it hears the paths. So paths of any
        are taken until there is a belief that holds some of them.

        Raises
        ------
        ValueError
            If it is another mission than this, or the latest of very many.

        """
        check_mission(mission, self.mission)
        if mission not in self._heard and len(self._heard) == MOST_MISSIONS:
            raise ValueError(f'it belongs to {named(mission)}: {MOST_MISSIONS} others are known')
        self._heard.add(mission)

    def check(self, snapshot: Snapshot, authors: int, most: int | None = None) -> None:
        """
        Check that the estimator of this mission can have published a belief.

        Parameters
        ----------
        snapshot : Snapshot
            The belief.
        authors : int
            How many nodes publish beliefs. One alone may have been started again with other
            parameters, and may know of deployments that nobody else does.
        most : int, optional
            How many deployments are known.

        Raises
        ------
        ValueError
            If it is of another mission, or another estimator's than the newest, or holds more
            deployments than a mission can have.

        """
        if snapshot.deployments > MOST_ROBOTS:
            raise ValueError(
                f'deployments is {snapshot.deployments}: a mission has at most {MOST_ROBOTS}'
            )
        self._check_mission(snapshot)
        if self.newest is None or authors <= 1:
            return
        remedy = f'and {authors} nodes publish beliefs: all but one must end'
        rules = self.newest.rules()
        for name, theirs in snapshot.rules().items():
            if theirs != (ours := rules[name]):
                raise ValueError(
                    f'{name} is {shown(str(theirs))}: it was {shown(str(ours))} before, {remedy}'
                )
        if most is not None and snapshot.deployments > most:
            raise ValueError(
                f'deployments is {snapshot.deployments}: only {most} are known, {remedy}'
            )

    def _check_mission(self, snapshot: Snapshot) -> None:
        own = self.mission
        if own is None:
            if self.newest is None or snapshot.mission in self._heard:
                return
            own = self.newest.mission
        # The prior of an estimator that started anew is that of a mission begun later.
        if snapshot.deployments or snapshot.mission < own:
            check_mission(snapshot.mission, own)

    def take(self, snapshot: Snapshot) -> bool:
        """
        Keep a belief if it is the newest, and say so.

        An estimator that was started again goes through its earlier beliefs once more.
        """
        if snapshot.deployments and self.mission is None:
            self.mission = snapshot.mission
        is_newest = self.newest is None or snapshot.deployments >= self.newest.deployments
        if is_newest:
            self.newest = snapshot
        return is_newest
