# SPDX-License-Identifier: Apache-2.0
"""
Read an MCAP file from front to back, without its index.

That works alike for a file that is finished, still being written, left behind by a killed process
or cut short: of the last the messages that are whole are read, also those in a chunk that is cut,
unless it is compressed. Checksums are compared where there are any. Nothing is read or unpacked
that is larger than any record of a log, whatever the file says of its size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from io import BytesIO
from itertools import chain
import os
from pathlib import Path
import struct
from typing import Any, BinaryIO, NamedTuple
import zlib

from kbnitp_ros.bag.errors import LogError
from kbnitp_ros.bag.records import (
    corrupt,
    LARGEST_RECORD,
    OnCorruption,
    Recorded,
    RecordedMessage,
    RecordedMetadata,
    refuse,
    SkippedMessage,
)
from kbnitp_ros.files import open_file
import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
import zstandard

# What a whole file starts with if rosbag2 compressed it.
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'

# Bytes of all schemas and channels of a file. All types of a large ROS system have 3 million.
MOST_DEFINITIONS = 2**24

# How much is read at a time of what is not looked at.
BLOCK = 2**20

# Kinds of records that are looked at.
READ = {
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.MESSAGE,
    Opcode.METADATA,
    Opcode.STATISTICS,
    Opcode.DATA_END,
    Opcode.FOOTER,
}

NO_SCHEMA = Schema(id=0, name='', encoding='', data=b'')

# Of a record: its kind and length.
HEAD = struct.Struct('<BQ')

# Of a message: channel, sequence, log time and publish time.
MESSAGE = struct.Struct('<HIQQ')
MESSAGE_HEAD = MESSAGE.size

# Of a chunk: the times of its first and last message, its size before compression and the checksum
# of that. Its compression and the size of what follows come next.
CHUNK = struct.Struct('<QQQI')

# Of a footer: where the summary starts and where its offsets do. The checksum of the summary comes
# next, and covers these.
FOOTER = struct.Struct('<QQ')


class Record(NamedTuple):
    """A record, or the part of it that is there, and how far into the file that ends."""

    kind: int
    body: bytes
    position: int
    # How many bytes it has: of a message that is too large, the body has the head alone.
    length: int


class Definitions:
    """The schemas and channels that a file has, by their numbers."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._size = 0

    def take(self, record: Record) -> None:
        """
        Add a schema or a channel.

        Fails if it is corrupt, another one has its number, or all are too large together.
        """
        check_size('a definition', len(record.body), MOST_DEFINITIONS)
        stream = WholeStream(BytesIO(record.body))
        known: dict[int, Any]
        if record.kind == Opcode.SCHEMA:
            known, defined = self.schemas, Schema.read(stream)
        else:
            known, defined = self.channels, Channel.read(stream)
        if defined.id not in known:
            self._size += len(record.body)
            check_size('definitions', self._size, MOST_DEFINITIONS)
        if known.setdefault(defined.id, defined) != defined:
            raise ValueError(f'{type(defined).__name__} {defined.id} is defined twice')


