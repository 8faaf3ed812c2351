# SPDX-License-Identifier: Apache-2.0
"""Read the mission log, or a bag of rosbag2 with the same topics."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
import logging
from pathlib import Path
import re
from typing import Any

from kbnitp_ros.bag import mcap_file, sqlite_file
from kbnitp_ros.bag.errors import LogError
from kbnitp_ros.bag.log_files import parts_of
from kbnitp_ros.bag.records import (
    OnCorruption,
    Recorded,
    RecordedMessage,
    RecordedMetadata,
    refuse,
    SkippedMessage,
)
from kbnitp_ros.files import open_file
from mcap_ros2.decoder import DecoderFactory

__all__ = [
    'LogError',
    'LoggedMessage',
    'is_finished',
    'log_size',
    'metadata_of_part',
    'read_log',
    'read_metadata',
]


# Bytes of a type and all that it refers to. The type of a whole planning scene has 30,000.
LONGEST_DEFINITION = 2**16


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
        How far into the log it was found, in bytes, earlier parts counted.
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
    Yield the messages of a log in the order they were written, part after part.

    A message that is larger than any that is read is skipped, and a logger says so once. A file
    that ends early yields all that is whole; `is_finished` tells it from a finished one.

    Parameters
    ----------
    path : str or Path
        The log's first file or its folder, as `parts.parts_of` takes them. Parts are MCAP files
        or SQLite databases of rosbag2.
    types : collection of str, optional
        The message types to yield; without it all.

    Raises
    ------
    LogError
        If a file cannot be read or is no log; also, after all that comes before, where it is
        corrupt or holds a message that cannot be decoded. There is no other error.

    """
    decode = Decoders(path)
    for item in read_recorded(path):
        if isinstance(item, SkippedMessage):
            tell_skipped(str(item))
        if isinstance(item, RecordedMessage) and (types is None or item.schema.name in types):
            yield LoggedMessage(
                item.channel.topic,
                item.schema.name,
                item.log_time,
                item.publish_time,
                item.position,
                item.data,
                decode(item),
            )


@cache
def tell_skipped(words: str) -> None:
    """Say once, however often a log is read, that a message of it is skipped."""
    logging.getLogger(__name__).warning(words)


def read_metadata(path: str | Path) -> dict[str, dict[str, str]]:
    """
    Return the records of named values that a log has, by their names.

    Of several of one name in a file each changes what those before it say. Of several files the
    last one that has it counts: each has all that it needs.

    Raises
    ------
    LogError
        As for `read_log`.

    """
    records: dict[str, dict[str, str]] = {}
    for part in parts_of(path):
        own: dict[str, dict[str, str]] = {}
        for item in metadata_of_part(part):
            own[item.name] = {**own.get(item.name, {}), **item.values}
        records |= own
    return records


def metadata_of_part(part: Path) -> Iterator[RecordedMetadata]:
    """Yield the records of named values that a file has, as they were written."""
    return (item for item in read_part(part) if isinstance(item, RecordedMetadata))


def is_finished(path: str | Path) -> bool:
    """
    Return whether each part of a log ends as its writer ends it.

    None does if that was killed, or if its end is cut off.

    Raises
    ------
    LogError
        If a file cannot be read or is no log.

    """
    return all(map(is_finished_part, parts_of(path)))


def is_finished_part(part: Path) -> bool:
    """Return `is_finished` for a file alone."""
    with readable(part):
        if is_sqlite(part):
            return sqlite_file.is_finished(part)
        return mcap_file.is_finished(part)


def log_size(path: str | Path) -> int:
    """Return how many bytes a log has, all parts together; errors are as for `read_log`."""
    return sum(map(size_of, parts_of(path)))


def size_of(part: Path) -> int:
    """Return how many bytes a file has; raises LogError if it cannot be read."""
    with readable(part):
        return part.stat().st_size


def read_recorded(path: str | Path, on_corruption: OnCorruption = refuse) -> Iterator[Recorded]:
    """
    Return what is in all parts of a log, not decoded, with positions in the whole.

    The parts are those there are now, whatever is written beside them while they are read.
    Parameters and errors are as for `read_part`, the path as for `read_log`.
    """
    return read_parts(parts_of(path), on_corruption)


def read_parts(parts: Sequence[Path], on_corruption: OnCorruption) -> Iterator[Recorded]:
    """Yield what is in some files, as `read_recorded`."""
    before = 0
    for part in parts:
        for item in read_part(part, on_corruption):
            yield item._replace(position=before + item.position)
        before += size_of(part)


def read_part(part: Path, on_corruption: OnCorruption = refuse) -> Iterator[Recorded]:
    """
    Yield what is in a file of a log.

    `on_corruption` takes a LogError wherever the file is corrupt; what can be read after it is
    yielded too.

    Raises
    ------
    LogError
        If it cannot be read or is no log, and what `on_corruption` raises.

    """
    with readable(part):
        if is_sqlite(part):
            yield from sqlite_file.read_sqlite(part, on_corruption)
        else:
            yield from mcap_file.read_mcap(part, on_corruption)


def is_sqlite(part: Path) -> bool:
    """Return whether a file starts like a SQLite database."""
    with open_file(part) as file:
        return file.read(len(sqlite_file.MAGIC)) == sqlite_file.MAGIC


@contextmanager
def readable(part: Path) -> Iterator[None]:
    """Raise a LogError where a file cannot be read."""
    try:
        yield
    except OSError as error:
        raise LogError(f'{part} cannot be read: {error.strerror}') from error


class Decoders:
    """What makes messages of bytes, for each type as the file defines it."""

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._decoders: dict[tuple[str, str, str, bytes], Callable[[bytes], Any] | None] = {}

    def __call__(self, recorded: RecordedMessage) -> Any:
        """
        Return a message's fields.

        Raises
        ------
        LogError
            If the message is not in CDR, its type is not defined in ROS's own language, or the
            bytes do not fit the type.

        """
        channel, schema = recorded.channel, recorded.schema
        encoding = channel.message_encoding
        key = encoding, schema.encoding, schema.name, schema.data
        try:
            if key not in self._decoders:
                check_definition(schema.data)
                self._decoders[key] = DecoderFactory().decoder_for(encoding, schema)
            decoder = self._decoders[key]
            if decoder is not None:
                return decoder(recorded.data)
        except Exception as error:
            raise LogError(
                f'{self._path}: a message of topic {channel.topic} is no {schema.name}: {error!r}'
            ) from error
        raise LogError(
            f'{self._path}: topic {channel.topic} is {encoding!r} of a type defined in '
            f"{schema.encoding!r}: it must be 'cdr' and 'ros2msg'"
        )


def check_definition(definition: bytes) -> None:
    """
    Check that a type is of a usual size.

    Raises
    ------
    ValueError
        If it is defined at too great length, or has an array of no elements: any number of
        messages that take no bytes fit into a message.

    """
    if len(definition) > LONGEST_DEFINITION:
        raise ValueError(f'it is defined in {len(definition)} bytes')
    # Comments may speak of an array's first element.
    if re.search(rb'^[^#\n]*\[0+\]', definition, re.MULTILINE):
        raise ValueError('it has an array of no elements')
