# SPDX-License-Identifier: Apache-2.0
"""What all messages start with: a time in whole nanoseconds and the frame of the grid."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from kbnitp_ros.messages.fields import Fields, filled

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from std_msgs.msg import Header

FRAME = 'map'
SECOND = 10**9
HOUR = 3600 * SECOND

# Whole seconds are an int32. Names of deployments are counted on from the time of a belief and
# from other names, so the last hours are kept free for that: no message tells a time after
# `LATEST`, nothing is counted on from a name after `LAST_COUNTED_ON`, and there is none after
# `LAST_NAME`. Whoever sends a message at one of these bounds leaves an hour of nanoseconds.
END = 2**31 * SECOND
LATEST, LAST_COUNTED_ON, LAST_NAME = END - 3 * HOUR, END - 2 * HOUR, END - HOUR

# The most characters of a text from outside that an error shows.
SHOWN = 100


def stamp_fields(nanoseconds: int) -> Fields:
    """Return the fields of a builtin_interfaces/Time."""
    seconds, rest = divmod(nanoseconds, SECOND)
    if not -(2**31) <= seconds < 2**31:
        raise ValueError(f'stamp is {nanoseconds} ns: its whole seconds must fit an int32')
    return Fields(sec=seconds, nanosec=rest)


def to_stamp(nanoseconds: int) -> Time:
    """Return the message of a time; errors are those of `stamp_fields`."""
    from builtin_interfaces.msg import Time

    return filled(Time(), stamp_fields(nanoseconds))


def from_stamp(stamp: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def read_stamp(name: str, stamp: Any, last: int = LATEST) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time that came from outside."""
    if not stamp.nanosec < SECOND:
        raise ValueError(f'{name}.nanosec is {stamp.nanosec}: it must be below {SECOND}')
    nanoseconds = from_stamp(stamp)
    if not 0 <= nanoseconds <= last:
        raise ValueError(
            f'{name} is {stamp.sec}.{stamp.nanosec:09d} s: '
            f'it must be from 0 to {last // SECOND} s, so that later ones can follow'
        )
    return nanoseconds


def read_name(name: str, stamp: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time that names a deployment."""
    return read_stamp(name, stamp, LAST_NAME)


def next_name(earliest: int, *names: int) -> int:
    """Return the first name, in nanoseconds, that is after those in use and not too early."""
    return max([earliest, *(each + 1 for each in names if each <= LAST_COUNTED_ON)])


def shown(text: str) -> str:
    """Return a text from outside as an error shows it: quoted, and cut if it is long."""
    if len(text) <= SHOWN:
        return repr(text)
    return f'{text[:SHOWN]!r}... ({len(text)} characters)'


def header_fields(nanoseconds: int) -> Fields:
    """Return the fields of the header of a message about the grid at this time."""
    return Fields(stamp=stamp_fields(nanoseconds), frame_id=FRAME)


def header(nanoseconds: int) -> Header:
    """Return the header of a message about the grid at this time."""
    from std_msgs.msg import Header

    return filled(Header(), header_fields(nanoseconds))


def check_frame(name: str, frame_id: str) -> None:
    """Check that positions are given in the frame of the grid."""
    if frame_id != FRAME:
        raise ValueError(
            f'{name} is {shown(frame_id)}: it must be {FRAME!r}, the frame of the grid'
        )