class WholeStream(ReadDataStream):
    """Bytes of which no more are read than there are."""

    def read(self, length: int) -> bytes:
        """Return the next bytes, all of them; raises EndOfFile if they are fewer."""
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def read_mcap(path: Path, on_corruption: OnCorruption = refuse) -> Iterator[Recorded]:
    """
    Yield the messages and the metadata records of a file in the order they were written.

    `on_corruption` takes a LogError wherever the file is corrupt; if it returns, reading goes on
    after that.

    Raises
    ------
    OSError
        If it cannot be read.
    LogError
        What `on_corruption` raises.

    """
    # What is defined in a corrupt part may be defined again at the end.
    known = Definitions() if on_corruption is refuse else read_definitions(path)
    messages = 0
    is_sound = True

    def unsound(error: LogError) -> None:
        nonlocal is_sound
        is_sound = False
        on_corruption(error)

    for record in records(path, unsound):
        try:
            if record.kind == Opcode.MESSAGE:
                messages += 1
                number, sequence, log_time, publish_time = MESSAGE.unpack_from(record.body)
                channel = known.channels[number]
                schema = known.schemas[channel.schema_id] if channel.schema_id else NO_SCHEMA
                if record.length > LARGEST_RECORD:
                    yield SkippedMessage(path, channel.topic, record.length, record.position)
                    continue
                data = record.body[MESSAGE_HEAD:]
                yield RecordedMessage(
                    channel, schema, sequence, log_time, publish_time, data, record.position
                )
            elif record.kind == Opcode.METADATA:
                values = Metadata.read(WholeStream(BytesIO(record.body)))
                yield RecordedMetadata(values.name, values.metadata, record.position)
            elif record.kind == Opcode.STATISTICS:
                count = Statistics.read(WholeStream(BytesIO(record.body))).message_count
                if is_sound and count != messages:
                    raise ValueError(f'{messages} messages found, {count} were written')
            else:
                known.take(record)
        except Exception as error:
            unsound(corrupt(path, record.position, error))


def read_definitions(path: Path) -> Definitions:
    """Return the schemas and channels of a file wherever it has them, corrupt or not."""
    known = Definitions()
    for record in records(path, lambda _: None):
        if record.kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            with suppress(Exception):
                known.take(record)
    return known


def records(path: Path, on_corruption: OnCorruption) -> Iterator[Record]:
    """
    Yield the records of a file, in place of a chunk those in it.

    What is cut off at the end is left out, and so is what is written meanwhile. Parameters and
    errors are as for `read_mcap`.
    """
    with open_file(path) as file:
        source = McapSource(file, path)
        before = source.checksum
        is_sound = True
        while len(head := source.read(HEAD.size)) == HEAD.size:
            kind, length = HEAD.unpack(head)
            end = source.position + length
            position = min(end, source.size)
            try:
                if not kind:
                    check_empty(chain([head], source.blocks(source.size)))
                elif end > source.size and source.is_finished:
                    raise ValueError(f'a record of {length} bytes does not fit in')
                elif kind == Opcode.MESSAGE and length > LARGEST_RECORD:
                    yield Record(kind, source.read(MESSAGE_HEAD), position, length)
                elif kind == Opcode.CHUNK:
                    for inner, body, size in in_chunk(source, length):
                        yield Record(inner, body, position, size)
                elif kind in READ:
                    check_size('a record', length)
                    body = source.read(length)
                    if len(body) < length:
                        continue
                    elif kind == Opcode.DATA_END:
                        written = DataEnd.read(WholeStream(BytesIO(body))).data_section_crc
                        check_crc(before, written if is_sound else 0)
                        # What follows has a checksum of its own.
                        source.checksum = 0
                    elif kind == Opcode.FOOTER:
                        written = Footer.read(WholeStream(BytesIO(body))).summary_crc
                        found = zlib.crc32(head + body[: FOOTER.size], before)
                        check_crc(found, written if is_sound else 0)
                        if not MCAP0_MAGIC.startswith(source.read(len(MCAP0_MAGIC) + 1)):
                            raise ValueError('it does not end there')
                        return
                    else:
                        yield Record(kind, body, position, length)
            except Exception as error:
                is_sound = False
                on_corruption(corrupt(path, position, error))
            source.skip_to(end)
            before = source.checksum
        if source.is_finished and is_sound:
            on_corruption(corrupt(path, source.position, ValueError('it ends within a record')))


