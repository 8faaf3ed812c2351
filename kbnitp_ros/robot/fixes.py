# SPDX-License-Identifier: Apache-2.0
"""Where a robot is, from a receiver of satellite navigation."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, sqrt
from typing import Any

from kbnitp_ros.messages.headers import from_stamp, SECOND, shown
from kbnitp_ros.robot.transforms import Place

# In a sensor_msgs/NavSatFix: statuses from this on are fixes, and this type is no covariance.
FIX, UNKNOWN = 0, 0


class Fixes:
    """The newest place that fixes tell."""

    def __init__(
        self, in_map: Callable[[float, float], tuple[float, float]], frame: str, largest: float
    ) -> None:
        self._in_map = in_map
        self._frame = frame
        self._largest = largest
        self._newest: Place | None = None

    def take(self, message: Any) -> None:
        """Take in a sensor_msgs/NavSatFix."""
        frame = message.header.frame_id.lstrip('/')
        if frame != self._frame:
            raise ValueError(
                f'header.frame_id is {shown(frame)}: it must be {self._frame!r} '
                '(parameter base_frame), where the antenna is'
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
                f'the standard deviation of the fix is {deviation:.2f} m: it may be half the side '
                f'of a cell, {self._largest:g} m'
            )
        x, y = self._in_map(message.latitude, message.longitude)
        stamp = from_stamp(message.header.stamp)
        self._newest = Place(x, y, stamp, stamp)

    def place(self, now: int, oldest: float) -> Place:
        """Return the place of the robot by a fix of at most so many seconds ago."""
        if self._newest is None:
            raise ValueError('no fix was taken in yet')
        if now - self._newest.stamp > oldest * SECOND:
            raise ValueError(f'the last fix is of more than {oldest} s ago (parameter tf_timeout)')
        return self._newest
