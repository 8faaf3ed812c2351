# SPDX-License-Identifier: Apache-2.0
"""Make finished files of those that are unfinished or corrupt."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from kbnitp_ros.bag import mcap_file
from kbnitp_ros.bag.errors import LogError
from kbnitp_ros.bag.file_writer import BAG_FIELD, BAG_RECORD, Definition, FileWriter
from kbnitp_ros.bag.lock import LogLock
from kbnitp_ros.bag.log_files import check_is_new, parts_of
from kbnitp_ros.bag.metadata import BagFile, file_of, sync_folder, write_metadata
from kbnitp_ros.bag.reader import is_finished_part, read_recorded, tell_skipped
from kbnitp_ros.bag.records import (
    Recorded,
    RecordedMessage,
    RecordedMetadata,
    SkippedMessage,
)
from kbnitp_ros.files import parse_yaml


@dataclass(frozen=True)
class Repaired:
    """What was saved of a log."""

    messages: int
    # Which files end too early, and where they are corrupt.
    lost: list[str]


def repair(
    path: str | Path,
    target: Path,
    progress: Callable[[Iterator[Recorded]], Iterable[Recorded]] = iter,
) -> Repaired:
    """
    Write all that is intact of a log to one finished file.

    Parameters
    ----------
    path : str or Path
        The log, as `reader.read_log` takes it.
    target : Path
        The file to make; there is none after an error.
    progress : callable
        Passes on what is read; may show how far the reading has come.

    Raises
    ------
    LogError
        If a file cannot be read, or none has a message.
    OSError
        If the target exists, would be taken for a part of a log, or cannot be written.

    """
    check_is_new(target)
    lost = [f'{part} is unfinished' for part in parts_of(path) if not is_finished_part(part)]
    recorded = read_recorded(path, lambda error: lost.append(str(error)))
    contents = copy(progress(recorded), target, target.name, 'none', lost.append)
    if not contents.messages:
        target.unlink()
        raise LogError(f'{path} has no message that could be saved')
    try:
        write_metadata(target.parent, [contents])
    except OSError:
        target.unlink()
        raise
    return Repaired(contents.messages, lost)


def finished(part: Path, compression: str, lock: LogLock) -> BagFile:
    """
    Return what is in a part of a log, finishing it if it is not.

    All that is whole is written to another file, which then takes its place.

    Raises
    ------
    LogError
        If it is corrupt, or finished and no bag.
    OSError
        If it cannot be read or written.

    """
    if mcap_file.is_finished(part):
        return described(part)
    new = part.with_name(f'{part.name}.new')
    new.unlink(missing_ok=True)
    contents = copy(mcap_file.read_mcap(part), new, part.name, compression, tell_skipped)
    lock.put_in_place(new, part)
    sync_folder(part.parent)
    return contents


def described(part: Path) -> BagFile:
    """
    Return what a finished file says is in it.

    Raises
    ------
    LogError
        If it is corrupt anywhere, or does not say so.
    OSError
        If it cannot be read.

    """
    records = {
        each.name: each.values
        for each in mcap_file.read_mcap(part)
        if isinstance(each, RecordedMetadata)
    }
    try:
        contents = file_of(parse_yaml(records[BAG_RECORD][BAG_FIELD]))
    except Exception as error:
        raise LogError(
            f'{part} does not say what is in it ({error!r}): replay --repair makes a log that does'
        ) from error
    contents.name = part.name
    return contents


def copy(
    recorded: Iterable[Recorded],
    target: Path,
    name: str,
    compression: str,
    tell_lost: Callable[[str], object],
) -> BagFile:
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
            elif isinstance(each, SkippedMessage):
                tell_lost(str(each))
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
