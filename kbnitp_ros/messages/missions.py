# SPDX-License-Identifier: Apache-2.0
"""
Which mission a message belongs to: the time at which that began.

An estimator that starts anew names a mission by the time of its prior, in the field `mission` of
its beliefs. The planner gives it to all poses of a path as their `header.stamp`, since
nav_msgs/Path has no other place for it, and a report belongs to the mission of the path that it
names. So messages of an old bag are told from those of the mission that they are played into.

A path whose poses have no time, or that of the path itself, names none: it belongs to the mission
`NO_MISSION`.
"""

from __future__ import annotations

from typing import Any

from kbnitp_ros.messages.headers import from_stamp, read_stamp, SECOND

NO_MISSION = 0


def mission_of_path(message: Any) -> int:
    """Return when the mission of a nav_msgs/Path began, in nanoseconds."""
    stated = message.poses[0].header.stamp if message.poses else message.header.stamp
    if from_stamp(stated) == from_stamp(message.header.stamp):
        return NO_MISSION
    return read_stamp('poses[0].header.stamp', stated)


def check_mission(stated: int, own: int | None) -> None:
    """Check that a message belongs to a node's mission; None if that has not joined any."""
    if own not in (None, stated):
        raise ValueError(
            f'it belongs to {named(stated)}, and not to {named(own)}: '
            'play bags in a domain or a namespace of their own'
        )


def named(mission: int) -> str:
    """Return what a mission is called."""
    if mission == NO_MISSION:
        return 'a mission that tells no time'
    return f'the mission begun at {mission // SECOND}.{mission % SECOND:09d}'
