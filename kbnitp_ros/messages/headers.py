# SPDX-License-Identifier: Apache-2.0
"""Common parts of messages: times, names of deployments, frames, missions and content hashes."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from enum import IntEnum
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

# Whole seconds are an int32. The stamp of a deployment is the next free nanosecond after a belief
# or after another stamp, so the last hours are reserved: times of messages are at most `LATEST`,
# a new stamp follows only stamps up to `LAST_COUNTED_ON`, and stamps are at most `LAST_NAME`.
END = 2**31 * SECOND
LATEST, LAST_COUNTED_ON, LAST_NAME = END - 3 * HOUR, END - 2 * HOUR, END - HOUR

# Maximum numbers of characters of a reason, and of foreign text in an error.
MAX_REASON, SHOWN = 500, 100

E = TypeVar('E', bound=IntEnum)
M = TypeVar('M')


def stamp_fields(nanoseconds: int) -> Fields:
    """Return the fields of a builtin_interfaces/Time."""
    seconds, rest = divmod(nanoseconds, SECOND)
    if not -(2**31) <= seconds < 2**31:
        raise ValueError(f'stamp is {nanoseconds} ns: its whole seconds must fit an int32')
    return Fields(sec=seconds, nanosec=rest)


def to_stamp(nanoseconds: int) -> Time:
    """Return the message of a time; raise the errors of `stamp_fields`."""
    from builtin_interfaces.msg import Time

    return filled(Time(), stamp_fields(nanoseconds))


def from_stamp(stamp: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def in_seconds(nanoseconds: int) -> str:
    """Return a time in seconds, as in the names of deployments."""
    return f'{nanoseconds // SECOND}.{nanoseconds % SECOND:09d}'


def read_stamp(name: str, stamp: Any, last: int = LATEST) -> int:
    """Return the nanoseconds of a received builtin_interfaces/Time."""
    if not stamp.nanosec < SECOND:
        raise ValueError(f'{name}.nanosec is {stamp.nanosec}: it must be below {SECOND}')
    nanoseconds = from_stamp(stamp)
    if not 0 <= nanoseconds <= last:
        raise ValueError(
            f'{name} is {in_seconds(nanoseconds)} s: '
            f'it must be from 0 to {last // SECOND} s, which leaves room for later stamps'
        )
    return nanoseconds


def read_name(name: str, stamp: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time that names a deployment."""
    return read_stamp(name, stamp, LAST_NAME)


def next_name(earliest: int, *names: int) -> int:
    """Return the first stamp, in nanoseconds, not before a time and after all given stamps."""
    return max([earliest, *(each + 1 for each in names if each <= LAST_COUNTED_ON)])


def shown(text: str) -> str:
    """Return foreign text for an error message: quoted, and cut if it is long."""
    if len(text) <= SHOWN:
        return repr(text)
    return f'{text[:SHOWN]!r}... ({len(text)} characters)'


def header_fields(nanoseconds: int) -> Fields:
    """Return the fields of a header in the grid's frame at this time."""
    return Fields(stamp=stamp_fields(nanoseconds), frame_id=FRAME)


def header(nanoseconds: int) -> Header:
    """Return a header in the grid's frame at this time."""
    from std_msgs.msg import Header

    return filled(Header(), header_fields(nanoseconds))


def check_frame(name: str, frame_id: str) -> None:
    """Check that positions are in the frame of the grid."""
    if frame_id != FRAME:
        raise ValueError(
            f'{name} is {shown(frame_id)}: it must be {FRAME!r}, the frame of the grid'
        )


def read_header(message: Any, last: int = LATEST) -> int:
    """Return the stamp of a message in the grid's frame, nanoseconds."""
    check_frame('header.frame_id', message.header.frame_id)
    return read_stamp('header.stamp', message.header.stamp, last)


def check_agent(message: Any, agent: str) -> None:
    """Check that a message is of the agent whose topic it is on."""
    if message.agent != agent:
        raise ValueError(f'agent is {shown(message.agent)}: on this topic it must be {agent!r}')


def read_choice(name: str, value: int, choices: type[E]) -> E:
    """Return the member of an enumeration that a field has."""
    if value not in list(choices):
        raise ValueError(f'{name} is {value}: it must be from {min(choices)} to {max(choices)}')
    return choices(value)


