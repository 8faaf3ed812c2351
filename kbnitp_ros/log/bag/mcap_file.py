# SPDX-License-Identifier: Apache-2.0
"""
Read an MCAP file from front to back, without its index.

That works alike for a file that is finished, still being written, left behind by a killed process
or cut short: of the last the messages that are whole are read, also those in a chunk that is cut,
unless it is compressed. Checksums are compared where there are any.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
import os
from pathlib import Path
import struct
from typing import IO, NamedTuple
import zlib

from kbnitp_ros.log.bag.errors import LogError
from kbnitp_ros.log.bag.recorded import (
    damaged,
    OnDamage,
    Recorded,
    RecordedMessage,
    RecordedMetadata,
    refuse,
)
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Metadata, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

# What a whole file starts with if rosbag2 compressed it.
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'

NO_SCHEMA = Schema(id=0, name='', encoding='', data=b'')

# Of a record: its kind and length.
HEAD = struct.Struct('<BQ')

# Of a message: channel, sequence, log time and publish time.
MESSAGE = struct.Struct('<HIQQ')
MESSAGE_HEAD = MESSAGE.size


class Record(NamedTuple):
    """A record, or the part of it that is there, and how far into the file that ends."""

    kind: int
    body: bytes
    position: int


class Definitions:
    """The schemas and channels that a file has, by their numbers."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}

    def take(self, record: Record) -> None:
        """Add a schema or a channel; fails if the record is none or another one has its number."""
        stream = WholeStream(BytesIO(record.body))
        if record.kind == Opcode.SCHEMA:
            schema = Schema.read(stream)
            if self.schemas.setdefault(schema.id, schema) != schema:
                raise ValueError(f'schema {schema.id} is defined twice')
        elif record.kind == Opcode.CHANNEL:
            channel = Channel.read(stream)
            if self.channels.setdefault(channel.id, channel) != channel:
                raise ValueError(f'channel {channel.id} is defined twice')


class WholeStream(ReadDataStream):
    """Bytes of which no more are read than there are."""

    def read(self, length: int) -> bytes:
        """Return the next bytes, all of them; raises EndOfFile if they are fewer."""
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def read_mcap(path: Path, on_damage: OnDamage = refuse) -> Iterator[Recorded]:
    """
    Yield the messages and the metadata records of a file in the order they were written.

    Parameters
    ----------
    path : Path
        The file.
    on_damage : callable
        Takes a LogError wherever the file is damaged; if it returns, reading goes on after that.

    Raises
    ------
    OSError
        If it cannot be read.
    LogError
        What `on_damage` raises.

    """
    # What is defined in a damaged part may be defined again at the end.
    known = Definitions() if on_damage is refuse else read_definitions(path)
    messages = 0
    is_sound = True

    def unsound(error: LogError) -> None:
        nonlocal is_sound
        is_sound = False
        on_damage(error)

    for record in records(path, unsound):
        try:
            if record.kind == Opcode.MESSAGE:
                messages += 1
                number, sequence, log_time, publish_time = MESSAGE.unpack_from(record.body)
                channel = known.channels[number]
                schema = known.schemas[channel.schema_id] if channel.schema_id else NO_SCHEMA
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
            unsound(damaged(path, record.position, error))


def read_definitions(path: Path) -> Definitions:
    """Return the schemas and channels of a file wherever it has them, damaged or not."""
    known = Definitions()
    for record in records(path, lambda _: None):
        with suppress(Exception):
            known.take(record)
    return known


