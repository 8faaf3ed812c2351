# SPDX-License-Identifier: Apache-2.0
"""What the files of a log hold, whatever their kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from kbnitp_ros.bag.errors import LogError
from mcap.records import Channel, Schema

# Bytes of a record and of what is in a chunk: readers refuse larger ones before they read them. A
# belief over 1000x1000 cells has 56 million.
LARGEST_RECORD = 2**26

# Bytes of a message that is written: a chunk with nothing else in it can be read, whatever the
# heads and the compression add.
LARGEST_MESSAGE = LARGEST_RECORD - 2**20

# What a channel says of its topic.
QOS = 'offered_qos_profiles'
TYPE_HASH = 'topic_type_hash'


class RecordedMessage(NamedTuple):
    """A message with what the file says of it."""

    channel: Channel
    schema: Schema
    sequence: int
    log_time: int
    publish_time: int
    data: bytes
    # How far into the file it was found, in bytes.
    position: int


class RecordedMetadata(NamedTuple):
    """A record of named values."""

    name: str
    values: dict[str, str]
    position: int


class SkippedMessage(NamedTuple):
    """A message that is larger than any that is read."""

    path: Path
    topic: str
    # Bytes of its record.
    size: int
    position: int

    def __str__(self) -> str:
        """Return that it was skipped, and why."""
        return (
            f'{self.path}: a message of topic {self.topic} near byte {self.position} has '
            f'{self.size} bytes and is skipped: at most {LARGEST_RECORD} are read'
        )


Recorded = RecordedMessage | RecordedMetadata | SkippedMessage

# Takes an error where a file is corrupt; returns if what comes after it is to be read.
OnCorruption = Callable[[LogError], None]


def refuse(error: LogError) -> None:
    """Read nothing of a file after its first error."""
    raise error


def corrupt(path: Path, position: int, error: Exception) -> LogError:
    """Return the error for a corrupt file."""
    return LogError(
        f'{path} is corrupt near byte {position}: {error!r}; replay --repair saves what is intact'
    )
