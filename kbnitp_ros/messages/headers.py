# SPDX-License-Identifier: Apache-2.0
"""What all messages have: a time and a frame, the mission they are of, a hash of what they say."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from functools import lru_cache
from hashlib import blake2b
import struct
from types import SimpleNamespace
from typing import Any, TYPE_CHECKING, TypeVar

import numpy as np

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


M = TypeVar('M')

# An object with fields, arrays of numbers as numpy's, lists of messages as lists of such objects.
Fields = SimpleNamespace


def filled(message: M, fields: Fields) -> M:
    """Return a message, after its fields were set."""
    for name, value in vars(fields).items():
        if isinstance(value, Fields):
            filled(getattr(message, name), value)
        elif isinstance(value, np.ndarray):
            # Of all that can be assigned, only this type is not checked value by value.
            setattr(message, name, array(value.dtype.char, value.tobytes()))
        elif not (isinstance(value, list) and value and isinstance(value[0], Fields)):
            setattr(message, name, value)
    return message


# Of the hash: what a uint64 field holds.
BYTES = 8


def content_hash(message: Any) -> int:
    """Return a hash of the names and the values of a message's fields."""
    return int.from_bytes(
        blake2b(b''.join(_encoded(message)), digest_size=BYTES).digest(), 'little'
    )


def _encoded(value: Any) -> Iterator[bytes]:
    """Yield a value as bytes that no other value has: a tag, the size if that varies, the rest."""
    if isinstance(value, bool):
        yield b'b\1' if value else b'b\0'
    elif isinstance(value, int):
        # The least and the largest are those of int64 and uint64.
        yield b'i' + value.to_bytes(9, 'little', signed=True)
    elif isinstance(value, float):
        yield b'f' + struct.pack('<d', value)
    elif isinstance(value, str):
        text = value.encode()
        yield b's' + struct.pack('<Q', len(text)) + text
    elif fields := _encoded_fields(value.__class__):
        yield b'm' + struct.pack('<Q', len(fields))
        for name, encoded_name in fields:
            yield encoded_name
            yield from _encoded(getattr(value, name))
    elif isinstance(value, Iterable):
        elements = list(value)
        yield b'a' + struct.pack('<Q', len(elements))
        for element in elements:
            yield from _encoded(element)
    else:
        raise TypeError(f'a field is of {type(value)}: no value of a message is')


@lru_cache
def _encoded_fields(kind: type) -> tuple[tuple[str, bytes], ...]:
    """Return the names of a message's fields as they are defined, and as bytes; none of others."""
    if hasattr(kind, 'get_fields_and_field_types'):
        names = tuple(kind.get_fields_and_field_types())
    else:
        names = getattr(kind, '__slots__', ())
    return tuple((name, b''.join(_encoded(name))) for name in names)


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