def records(path: Path, on_damage: OnDamage) -> Iterator[Record]:
    """
    Yield the records of a file, in place of a chunk those in it.

    What is cut off at the end is left out, and so is what is written meanwhile. Parameters and
    errors are as for `read_mcap`.
    """
    with path.open('rb') as file:
        size = os.fstat(file.fileno()).st_size

        def read(length: int) -> bytes:
            return file.read(max(0, min(length, size - file.tell())))

        finished = ends_finished(file, size)
        checksum = zlib.crc32(read_start(file, path))
        is_sound = True
        while len(head := read(HEAD.size)) == HEAD.size:
            kind, length = HEAD.unpack(head)
            body = read(length)
            position = file.tell()
            try:
                if not kind:
                    check_empty(head[1:] + body + read(size))
                elif len(body) < length and finished:
                    raise ValueError(f'a record of {length} bytes does not fit in')
                elif kind == Opcode.CHUNK:
                    for inner, content in in_chunk(body, length):
                        yield Record(inner, content, position)
                elif kind == Opcode.DATA_END:
                    written = DataEnd.read(WholeStream(BytesIO(body))).data_section_crc
                    check_crc(checksum, written if is_sound else 0)
                elif kind == Opcode.FOOTER:
                    if finished and position + len(MCAP0_MAGIC) != size:
                        raise ValueError('it does not end there')
                    return
                elif len(body) == length:
                    yield Record(kind, body, position)
            except Exception as error:
                is_sound = False
                on_damage(damaged(path, position, error))
            checksum = zlib.crc32(body, zlib.crc32(head, checksum))
        if finished and is_sound:
            on_damage(damaged(path, file.tell(), ValueError('it ends within a record')))


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
    with path.open('rb') as file:
        read_start(file, path)
        return ends_finished(file, path.stat().st_size)


def read_start(file: IO[bytes], path: Path) -> bytes:
    """Return the first bytes of a file, which must be those of an MCAP file or cut off."""
    start = file.read(len(MCAP0_MAGIC))
    if start.startswith(ZSTD_MAGIC):
        raise LogError(f'{path} is compressed: decompress it with zstd -d')
    if not MCAP0_MAGIC.startswith(start):
        raise LogError(f'{path} is no MCAP file and no database of rosbag2')
    return start


def ends_finished(file: IO[bytes], size: int) -> bool:
    """Return whether a file ends as its writer ends it; leaves it at its start."""
    file.seek(max(0, size - len(MCAP0_MAGIC)))
    end = file.read()
    file.seek(0)
    return size > len(MCAP0_MAGIC) and end == MCAP0_MAGIC


def in_chunk(body: bytes, length: int) -> Iterator[tuple[int, bytes]]:
    """
    Yield kind and body of the records in a chunk; of one that is cut, those that are whole.

    Parameters
    ----------
    body : bytes
        As much of the chunk as there is.
    length : int
        How many bytes it should have.

    Raises
    ------
    Exception
        In many ways where it is damaged.

    """
    is_cut = len(body) < length
    data = cut_content(body, length) if is_cut else content(body)
    start = 0
    while start + HEAD.size <= len(data):
        kind, size = HEAD.unpack_from(data, start)
        begin, start = start + HEAD.size, start + HEAD.size + size
        if kind not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            raise ValueError(f'a chunk has a record of kind {kind}')
        if start <= len(data):
            yield kind, data[begin:start]
    if start != len(data) and not is_cut:
        raise ValueError('a chunk ends within a record')


def content(body: bytes) -> bytes:
    """Return what is in a whole chunk; fails if it cannot be decompressed or is not the same."""
    chunk = Chunk.read(WholeStream(BytesIO(body)))
    if chunk.compression not in ('', 'lz4', 'zstd'):
        raise ValueError(f'a chunk has compression {chunk.compression!r}')
    stream, size = get_chunk_data_stream(chunk)
    data = stream.read(size)
    if size != chunk.uncompressed_size:
        raise ValueError(f'a chunk has {size} bytes, {chunk.uncompressed_size} were written')
    check_crc(zlib.crc32(data), chunk.uncompressed_crc)
    return data


def cut_content(body: bytes, length: int) -> bytes:
    """
    Return what is there of the content of a chunk that is cut; nothing if it is compressed.

    A chunk says in three ways how long it is. If these differ its length is damaged, and the end
    of the file need not cut it.
    """
    stream = WholeStream(BytesIO(body))
    try:
        *_, uncompressed_size, _ = struct.unpack('<QQQI', stream.read(28))
        compression = stream.read_prefixed_string()
        size = stream.read8()
    except (EndOfFile, struct.error):
        return b''
    if stream.count + size != length or (not compression and size != uncompressed_size):
        raise ValueError(f'a chunk of {length} bytes has content of {size}')
    start = stream.count
    return b'' if compression else body[start:]


def check_crc(found: int, written: int) -> None:
    """Check a checksum if one was written."""
    if written not in (0, found):
        raise ValueError(f'the checksum is {found:#x}, {written:#x} was written')


def check_empty(room: bytes) -> None:
    """Check that what comes after the last record is room that a file system made for more."""
    if any(room):
        raise ValueError('a record has no kind')
