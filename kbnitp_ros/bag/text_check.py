# SPDX-License-Identifier: Apache-2.0
"""Whether the texts of a message can be read again, before it is written to a log."""

from __future__ import annotations

from functools import cache
import re
import struct
from typing import Any

from kbnitp_ros.bag.schema import describe, ENCODING, SEPARATOR
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

# A field of many numbers, which take long to read, or a line without a field.
MANY = re.compile(r'(?:float64|int8)\[\] |\s*(?:#|$)')


def check_texts(type_name: str, data: bytes) -> None:
    """Check that the texts of a message are UTF-8 to their ends."""
    try:
        decoder(type_name)(data)
    except UnicodeDecodeError as error:
        raise ValueError(f'it has a text that is not UTF-8: {error.reason}') from error
    except struct.error as error:
        raise ValueError(f'it is not of the type {type_name}: {error}') from error


@cache
def decoder(type_name: str) -> Any:
    """Return what reads a message of a type but for fields of many numbers at its end."""
    own, separator, others = describe(type_name).definition.partition(SEPARATOR)
    read = own.splitlines()
    while read and MANY.match(read[-1]):
        read.pop()
    definition = '\n'.join([*read, separator + others])
    schema = Schema(id=1, name=type_name, encoding=ENCODING, data=definition.encode())
    return DecoderFactory().decoder_for('cdr', schema)
