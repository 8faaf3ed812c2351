# SPDX-License-Identifier: Apache-2.0
"""The position of a robot by TF or satellites, and the step of its walk at any time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import isfinite, sqrt
from typing import Any, NamedTuple

from kbnitp_ros.messages.headers import from_stamp, SECOND, shown
import numpy as np
from numpy.typing import NDArray

# Maximum number of frames; a robot has tens.
MAX_FRAMES = 1000


# The transform of a frame to its parent: name of the parent, translation in metres, rotation as a
# unit quaternion x, y, z, w, and time in nanoseconds (None if it is static).
Link = tuple[str, NDArray[np.float64], NDArray[np.float64], int | None]


class Place(NamedTuple):
    """The place of a robot at a time."""

    # Metres.
    x: float
    y: float
    # The time of the oldest transform used, nanoseconds.
    stamp: int
    # The time of the first non-static transform on the way from the robot's frame to the map,
    # usually odometry. Later transforms correct odometry, may be rare, and may be dated ahead.
    odometry: int


class Transforms:
    """The newest transform of each frame to its parent."""

    def __init__(self, frame: str, robot_frame: str) -> None:
        self._frame = frame
        self._robot_frame = robot_frame
        self._links: dict[str, Link] = {}

    def take(self, message: Any, *, static: bool) -> None:
        """Add a tf2_msgs/TFMessage."""
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
            if child not in self._links and len(self._links) == MAX_FRAMES:
                raise ValueError(f'frame {child!r} exceeds the maximum of {MAX_FRAMES} frames')
            parent = transform.header.frame_id.lstrip('/')
            stamp = None if static else from_stamp(transform.header.stamp)
            self._links[child] = parent, translation, rotation / length, stamp

    def place(self, now: int, oldest: float) -> Place:
        """Return the place of the robot by transforms at most `oldest` seconds old."""
        place: NDArray[np.float64] = np.zeros(3)
        frame, stamp = self._robot_frame, now
        odometry: int | None = None
        passed = set()
        while frame != self._frame:
            if frame not in self._links or frame in passed:
                raise ValueError(
                    f'no transform leads from {self._frame!r} to {self._robot_frame!r}: the place '
                    f'of {frame!r} is unknown'
                )
            passed.add(frame)
            parent, translation, rotation, since = self._links[frame]
            changed = now if since is None else since
            if now - changed > oldest * SECOND:
                raise ValueError(
                    f'the last transform from {parent!r} to {frame!r} is older than {oldest} s '
                    '(parameter tf_timeout)'
                )
            axis, w = rotation[:3], rotation[3]
            turn = 2 * np.cross(axis, np.cross(axis, place) + w * place)
            place = translation + (place + turn)
            frame, stamp = parent, min(stamp, changed)
            odometry = since if odometry is None else odometry
        return Place(
            float(place[0]), float(place[1]), stamp, now if odometry is None else odometry
        )


# Values of sensor_msgs/NavSatFix: lowest status with a fix, and type of an unknown covariance.
FIX, UNKNOWN = 0, 0


class Fixes:
    """The newest place by satellite fixes."""

    def __init__(
        self, in_map: Callable[[float, float], tuple[float, float]], frame: str, largest: float
    ) -> None:
        self._in_map = in_map
        self._frame = frame
        self._largest = largest
        self._newest: Place | None = None

    def take(self, message: Any) -> None:
        """Add a sensor_msgs/NavSatFix."""
        frame = message.header.frame_id.lstrip('/')
        if frame != self._frame:
            raise ValueError(
                f'header.frame_id is {shown(frame)}: it must be {self._frame!r}, the frame of '
                'the antenna (parameter base_frame)'
            )
        if message.status.status < FIX:
            raise ValueError(f'status.status is {message.status.status}: there is no fix')
        for name, most in (('latitude', 90.0), ('longitude', 180.0)):
            if not abs(value := getattr(message, name)) <= most:
                raise ValueError(f'{name} is {value}: it must be from {-most:g} to {most:g}')
        if message.position_covariance_type == UNKNOWN:
            raise ValueError('position_covariance_type is 0: a fix must have a covariance')
        variances = float(message.position_covariance[0]), float(message.position_covariance[4])
        if not all(isfinite(each) and each > 0.0 for each in variances):
            raise ValueError(
                f'position_covariance has {variances} east and north: they must be positive'
            )
        if (deviation := sqrt(max(variances))) > self._largest:
            raise ValueError(
                f'the standard deviation of the fix is {deviation:.2f} m: at most '
                f'{self._largest:g} m, half a cell, is accepted'
            )
        x, y = self._in_map(message.latitude, message.longitude)
        stamp = from_stamp(message.header.stamp)
        self._newest = Place(x, y, stamp, stamp)

    def place(self, now: int, oldest: float) -> Place:
        """Return the place of the robot by a fix at most `oldest` seconds old."""
        if self._newest is None:
            raise ValueError('no fix was accepted yet')
        if now - self._newest.stamp > oldest * SECOND:
            raise ValueError(f'the last fix is older than {oldest} s (parameter tf_timeout)')
        return self._newest


# Step number of a robot near the edge of a cell or without a position: no detection counts.
NO_STEP = 0


# An interval in which the robot was in one step: first and last time, nanoseconds, and the number
# of the step from 1, or `NO_STEP`.
Span = tuple[int, int, int]


class Whereabouts:
    """The step of the robot at any recent time; times are in nanoseconds."""

    def __init__(self, kept: int, gap: int) -> None:
        # Between two positions more than `gap` apart in time, the robot may have been anywhere.
        self._kept = kept
        self._gap = gap
        self._spans: deque[Span] = deque()

    def note(self, time: int, step: int) -> None:
        """Record the robot's step at a time: its number from 1, or `NO_STEP`."""
        spans = self._spans
        if spans and time < spans[-1][1]:
            spans.clear()
        first = time
        if spans:
            since, last, before = spans[-1]
            if before == step and time <= last + self._gap:
                spans.pop()
                first = since
        spans.append((first, time, step))
        while spans[0][1] < time - self._kept:
            spans.popleft()

    def step_within(self, since: int, until: int) -> int | None:
        """Return the step that spans `since` to `until`, or `NO_STEP`; None if not known yet."""
        if not self._spans or until > self._spans[-1][1]:
            return None
        for first, last, step in reversed(self._spans):
            if first <= since:
                return step if until <= last else NO_STEP
        return NO_STEP