class McapSource:
    """
    A file as long as it was when it was opened, read from front to back.

    Raises
    ------
    LogError
        If it is no MCAP file.

    """

    def __init__(self, file: BinaryIO, path: Path) -> None:
        self._file = file
        self.size = os.fstat(file.fileno()).st_size
        # Whether it ends as its writer ends it.
        self.is_finished = ends_finished(file, self.size)
        self.checksum = zlib.crc32(read_start(file, path))

    @property
    def position(self) -> int:
        """How many bytes of it were read."""
        return self._file.tell()

    def read(self, length: int) -> bytes:
        """Return the next bytes, fewer at the end."""
        data = self._file.read(max(0, min(length, self.size - self.position)))
        self.checksum = zlib.crc32(data, self.checksum)
        return data

    def blocks(self, length: int) -> Iterator[bytes]:
        """Yield the next bytes, fewer at the end, some at a time."""
        while length > 0 and (block := self.read(min(length, BLOCK))):
            yield block
            length -= len(block)

    def skip_to(self, end: int) -> None:
        """Read on to a position."""
        for _ in self.blocks(end - self.position):
            pass


def is_finished(path: Path) -> bool:
    """
    Return whether a file ends as its writer ends it.

    Raises
    ------
    OSError
        If it cannot be read.
    LogError
        If it is no MCAP file.

    """
    with open_file(path) as file:
        return McapSource(file, path).is_finished


def read_start(file: BinaryIO, path: Path) -> bytes:
    """Return the first bytes of a file, which must be those of an MCAP file or cut off."""
    start = file.read(len(MCAP0_MAGIC))
    if start.startswith(ZSTD_MAGIC):
        raise LogError(f'{path} is compressed: decompress it with zstd -d')
    if not MCAP0_MAGIC.startswith(start):
        raise LogError(f'{path} is no MCAP file and no database of rosbag2')
    return start


def ends_finished(file: BinaryIO, size: int) -> bool:
    """Return whether a file ends as its writer ends it; leaves it at its start."""
    file.seek(max(0, size - len(MCAP0_MAGIC)))
    end = file.read()
    file.seek(0)
    return size > len(MCAP0_MAGIC) and end == MCAP0_MAGIC


def in_chunk(source: McapSource, length: int) -> Iterator[tuple[int, bytes, int]]:
    """
    Yield kind, body and length of the records in a chunk; of a cut one, of those that are whole.

    Of a message that is too large to be read the body is its head alone.

    Raises
    ------
    Exception
        In many ways where it is corrupt.

    """
    head = source.read(min(CHUNK.size, length))
    size = CHUNK.unpack(head)[2] if len(head) == CHUNK.size else 0
    if max(length, size) > LARGEST_RECORD:
        yield from in_large_chunk(BoundedStream(source, length - len(head)), size)
        return
    for kind, body in in_small_chunk(head + source.read(length - len(head)), length):
        yield kind, body, len(body)


class BoundedStream:
    """The next bytes of a file, no more than there are in a record."""

    def __init__(self, source: McapSource, length: int) -> None:
        self._source = source
        self.is_cut = source.position + length > source.size
        self.left = length

    def read(self, length: int = -1) -> bytes:
        """Return the next bytes, fewer at the end."""
        data = self._source.read(self.left if length < 0 else min(length, self.left))
        self.left -= len(data)
        return data


def in_large_chunk(stream: BoundedStream, original_size: int) -> Iterator[tuple[int, bytes, int]]:
    """
    Yield what `in_chunk` does of a chunk that is larger than what is read at once.

    A chunk becomes so large by its last message: nothing is read or unpacked after one that is too
    large, and the checksum of the chunk is not compared.
    """
    compression = stream.read(int.from_bytes(stream.read(4), 'little')).decode()
    size = int.from_bytes(stream.read(8), 'little')
    if size != stream.left or (not compression and size != original_size):
        raise ValueError(f'a chunk with {stream.left} bytes of content says that it has {size}')
    if compression not in ('', 'zstd'):
        check_size(f'a chunk with compression {compression!r}', original_size)
    # A frame may ask for any window to be kept in memory.
    unpacker = zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD)
    compressed: Any = stream
    content = unpacker.stream_reader(compressed) if compression else stream
    position = 0
    while len(head := content.read(HEAD.size)) == HEAD.size:
        kind, length = HEAD.unpack(head)
        check_kind(kind, length)
        position += HEAD.size + length
        if length > LARGEST_RECORD:
            yield kind, content.read(MESSAGE_HEAD), length
            break
        check_size('what comes before the last message of a chunk', position, 2 * LARGEST_RECORD)
        body = content.read(length)
        if len(body) < length:
            break
        yield kind, body, length
    if position != original_size and not stream.is_cut:
        raise ValueError(f'a chunk has not the {original_size} bytes that were written')


