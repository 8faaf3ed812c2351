# SPDX-License-Identifier: Apache-2.0
"""A single MCAP file of a log: writing, and repair of cut or damaged files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
import os
from pathlib import Path

from kbnitp_ros.files import naming, parse_yaml, sync_folder, yaml_text
from kbnitp_ros.log.files import check_in_place, check_is_new, log_parts, LogError, LogLock
from kbnitp_ros.log.read import (
    is_finished_part,
    read_part,
    read_recorded,
    Recorded,
    RecordedMessage,
    RecordedMetadata,
)
from kbnitp_ros.log.schema import BagFile, BagTopic, information, QOS, TYPE_HASH, write_metadata
from mcap.well_known import Profile
from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer

COMPRESSIONS = {'none': CompressionType.NONE, 'zstd': CompressionType.ZSTD}

# Maximum bytes of messages in a chunk; a sync ends a chunk earlier.
CHUNK = 2**20

# Bytes of a message besides its content.
MESSAGE_HEAD = 31

BAG_RECORD = 'rosbag2'
BAG_FIELD = 'serialized_metadata'


# A message type: its name, the language of its definition, and its definition.
Definition = tuple[str, str, bytes]


class FileWriter:
    """A writer of an MCAP file, to be abandoned after an OSError."""

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        # Topics and times written so far.
        self.contents = BagFile(path.name)
        self._file = path.open('xb')
        # Bytes before the first message: types, channels and metadata records.
        self.preamble = 0
        self._written = 0
        self._pending = 0
        self._schemas: dict[Definition, int] = {}
        self._channels: dict[tuple[str, str, int, frozenset[tuple[str, str]]], int] = {}
        self._topics: dict[int, BagTopic] = {}
        try:
            self._writer = Writer(
                self._file,
                # No limit: `flush` ends chunks.
                chunk_size=2**62,
                compression=COMPRESSIONS[compression],
                enable_data_crcs=True,
            )
            with naming(path):
                self._writer.start(Profile.ROS2, f'kbnitp_ros, {LIBRARY_IDENTIFIER}')
            self.sync()
            sync_folder(path.parent)
        except OSError:
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    @property
    def size(self) -> int:
        """Return the size of the file in bytes; messages not yet written count uncompressed."""
        return self._written + self._pending

    def add_channel(
        self,
        topic: str,
        message_encoding: str,
        definition: Definition,
        metadata: Mapping[str, str],
    ) -> int:
        """Return the channel of a topic; equal arguments give the same channel."""
        type_name, _, text = definition
        if definition not in self._schemas:
            self._schemas[definition] = self._writer.register_schema(*definition)
            self._pending += len(text)
        schema = self._schemas[definition]
        key = topic, message_encoding, schema, frozenset(metadata.items())
        if key not in self._channels:
            channel = self._writer.register_channel(
                topic, message_encoding, schema, dict(metadata)
            )
            self._channels[key] = channel
            qos: object = []
            with suppress(ValueError):
                qos = parse_yaml(metadata.get(QOS, '')) or []
            described = {
                'name': topic,
                'type': type_name,
                'serialization_format': message_encoding,
                'offered_qos_profiles': qos,
                'type_description_hash': metadata.get(TYPE_HASH, ''),
            }
            self._topics[channel] = {'topic_metadata': described, 'message_count': 0}
            self.contents.topics.append(self._topics[channel])
        return self._channels[key]

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        with naming(self.path):
            self._writer.add_metadata(name, dict(values))
        self._pending += sum(len(key) + len(value) for key, value in values.items())

    def write(
        self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int
    ) -> None:
        """Write a message of an added channel; times are in nanoseconds."""
        topic, contents = self._topics[channel], self.contents
        if contents.last < contents.first:
            self.preamble = self.size
        if len(data) > CHUNK:
            # A large message gets its own chunk: a shared chunk could be too large to read.
            self.flush()
        self._writer.add_message(channel, log_time, data, publish_time, sequence)
        topic['message_count'] += 1
        if log_time > contents.last:
            contents.last = log_time
        if log_time < contents.first:
            contents.first = log_time
        self._pending += len(data) + MESSAGE_HEAD
        if self._pending > CHUNK:
            self.flush()

    def flush(self) -> None:
        """Pass written messages to the system, where they survive the end of the process."""
        with naming(self.path):
            self._writer.flush()
        self._written = self._file.tell()
        self._pending = 0

    def sync(self) -> None:
        """Put everything written so far onto the disk; raise an OSError if that fails."""
        # Checked first: writing after a cut would fill the gap with zeros.
        self._check_size()
        self.flush()
        # Unlike fsync, this does not sync the times of the file.
        with naming(self.path):
            os.fdatasync(self._file.fileno())
        self.check_in_place()

    def check_in_place(self) -> None:
        """Check that the file was not removed, replaced or cut; raises an OSError."""
        check_in_place(self._file, self.path)
        self._check_size()

    def _check_size(self) -> None:
        size = os.fstat(self._file.fileno()).st_size
        if size < self._written:
            raise OSError(
                f'{self.path} was cut to {size} of the {self._written} bytes written: exclude it '
                'from the rotation of logs'
            )

    def finish(self) -> None:
        """Finish the file, with indexes, and put it onto the disk."""
        self.flush()
        described = yaml_text(information([self.contents]))
        self.add_metadata(BAG_RECORD, {BAG_FIELD: described})
        with naming(self.path):
            self._writer.finish()
        self.sync()
        with naming(self.path):
            self._file.close()

    def abandon(self) -> None:
        """Close the unfinished file, cut to its size at the last flush; raise nothing."""
        if self._file.closed:
            return
        with suppress(OSError):
            os.ftruncate(self._file.fileno(), self._written)
        with suppress(OSError):
            # Closing the buffer would write again.
            self._file.raw.close()


def repair(
    path: str | Path,
    target: Path,
    progress: Callable[[Iterator[Recorded]], Iterable[Recorded]] = iter,
) -> tuple[int, list[str]]:
    """Copy the readable part of a log to a new file; return the number of messages, and errors."""
    check_is_new(target)
    lost = [f'{part} is unfinished' for part in log_parts(path) if not is_finished_part(part)]
    corrupt: list[LogError] = []
    contents = copy(progress(read_recorded(path, corrupt)), target, target.name, 'none')
    try:
        if not contents.messages:
            raise LogError(f'{path} has no message that could be saved')
        write_metadata(target.parent, [contents])
    except (LogError, OSError):
        target.unlink()
        raise
    return contents.messages, lost + [str(each) for each in corrupt]


def finished(part: Path, compression: str, lock: LogLock) -> BagFile:
    """Describe a part of a log; repair it first if it was cut."""
    if is_finished_part(part):
        return described(part)
    new = part.with_name(f'{part.name}.new')
    new.unlink(missing_ok=True)
    contents = copy(read_part(part), new, part.name, compression)
    lock.put_in_place(new, part)
    sync_folder(part.parent)
    return contents


def described(part: Path) -> BagFile:
    """Return the description of a finished file; raise a LogError if it is corrupt."""
    records = {
        each.name: each.values for each in read_part(part) if isinstance(each, RecordedMetadata)
    }
    try:
        bag = parse_yaml(records[BAG_RECORD][BAG_FIELD])
        contents = BagFile(part.name, bag['topics_with_message_count'])
        if contents.messages:
            contents.first = bag['starting_time']['nanoseconds_since_epoch']
            contents.last = contents.first + bag['duration']['nanoseconds']
    except Exception as error:
        raise LogError(
            f'{part} has no readable summary ({error!r}): repair the log by replay --repair'
        ) from error
    return contents


def copy(recorded: Iterable[Recorded], target: Path, name: str, compression: str) -> BagFile:
    """Copy the records of one or several files to a new file, and finish that file."""
    part = FileWriter(target, compression)
    part.contents.name = name
    metadata: dict[str, dict[str, str]] = {}
    try:
        for record in recorded:
            if isinstance(record, RecordedMessage):
                schema = record.schema
                channel = part.add_channel(
                    record.channel.topic,
                    record.channel.message_encoding,
                    (schema.name, schema.encoding, schema.data),
                    record.channel.metadata,
                )
                part.write(
                    channel, record.data, record.log_time, record.publish_time, record.sequence
                )
            elif record.name != BAG_RECORD and metadata.get(record.name) != record.values:
                # Every part repeats all metadata.
                metadata[record.name] = record.values
                part.add_metadata(record.name, record.values)
        part.finish()
    except BaseException:
        part.abandon()
        target.unlink(missing_ok=True)
        raise
    return part.contents