def check_reason(reason: str) -> None:
    """Check the length of a reason."""
    if len(reason) > MAX_REASON:
        raise ValueError(f'reason has {len(reason)} characters: at most {MAX_REASON} are allowed')


# The fields of a message as attributes: arrays are numpy arrays, and lists of messages are lists
# of Fields.
Fields = SimpleNamespace


def filled(message: M, fields: Fields) -> M:
    """Set the fields of a message, and return the message."""
    for name, value in vars(fields).items():
        if isinstance(value, Fields):
            filled(getattr(message, name), value)
        elif isinstance(value, np.ndarray):
            # rclpy checks each value of a list, but not of an array.array.
            setattr(message, name, array(value.dtype.char, value.tobytes()))
        elif not (isinstance(value, list) and value and isinstance(value[0], Fields)):
            setattr(message, name, value)
    return message


# Bytes of a hash, which is a uint64 field.
BYTES = 8


def content_hash(message: Any) -> int:
    """Return a hash of the names and values of a message's fields."""
    encoded: list[bytes] = []
    _encode(message, encoded)
    return int.from_bytes(blake2b(b''.join(encoded), digest_size=BYTES).digest(), 'little')


SIZED, FLOAT = struct.Struct('<cQ').pack, struct.Struct('<cd').pack


def _encode(value: Any, encoded: list[bytes]) -> None:
    """Append unique bytes for a value: a tag, the size if it varies, and the value."""
    # Types are looked up once: most of the nodes' time in Python goes into hashes.
    kind = value.__class__
    if kind is float:
        encoded.append(FLOAT(b'f', value))
    elif kind is int:
        # Nine bytes, for int64 and uint64.
        encoded.append(b'i' + value.to_bytes(9, 'little', signed=True))
    elif kind is bool:
        encoded.append(b'b\1' if value else b'b\0')
    elif kind is str:
        text = value.encode()
        encoded += SIZED(b's', len(text)), text
    elif fields := _encoded_fields(kind):
        encoded.append(SIZED(b'm', len(fields)))
        for name, encoded_name in fields:
            encoded.append(encoded_name)
            _encode(getattr(value, name), encoded)
    elif isinstance(value, float | int):
        # Numbers of numpy, and enumerations.
        _encode(float(value) if isinstance(value, float) else int(value), encoded)
    elif isinstance(value, Iterable):
        elements = list(value)
        encoded.append(SIZED(b'a', len(elements)))
        for element in elements:
            _encode(element, encoded)
    else:
        raise TypeError(f'a field has type {type(value)}, unknown in ROS messages')


@lru_cache
def _encoded_fields(kind: type) -> tuple[tuple[str, bytes], ...]:
    """Return a message's field names, each with its encoding; empty for other objects."""
    if hasattr(kind, 'get_fields_and_field_types'):
        names = tuple(kind.get_fields_and_field_types())
    else:
        names = getattr(kind, '__slots__', ())
    encoded = [(name, name.encode()) for name in names]
    return tuple((name, SIZED(b's', len(text)) + text) for name, text in encoded)


def check_texts(message: Any) -> None:
    """Check that the texts of a message that rclpy has read are UTF-8, as readers of logs need."""
    # rclpy puts this character in place of other bytes.
    for name, _ in _encoded_fields(message.__class__):
        value = getattr(message, name)
        for part in value if isinstance(value, list) else [value]:
            if isinstance(part, str) and '\N{REPLACEMENT CHARACTER}' in part:
                raise ValueError(
                    f'readers of logs cannot decode it: {name} is {shown(part)}: it must be UTF-8'
                )
            check_texts(part)


NO_MISSION = 0


def mission_of_path(message: Any) -> int:
    """Return the start of the mission of a nav_msgs/Path, in nanoseconds."""
    stated = message.poses[0].header.stamp if message.poses else message.header.stamp
    if from_stamp(stated) == from_stamp(message.header.stamp):
        return NO_MISSION
    return read_stamp('poses[0].header.stamp', stated)


def check_mission(stated: int, own: int | None) -> None:
    """Check that a message belongs to a node's mission; `own` is None before the first mission."""
    if own not in (None, stated):
        raise ValueError(
            f'it belongs to {named(stated)}, and not to {named(own)}: if a bag is played, play it '
            'in another ROS domain or namespace'
        )


def named(mission: int) -> str:
    """Return the name of a mission."""
    if mission == NO_MISSION:
        return 'a mission without a start time'
    return f'the mission begun at {in_seconds(mission)}'
