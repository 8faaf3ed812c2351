# SPDX-License-Identifier: Apache-2.0
"""What all messages start with: a time in whole nanoseconds and the frame of the grid."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

FRAME = 'map'
SECOND = 10**9


def to_stamp(nanoseconds: int) -> Time:
    """
    Return the message of a time.

    Raises
    ------
    ValueError
        If it does not fit: whole seconds are an int32.

    """
    seconds, rest = divmod(nanoseconds, SECOND)
    if not -(2**31) <= seconds < 2**31:
        raise ValueError(f'stamp is {nanoseconds} ns: its whole seconds must fit an int32')
    return Time(sec=seconds, nanosec=rest)


def from_stamp(stamp: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def read_stamp(name: str, stamp: Any) -> int:
    """
    Return the nanoseconds of a builtin_interfaces/Time that came from outside.

    Raises
    ------
    ValueError
        If its nanoseconds are a second or more: then two messages would say the same time.

    """
    if not stamp.nanosec < SECOND:
        raise ValueError(f'{name}.nanosec is {stamp.nanosec}: it must be below {SECOND}')
    return from_stamp(stamp)


def header(nanoseconds: int) -> Header:
    """Return the header of a message about the grid at this time."""
    return Header(stamp=to_stamp(nanoseconds), frame_id=FRAME)


def check_frame(name: str, frame_id: str) -> None:
    """
    Check that positions are given in the frame of the grid.

    Raises
    ------
    ValueError
        If the frame is another one.

    """
    if frame_id != FRAME:
        raise ValueError(f'{name} is {frame_id!r}: it must be {FRAME!r}, the frame of the grid')
