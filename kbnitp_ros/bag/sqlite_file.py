# SPDX-License-Identifier: Apache-2.0
"""Read a SQLite database as rosbag2 makes it, of any of its versions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
import re
import sqlite3
import sys

from kbnitp_ros.bag.records import (
    corrupt,
    LARGEST_RECORD,
    OnCorruption,
    QOS,
    RecordedMessage,
    refuse,
    SkippedMessage,
    TYPE_HASH,
)
from kbnitp_ros.bag.schema import describe, ENCODING
from kbnitp_ros.files import open_file
from mcap.records import Channel, Schema

MAGIC = b'SQLite format 3\0'

# Changes that a process which was killed did not get to bring into the database.
LEFT_BEHIND = ('-wal', '-journal')

# What is read.
TABLES = ('topics', 'message_definitions', 'messages')

# How everything is defined that holds what was put into it.
STORED = re.compile(r'CREATE\s+(TABLE|(UNIQUE\s+)?INDEX)\s', re.IGNORECASE)

# A message that is not too large to be read.
DATA = f'CASE WHEN length(data) <= {LARGEST_RECORD} THEN data END'


def read_sqlite(
    path: Path, on_corruption: OnCorruption = refuse
) -> Iterator[RecordedMessage | SkippedMessage]:
    """
    Yield the messages of a file by their times.

    Raises
    ------
    LogError
        What `on_corruption` raises.

    """
    position = 0
    try:
        size = path.stat().st_size
        for suffix in LEFT_BEHIND:
            # SQLite reads them, and would wait for a pipe.
            with suppress(FileNotFoundError), open_file(path.with_name(path.name + suffix)):
                pass
        with closing(sqlite3.connect(f'{path.absolute().as_uri()}?mode=ro', uri=True)) as database:
            database.row_factory = sqlite3.Row
            # What stands in a corrupt or foreign file is not to be run.
            database.execute('PRAGMA trusted_schema = OFF')
            if sys.version_info >= (3, 11):
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_RECORD)
            check_schema(database)
            topics = read_topics(database)
            (messages,) = database.execute('SELECT count(*) FROM messages').fetchone()
            rows = database.execute(
                f'SELECT topic_id, timestamp, length(data), {DATA} FROM messages '
                'ORDER BY timestamp, id'
            )
            for read, (topic, time, length, data) in enumerate(rows, 1):
                position = size * min(read, messages) // messages
                if isinstance(length, int) and length > LARGEST_RECORD:
                    yield SkippedMessage(path, topics[topic][0].topic, length, position)
                    continue
                if not (isinstance(time, int) and time >= 0 and isinstance(data, bytes)):
                    raise ValueError(f'message {read} has time {time!r} and {type(data)}')
                channel, schema = topics[topic]
                yield RecordedMessage(channel, schema, 0, time, time, data, position)
    except Exception as error:
        on_corruption(corrupt(path, position, error))


def check_schema(database: sqlite3.Connection) -> None:
    """
    Check that what is read of a database stands in the file, as in those that rosbag2 makes.

    A view or a column that is computed could stand for any number of bytes.

    Raises
    ------
    ValueError
        If it has a view, a trigger, a virtual table or a column that is computed.

    """
    for name, sql in database.execute('SELECT name, sql FROM sqlite_master WHERE sql NOT NULL'):
        if not STORED.match(sql):
            raise ValueError(f'{name!r} is neither a table nor an index')
    for table in TABLES:
        for column in database.execute(f'PRAGMA table_xinfo({table})'):
            if column['hidden']:
                raise ValueError(f'{column["name"]!r} of {table} is computed')


def read_topics(database: sqlite3.Connection) -> dict[int, tuple[Channel, Schema]]:
    """Return the topics by their numbers, and how their types are defined."""
    (has_definitions,) = database.execute(
        "SELECT count(*) FROM sqlite_master WHERE name = 'message_definitions'"
    ).fetchone()
    rows = database.execute('SELECT * FROM message_definitions') if has_definitions else ()
    schemas = {
        row['topic_type']: Schema(
            number,
            row['encoded_message_definition'].encode(),
            row['encoding'],
            row['topic_type'],
        )
        for number, row in enumerate(rows, 1)
    }
    topics = {}
    for row in database.execute('SELECT * FROM topics'):
        type_name = row['type']
        if type_name not in schemas:
            schemas[type_name] = installed(type_name, len(schemas) + 1)
        schema = schemas[type_name]
        said = {QOS: 'offered_qos_profiles', TYPE_HASH: 'type_description_hash'}
        columns = row.keys()
        metadata = {key: row[column] or '' for key, column in said.items() if column in columns}
        name, encoding = row['name'], row['serialization_format']
        if not all(
            isinstance(text, str) for text in (name, encoding, schema.encoding, *metadata.values())
        ):
            raise ValueError(f'topic {row["id"]} has {tuple(row)} where texts should be')
        topics[row['id']] = Channel(row['id'], name, encoding, metadata, schema.id), schema
    return topics


def installed(type_name: str, number: int) -> Schema:
    """Return a type that the file does not define, as rosbag2 before Iron, as installed here."""
    try:
        return Schema(number, describe(type_name).definition.encode(), ENCODING, type_name)
    except LookupError:
        return Schema(number, b'', '', type_name)


def is_finished(path: Path) -> bool:
    """Return whether the file has all its pages and nothing was left beside it to be put in."""
    if any(path.with_name(path.name + suffix).exists() for suffix in LEFT_BEHIND):
        return False
    with open_file(path) as file:
        head = file.read(100)
    if len(head) < 100:
        return False
    page_size = int.from_bytes(head[16:18], 'big')
    pages = int.from_bytes(head[28:32], 'big')
    # A page of 64 KiB is written as 1.
    return path.stat().st_size >= pages * (2**16 if page_size == 1 else page_size)
