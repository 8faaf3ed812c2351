# SPDX-License-Identifier: Apache-2.0
"""What a robot's target detector says, whatever type it says it in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from kbnitp_ros.messages.headers import read_stamp
from kbnitp_ros.nodes.topic import message_class

# What the parameter detection_type may be; not all installations have the package of the second.
TYPES = {'bool': 'std_msgs/msg/Bool', 'detection2d_array': 'vision_msgs/msg/Detection2DArray'}


class Detection(NamedTuple):
    """What was said at once."""

    # Whether there is a target.
    seen: bool
    # When it was looked for, in nanoseconds; None when that is not told.
    stamp: int | None


def detection_class(name: str) -> type:
    """Return the message class of a value of the parameter detection_type."""
    try:
        return message_class(TYPES[name])
    except LookupError as error:
        package = TYPES[name].partition('/')[0]
        raise ValueError(
            f'parameter detection_type is {name!r}: {error}; install {package}, such as by rosdep '
            f'or as ros-jazzy-{package.replace("_", "-")}, or have the detector say std_msgs/Bool'
        ) from error


def read_detection(message: Any, values: Mapping[str, Any]) -> Detection:
    """Return what a message of the detector says, by the parameters of its type."""
    if values['detection_type'] == 'bool':
        return Detection(bool(message.data), None)
    wanted, least = values['detection_class'], values['detection_score']
    seen = any(
        result.hypothesis.class_id == (wanted or result.hypothesis.class_id)
        and result.hypothesis.score >= least
        for detection in message.detections
        for result in detection.results
    )
    stamp = read_stamp('header.stamp', message.header.stamp)
    # A driver that fills no header says nothing of the time.
    return Detection(seen, stamp or None)
