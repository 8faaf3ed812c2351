# SPDX-License-Identifier: Apache-2.0
"""Read a mission log, or an MCAP bag of rosbag2 with the same topics."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, count
import json
import os
from pathlib import Path
import struct
from typing import Any, BinaryIO, NamedTuple

from kbnitp_ros.files import in_words
from kbnitp_ros.log.files import log_parts, LogError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import MCAP0_MAGIC
from mcap_ros2._cdr import CdrReader
from mcap_ros2._dynamic import ARRAY_PARSERS
from mcap_ros2.decoder import DecoderFactory

# Maximum bytes of a record.
MAX_RECORD = 2**30

# First bytes of files that are not MCAP, and their remedies.
SQLITE_MAGIC = b'SQLite format 3\0'
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
REMEDIES = {
    SQLITE_MAGIC: 'is a SQLite bag: convert it to MCAP with ros2 bag convert, or with '
    'rosbags-convert --dst-storage mcap',
    ZSTD_MAGIC: 'is compressed: decompress it with zstd -d',
}

# Kind and length of a record.
HEAD = struct.Struct('<BQ')

# Bytes of a chunk before the name of its compression.
CHUNK_HEAD = 28

KINDS = {value for name, value in vars(Opcode).items() if name.isupper()}

NO_SCHEMA = Schema(id=0, name='', encoding='', data=b'')


# Names of metadata records; a node's full name follows PARAMETERS, as in 'parameters/planner'.
RUN = 'run'
PARAMETERS = 'parameters'


class RecordedMessage(NamedTuple):
    """A message with its channel and schema."""

    channel: Channel
    schema: Schema
    sequence: int
    log_time: int
    publish_time: int
    data: bytes
    # End of its record in the file, bytes.
    position: int


class RecordedMetadata(NamedTuple):
    """A metadata record."""

    name: str
    values: dict[str, str]
    position: int


Recorded = RecordedMessage | RecordedMetadata


@dataclass(frozen=True)
class LoggedMessage:
    """A decoded message; times in nanoseconds."""

    # Full name.
    topic: str
    # Index of the message in its topic.
    index: int
    # Such as 'nav_msgs/msg/Path'.
    type_name: str
    # Times of receiving and sending.
    log_time: int
    publish_time: int
    # End of its record in the log, bytes from the start of the first part.
    position: int
    # The CDR bytes.
    data: bytes
    # The decoded message: an object with the fields that the file defines for the type.
    message: Any
    # Content of the message, converted by the role of the topic.
    said: Any = None


class Bookmark:
    """The place up to which a log was read, from which reading goes on once the log has grown."""

    def __init__(self) -> None:
        self.parts = defaultdict[Path, Part](Part)
        self.indices = defaultdict[str, Iterator[int]](count)
        self.decoders: Decoders = {}
        # The metadata records of all parts, in order.
        self.records: list[RecordedMetadata] = []

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata read: records merge within a file, and replace earlier files'."""
        return {name: each for part in self.parts.values() for name, each in part.metadata.items()}


class Part:
    """The place up to which a file of a log was read, and the records that later ones refer to."""

    def __init__(self) -> None:
        # End of the last record read, bytes.
        self.end = 0
        self.schemas = {0: NO_SCHEMA}
        self.channels: dict[int, Channel] = {}
        self.messages = 0
        self.metadata: dict[str, dict[str, str]] = {}


def read_log(
    path: str | Path,
    types: Collection[str] | None = None,
    corrupt: list[LogError] | None = None,
    topics: Collection[str] | None = None,
    bookmark: Bookmark | None = None,
) -> Iterator[LoggedMessage]:
    """
    Yield the messages of these types and topics in recorded order, after a bookmark if given.

    Of a part that was cut, the messages before the cut are read; of a corrupt part, the messages
    before its first error. This error is raised as a LogError, or appended to `corrupt` if given.
    """
    bookmark = bookmark or Bookmark()
    for item in read_recorded(path, corrupt, bookmark):
        if isinstance(item, RecordedMetadata):
            bookmark.records.append(item)
            continue
        topic, type_name = item.channel.topic, item.schema.name
        if (types is None or type_name in types) and (topics is None or topic in topics):
            yield LoggedMessage(
                topic,
                next(bookmark.indices[topic]),
                type_name,
                item.log_time,
                item.publish_time,
                item.position,
                item.data,
                decoded(path, item, bookmark.decoders),
            )


def read_metadata(
    path: str | Path, corrupt: list[LogError] | None = None
) -> dict[str, dict[str, str]]:
    """Return metadata by name: records merge within a file, and replace those of earlier files."""
    bookmark = Bookmark()
    for _ in read_recorded(path, corrupt, bookmark):
        pass
    return bookmark.metadata


