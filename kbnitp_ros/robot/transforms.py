# SPDX-License-Identifier: Apache-2.0
"""
Where a robot is, from TF.

tf2_ros is not among the packages that come as wheels, and all that is needed of it is the newest
position of one frame in another.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from kbnitp_ros.messages.headers import from_stamp, SECOND
import numpy as np
from numpy.typing import NDArray

# How many frames are known at most: a robot has some tens.
MOST_FRAMES = 1000


class Link(NamedTuple):
    """Where a frame is in the one above it."""

    # The frame above.
    parent: str
    # Where its origin is there, in metres. Shape (3,).
    translation: NDArray[np.float64]
    # How it is turned there, a unit quaternion x, y, z, w. Shape (4,).
    rotation: NDArray[np.float64]
    # Since when, in nanoseconds; None if it never changes.
    stamp: int | None


class Place(NamedTuple):
    """Where a robot was."""

    # In metres.
    x: float
    y: float
    # When, in nanoseconds: the time of the oldest of what it is made of.
    stamp: int
    # The time of the transform nearest to the robot that changes, such as its odometry. Those
    # above it correct it, may come seldom, and may tell a time ahead.
    odometry: int


class Transforms:
    """The newest place of each frame in the one above it."""

    def __init__(self, frame: str, of: str) -> None:
        self._frame = frame
        self._of = of
        self._links: dict[str, Link] = {}

    def take(self, message: Any, *, static: bool) -> None:
        """Take in a tf2_msgs/TFMessage."""
        for transform in message.transforms:
            child, pose = transform.child_frame_id.lstrip('/'), transform.transform
            move, turn = pose.translation, pose.rotation
            translation = np.array([move.x, move.y, move.z])
            rotation = np.array([turn.x, turn.y, turn.z, turn.w])
            length = float(np.linalg.norm(rotation))
            if not (np.isfinite(translation).all() and 0.9 < length < 1.1):
                raise ValueError(
                    f'the transform to {child!r} has translation {translation.tolist()} and '
                    f'rotation {rotation.tolist()}: they must be finite and a unit quaternion'
                )
            if child not in self._links and len(self._links) == MOST_FRAMES:
                raise ValueError(f'frame {child!r} is one more than {MOST_FRAMES}')
            parent = transform.header.frame_id.lstrip('/')
            stamp = None if static else from_stamp(transform.header.stamp)
            self._links[child] = Link(parent, translation, rotation / length, stamp)

    def place(self, now: int, oldest: float) -> Place:
        """Return the place of the frame by a transform of at most so many seconds ago."""
        place: NDArray[np.float64] = np.zeros(3)
        frame, stamp = self._of, now
        odometry: int | None = None
        passed = set()
        while frame != self._frame:
            link = self._links.get(frame)
            if link is None or frame in passed:
                raise ValueError(
                    f'no transform leads from {self._frame!r} to {self._of!r}: nobody tells where '
                    f'{frame!r} is'
                )
            passed.add(frame)
            changed = now if link.stamp is None else link.stamp
            if now - changed > oldest * SECOND:
                raise ValueError(
                    f'the last transform from {link.parent!r} to {frame!r} is of more than '
                    f'{oldest} s ago (parameter tf_timeout)'
                )
            place = link.translation + rotated(place, link.rotation)
            frame, stamp = link.parent, min(stamp, changed)
            odometry = link.stamp if odometry is None else odometry
        return Place(
            float(place[0]), float(place[1]), stamp, now if odometry is None else odometry
        )


def rotated(vector: NDArray[np.float64], by: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a vector turned by a unit quaternion x, y, z, w."""
    axis, w = by[:3], by[3]
    turned: NDArray[np.float64] = vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)
    return turned
