# SPDX-License-Identifier: Apache-2.0
"""Make finished files of unfinished or corrupt ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from kbnitp_ros.bag.errors import LogError
from kbnitp_ros.bag.file_writer import BAG_FIELD, BAG_RECORD, Definition, FileWriter
from kbnitp_ros.bag.lock import LogLock
from kbnitp_ros.bag.log_files import check_is_new, parts_of
from kbnitp_ros.bag.metadata import BagFile, file_of, sync_folder, write_metadata
from kbnitp_ros.bag.reader import (
    is_finished_part,
    read_part,
    read_recorded,
    Recorded,
    RecordedMessage,
    RecordedMetadata,
)
import yaml


@dataclass(frozen=True)
class Repaired:
    """What was saved of a log."""

    messages: int
    # Unfinished files, and where files are corrupt.
    lost: list[str]


def repair(
    path: str | Path,
    target: Path,
    progress: Callable[[Iterator[Recorded]], Iterable[Recorded]] = iter,
) -> Repaired:
    """Write what can be read of a log to one new finished file; there is none after an error."""
    check_is_new(target)
    lost = [f'{part} is unfinished' for part in parts_of(path) if not is_finished_part(part)]
    corrupt: list[LogError] = []
    contents = copy(progress(read_recorded(path, corrupt)), target, target.name, 'none')
    try:
        if not contents.messages:
            raise LogError(f'{path} has no message that could be saved')
        write_metadata(target.parent, [contents])
    except (LogError, OSError):
        target.unlink()
        raise
    return Repaired(contents.messages, lost + [str(each) for each in corrupt])


def finished(part: Path, compression: str, lock: LogLock) -> BagFile:
    """Describe a part of a log; if it was cut, replace it by a finished file before."""
    if is_finished_part(part):
        return described(part)
    new = part.with_name(f'{part.name}.new')
    new.unlink(missing_ok=True)
    contents = copy(read_part(part), new, part.name, compression)
    lock.put_in_place(new, part)
    sync_folder(part.parent)
    return contents


def described(part: Path) -> BagFile:
    """Return what a finished file says is in it; raise a LogError if it is corrupt anywhere."""
    records = {
        each.name: each.values for each in read_part(part) if isinstance(each, RecordedMetadata)
    }
    try:
        contents = file_of(yaml.safe_load(records[BAG_RECORD][BAG_FIELD]))
    except Exception as error:
        raise LogError(
            f'{part} does not say what is in it ({error!r}): replay --repair makes a log that does'
        ) from error
    contents.name = part.name
    return contents


def copy(recorded: Iterable[Recorded], target: Path, name: str, compression: str) -> BagFile:
    """Write what was read from one file or several to a new finished one."""
    part = FileWriter(target, compression)
    part.contents.name = name
    metadata: dict[str, dict[str, str]] = {}
    try:
        for each in recorded:
            if isinstance(each, RecordedMessage):
                schema = each.schema
                channel = part.add_channel(
                    each.channel.topic,
                    each.channel.message_encoding,
                    Definition(schema.name, schema.encoding, schema.data),
                    each.channel.metadata,
                )
                part.write(channel, each.data, each.log_time, each.publish_time, each.sequence)
            elif each.name != BAG_RECORD and metadata.get(each.name) != each.values:
                # Each part has all of them.
                metadata[each.name] = each.values
                part.add_metadata(each.name, each.values)
        part.finish()
    except BaseException:
        part.abandon()
        target.unlink(missing_ok=True)
        raise
    return part.contents
