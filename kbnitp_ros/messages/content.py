# SPDX-License-Identifier: Apache-2.0
"""
A hash of what a message says, by which nodes and logs name one message among several of a stamp.

It is computed from the decoded fields: a serialised message contains padding, which may have any
value. rclpy and the reader of a log decode the same values, and so compute the same hash.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from hashlib import blake2b
import struct
from typing import Any

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
