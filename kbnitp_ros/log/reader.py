# SPDX-License-Identifier: Apache-2.0
"""
Read the mission log.

The file is read from front to back, without its index: that works alike for one that is finished,
still being written, left behind by a killed process or cut short.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import os
from pathlib import Path
import struct
from typing import Any, IO

from mcap.exceptions import EndOfFile, McapError, RecordLengthLimitExceeded
from mcap.records import Channel, Message, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from mcap_ros2.decoder import DecoderFactory

# What the stream reader raises when a record is not all there.
CUT_SHORT = (EndOfFile, RecordLengthLimitExceeded, struct.error)


NO_SCHEMA = Schema(id=0, name='', encoding='', data=b'')


class LogError(ValueError):
    """A file that is no mission log, or a damaged one."""


@dataclass(frozen=True)
class LoggedMessage:
    """
    A message as it was recorded.

    Attributes
    ----------
    topic : str
        Full name.
    type_name : str
        Such as 'nav_msgs/msg/Path'.
    log_time, publish_time : int
        When it was received and when it was sent, in nanoseconds.
    position : int
        How far into the file it was found, in bytes.
    data : bytes
        As it came off the wire.
    message : object
        Has the fields of its type, as defined in the file itself.

    """

    topic: str
    type_name: str
    log_time: int
    publish_time: int
    position: int
    data: bytes
    message: Any


def read_log(path: str | Path, types: Collection[str] | None = None) -> Iterator[LoggedMessage]:
    """
    Yield the messages of a log in the order they were written.

    A file that ends early yields all that is whole; `is_finished` tells it from a finished one.

    Parameters
    ----------
    path : str or Path
        An MCAP file.
    types : collection of str, optional
        The message types to yield; without it all.

    Raises
    ------
    LogError
        If the file cannot be read or is no MCAP file; also, after all that comes before, where it
        is damaged or holds a message that cannot be decoded. There is no other error.

    """
    with opened(path) as file:
        try:
            yield from decoded(file, types)
        except LogError as error:
            raise LogError(f'{path}: {error}') from error
        except OSError:
            raise
        except Exception as error:
            # A damaged record may fail in any of the libraries it comes through.
            if isinstance(error, CUT_SHORT) and not is_finished(path):
                return
            raise LogError(f'{path} is damaged near byte {file.tell()}: {error!r}') from error


def is_finished(path: str | Path) -> bool:
    """
    Return whether the log ends as its writer ends it; not if that was killed or the end is cut.

    Raises
    ------
    LogError
        If the file cannot be read or is no MCAP file.

    """
    with opened(path) as file:
        last = file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        return last > 0 and file.read() == MCAP0_MAGIC


@contextmanager
def opened(path: str | Path) -> Iterator[IO[bytes]]:
    """
    Open a log that starts like an MCAP file.

    Raises
    ------
    LogError
        If it cannot be read or starts otherwise.

    """
    try:
        with Path(path).open('rb') as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise LogError(f'{path} is no MCAP file: it does not start like one')
            file.seek(0)
            yield file
    except OSError as error:
        raise LogError(f'{path} cannot be read: {error.strerror}') from error


def decoded(file: IO[bytes], types: Collection[str] | None) -> Iterator[LoggedMessage]:
    """Yield the messages of an MCAP stream; fails in many ways where it is damaged."""
    size = os.fstat(file.fileno()).st_size
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders = DecoderFactory()
    count = 0
    for record in StreamReader(file, validate_crcs=True, record_size_limit=size).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Statistics) and record.message_count != count:
            raise McapError(f'{count} messages found, {record.message_count} were written')
        elif isinstance(record, Message):
            count += 1
            channel = channels[record.channel_id]
            schema = schemas.get(channel.schema_id, NO_SCHEMA)
            if types is None or schema.name in types:
                yield LoggedMessage(
                    channel.topic,
                    schema.name,
                    record.log_time,
                    record.publish_time,
                    file.tell(),
                    record.data,
                    decode(decoders, channel, schema, record.data),
                )


def decode(decoders: DecoderFactory, channel: Channel, schema: Schema, data: bytes) -> Any:
    """
    Return a message's fields.

    Raises
    ------
    LogError
        If the message is not in CDR, its type is not defined in ROS's own language, or the bytes
        do not fit the type.

    """
    decoder = decoders.decoder_for(channel.message_encoding, schema)
    if decoder is None:
        raise LogError(
            f'topic {channel.topic} is {channel.message_encoding!r} of a type defined in '
            f"{schema.encoding!r}: it must be 'cdr' and 'ros2msg'"
        )
    try:
        return decoder(data)
    except Exception as error:
        raise LogError(
            f'a message of topic {channel.topic} is no {schema.name}: {error!r}'
        ) from error