def check_kind(kind: int, length: int) -> None:
    """Check that a record may be in a chunk."""
    if kind not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
        raise ValueError(f'a chunk has a record of kind {kind}')
    if kind != Opcode.MESSAGE:
        check_size('a definition', length, MOST_DEFINITIONS)


def in_small_chunk(body: bytes, length: int) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of the records in a chunk of this length, or in what is left of it."""
    is_cut = len(body) < length
    data = content(body, length)
    start = 0
    while start + HEAD.size <= len(data):
        kind, size = HEAD.unpack_from(data, start)
        begin, start = start + HEAD.size, start + HEAD.size + size
        check_kind(kind, size)
        if start <= len(data):
            yield kind, bytes(data[begin:start])
    if start != len(data) and not is_cut:
        raise ValueError('a chunk ends within a record')


def content(body: bytes, length: int) -> bytes | memoryview:
    """
    Return the records in a chunk as they were before compression; of one that is cut what is left.

    Nothing is left of one that is cut and compressed. A chunk says in three ways how long it is.
    If these differ its length is corrupt, and the end of the file need not cut it.

    Raises
    ------
    Exception
        If it cannot be decompressed, is not the same as before, or is larger than any chunk.

    """
    is_cut = len(body) < length
    stream = WholeStream(BytesIO(body))
    try:
        _, _, original_size, checksum = CHUNK.unpack(stream.read(CHUNK.size))
        compression = stream.read_prefixed_string()
        size = stream.read8()
    except EndOfFile:
        if is_cut:
            return b''
        raise
    if stream.count + size != length or (not compression and size != original_size):
        raise ValueError(f'a chunk of {length} bytes has content of {size}')
    start = stream.count
    stored = memoryview(body)[start:]
    if is_cut:
        return b'' if compression else stored
    check_size('a chunk', original_size)
    if compression not in UNPACK:
        raise ValueError(f'a chunk has compression {compression!r}')
    # One byte more shows that there is more.
    data = UNPACK[compression](stored, original_size + 1)
    if len(data) != original_size:
        raise ValueError(f'a chunk has not the {original_size} bytes that were written')
    check_crc(zlib.crc32(data), checksum)
    return data


def unpack_zstd(data: memoryview, most: int) -> bytes:
    """Return the start of what was compressed."""
    # A frame may ask for any window to be kept in memory.
    reader = zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD).stream_reader(data)
    unpacked: bytes = reader.read(most)
    return unpacked


def unpack_lz4(data: memoryview, most: int) -> bytes:
    """Return the start of what was compressed."""
    unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
    return unpacked


UNPACK: dict[str, Callable[[memoryview, int], bytes | memoryview]] = {
    '': lambda data, _: data,
    'lz4': unpack_lz4,
    'zstd': unpack_zstd,
}


def check_size(what: str, size: int, most: int = LARGEST_RECORD) -> None:
    """Check that something is not larger than it can be."""
    if size > most:
        raise ValueError(f'{what} of {size} bytes: no log has more than {most}')


def check_crc(found: int, written: int) -> None:
    """Check a checksum if one was written."""
    if written not in (0, found):
        raise ValueError(f'the checksum is {found:#x}, {written:#x} was written')


def check_empty(blocks: Iterable[bytes]) -> None:
    """Check that what comes after the last record is room that a file system made for more."""
    if any(block.strip(b'\0') for block in blocks):
        raise ValueError('a record has no kind')