def parameter_changes(
    records: Iterable[RecordedMetadata], is_meant: Callable[[str], bool]
) -> Iterator[str]:
    """Describe changes of parameters, with old and new value, of nodes that pass `is_meant`."""
    known: dict[str, dict[str, str]] = {}
    for item in records:
        node = item.name.removeprefix(PARAMETERS)
        if item.name.startswith(f'{PARAMETERS}/') and is_meant(node):
            before = known.setdefault(node, {})
            for name, value in item.values.items():
                if before.get(name, value) != value:
                    yield f'parameter {name} of {node} changed from {before[name]} to {value}'
            before |= item.values


def read_parameters(
    path: str | Path, corrupt: list[LogError] | None = None
) -> dict[str, dict[str, Any]]:
    """Return the last recorded parameters of each node."""
    return parse_parameters(path, read_metadata(path, corrupt))


def parse_parameters(
    path: str | Path, metadata: Mapping[str, Mapping[str, str]]
) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node in the metadata of a log."""
    parameters = {}
    for name, record in metadata.items():
        if name.startswith(f'{PARAMETERS}/'):
            try:
                values = {key: json.loads(text) for key, text in record.items()}
            except ValueError as error:
                raise LogError(f'{path}: record {name!r} is corrupt: {error}') from error
            parameters[name.removeprefix(PARAMETERS)] = values
    return parameters


def is_finished(path: str | Path) -> bool:
    """Return whether the last file of a log was finished by its writer."""
    part = log_parts(path)[-1]
    with readable(part), part.open('rb') as file:
        return ends_finished(file, check_start(file, part))


def ends_finished(file: BinaryIO, size: int) -> bool:
    """Return whether an open file of this size was finished by its writer."""
    file.seek(max(len(MCAP0_MAGIC), size - len(MCAP0_MAGIC)))
    return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC


def log_size(path: str | Path) -> int:
    """Return the size of all parts of a log, in bytes."""
    return sum(map(file_size, log_parts(path)))


def file_size(part: Path) -> int:
    """Return the size of a file, in bytes."""
    with readable(part):
        return part.stat().st_size


def read_recorded(
    path: str | Path, corrupt: list[LogError] | None = None, bookmark: Bookmark | None = None
) -> Iterator[Recorded]:
    """Return the undecoded messages and the metadata of all parts, with positions in the log."""
    bookmark = bookmark or Bookmark()
    parts = log_parts(path)
    starts = accumulate(map(file_size, parts), initial=0)
    return (
        item._replace(position=start + item.position)
        for part, start in zip(parts, starts)
        for item in read_part(part, corrupt, bookmark.parts[part])
    )


def read_part(
    part: Path, corrupt: list[LogError] | None = None, read: Part | None = None
) -> Iterator[Recorded]:
    """Yield the messages and metadata of a file; handle cuts and errors as `read_log` does."""
    read = read or Part()
    with readable(part), part.open('rb') as file:
        size = check_start(file, part)
        try:
            for record, position in read_records(file, size, read.end):
                read.end = position
                if isinstance(record, Message):
                    read.messages += 1
                    channel = read.channels[record.channel_id]
                    yield RecordedMessage(
                        channel,
                        read.schemas[channel.schema_id],
                        record.sequence,
                        record.log_time,
                        record.publish_time,
                        record.data,
                        position,
                    )
                elif isinstance(record, Metadata):
                    known = read.metadata.get(record.name, {})
                    read.metadata[record.name] = {**known, **record.metadata}
                    yield RecordedMetadata(record.name, record.metadata, position)
                elif isinstance(record, Schema):
                    read.schemas[record.id] = record
                elif isinstance(record, Channel):
                    read.channels[record.id] = record
                elif isinstance(record, Statistics) and record.message_count != read.messages:
                    raise ValueError(
                        f'it has {read.messages} messages, but its statistics state '
                        f'{record.message_count}'
                    )
        except Exception as error:
            # The parser raises many types of errors.
            found = LogError(
                f'{part} is corrupt after byte {read.end} ({in_words(error)}): mcap recover saves '
                'what is intact'
            )
            if corrupt is None:
                raise found from error
            corrupt.append(found)


def read_records(file: BinaryIO, size: int, start: int = 0) -> Iterator[tuple[McapRecord, int]]:
    """
    Yield the records in the first `size` bytes of a file, with the end of each in bytes.

    From a `start` on, the check sum of the whole file is not compared.
    """
    ends = list(record_ends(file, size, start))
    file.seek(start)
    records = StreamReader(
        file,
        skip_magic=start > 0,
        emit_chunks=True,
        validate_crcs=True,
        record_size_limit=MAX_RECORD,
    ).records
    for end in ends:
        record = next(records)
        if file.tell() != end:
            raise ValueError(f'a record ends at byte {file.tell()}, not at {end}')
        if isinstance(record, Chunk):
            yield from ((each, end) for each in breakup_chunk(record, validate_crc=True))
        else:
            yield record, end
    check_cut(file, ends[-1] if ends else start or len(MCAP0_MAGIC), size)


def record_ends(file: BinaryIO, size: int, start: int = 0) -> Iterator[int]:
    """Yield the end of each whole record of a file from a start on, in bytes."""
    end = start or len(MCAP0_MAGIC)
    while end + HEAD.size <= size:
        file.seek(end)
        kind, length = HEAD.unpack(file.read(HEAD.size))
        end += HEAD.size + length
        if kind not in KINDS or end > size:
            return
        yield end


def check_cut(file: BinaryIO, end: int, size: int) -> None:
    """Check that only zeros, a cut record or the closing magic follow after byte `end`."""
    ends_well = ends_finished(file, size)
    if ends_well and size <= end + len(MCAP0_MAGIC):
        return
    file.seek(end)
    rest = ReadDataStream(file)
    with suppress(EndOfFile, struct.error):
        kind, length = rest.read1(), rest.read8()
        if kind == 0:
            # Zeros are space that the file system reserved.
            while block := file.read(2**20):
                if block.strip(b'\0'):
                    raise ValueError('a record has kind 0, which is invalid')
            return
        if kind not in KINDS or ends_well:
            raise ValueError(f'a record of kind {kind}, {length} bytes, is invalid or cut')
        if kind == Opcode.CHUNK:
            rest.read(CHUNK_HEAD)
            rest.read_prefixed_string()
            left = rest.read8()
        elif kind == Opcode.MESSAGE_INDEX:
            rest.read2()
            left = rest.read4()
        else:
            return
        if rest.count + left != HEAD.size + length:
            raise ValueError(f'the content of a record of {length} bytes has a different length')


def check_start(file: BinaryIO, part: Path) -> int:
    """Return the size of an open file; raise a LogError if it is no MCAP file."""
    start = file.read(len(SQLITE_MAGIC))
    for magic, remedy in REMEDIES.items():
        if start.startswith(magic):
            raise LogError(f'{part} {remedy}')
    # A killed writer may have left only some of the first bytes.
    if not MCAP0_MAGIC.startswith(start[: len(MCAP0_MAGIC)]):
        raise LogError(f'{part} is no MCAP file')
    return os.fstat(file.fileno()).st_size


@contextmanager
def readable(part: Path) -> Iterator[None]:
    """Raise a LogError if a file cannot be read."""
    try:
        yield
    except OSError as error:
        raise LogError(f'{part} cannot be read: {error.strerror}') from error


def read_values(code: str, size: int, reader: CdrReader, length: int) -> list[Any]:
    """Return an array as `CdrReader` returns it, in one step for all values of so many bytes."""
    if not length:
        return []
    start = reader.offset + (4 - reader.offset) % size
    order = '<' if reader.little_endian else '>'
    values = struct.unpack_from(f'{order}{length}{code}', reader.data, start)
    reader.offset = start + size * length
    return list(values)


# Value by value, a belief and its grids take as long to decode as all else that a report does.
ARRAY_PARSERS |= {'float64': partial(read_values, 'd', 8), 'int8': partial(read_values, 'b', 1)}

# Decoders by encoding of the message, and by encoding, name and text of the type's definition.
Decoders = dict[tuple[str, str, str, bytes], Callable[[bytes], Any] | None]


def decoded(path: str | Path, recorded: RecordedMessage, decoders: Decoders) -> Any:
    """Decode a message of a log by the definition of its type in the file."""
    channel, schema = recorded.channel, recorded.schema
    encoding = channel.message_encoding
    key = encoding, schema.encoding, schema.name, schema.data
    try:
        if key not in decoders:
            decoders[key] = DecoderFactory().decoder_for(encoding, schema)
        if decoder := decoders[key]:
            return decoder(recorded.data)
    except Exception as error:
        raise LogError(
            f'{path}: a message of topic {channel.topic} is not a {schema.name}: {in_words(error)}'
        ) from error
    raise LogError(
        f'{path}: topic {channel.topic} has messages in {encoding!r}, and their type is defined '
        f"in {schema.encoding!r}: these must be 'cdr' and 'ros2msg'"
    )
