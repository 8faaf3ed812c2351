# SPDX-License-Identifier: Apache-2.0
"""What the files of a log hold, whatever their kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from kbnitp_ros.log.bag.errors import LogError
from mcap.records import Channel, Schema

# What a channel says of its topic.
QOS = 'offered_qos_profiles'
TYPE_HASH = 'topic_type_hash'


class RecordedMessage(NamedTuple):
    """
    A message with what the file says of it.

    Attributes
    ----------
    position : int
        How far into the file it was found, in bytes.

    """

    channel: Channel
    schema: Schema
    sequence: int
    log_time: int
    publish_time: int
    data: bytes
    position: int


class RecordedMetadata(NamedTuple):
    """A record of named values."""

    name: str
    values: dict[str, str]
    position: int


Recorded = RecordedMessage | RecordedMetadata

# Takes an error where a file is damaged; returns if what comes after it is to be read.
OnDamage = Callable[[LogError], None]


def refuse(error: LogError) -> None:
    """Read nothing of a file after its first error."""
    raise error


def damaged(path: Path, position: int, error: Exception) -> LogError:
    """Return the error for a damaged file."""
    return LogError(
        f'{path} is damaged near byte {position}: {error!r}; '
        'replay --repair saves what is not damaged'
    )
