# SPDX-License-Identifier: Apache-2.0
"""Logs that are made to take all memory or time are refused before they do, by every reader."""

from contextlib import closing
from itertools import product
import os
import sqlite3
import struct

from bags import write_bag
from bounded import megabytes_at_start, run_command
from kbnitp_ros.bag.reader import LogError, read_log
from kbnitp_ros.bag.writer import LogWriter
from laws import for_each
import lz4.frame
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from mission_log import record
import pytest
import zstandard

# What a log takes that is refused, in MB.
ENOUGH = 100

GIGABYTE = 2**30


REPAIR = ['--repair', 'out.mcap']


def entry(kind, body, length=None):
    """Return a record of an MCAP file, which may say another length than it has."""
    return struct.pack('<BQ', kind, len(body) if length is None else length) + body


def text(content):
    return struct.pack('<I', len(content)) + content


def chunk(compression, compressed, size):
    """Return a chunk that says what it has before compression is so large."""
    head = struct.pack('<QQQI', 0, 0, size, 0) + text(compression)
    return entry(Opcode.CHUNK, head + struct.pack('<Q', len(compressed)) + compressed)


def whole(*entries):
    """Return a finished file."""
    header = entry(Opcode.HEADER, text(b'ros2') + text(b''))
    end = entry(Opcode.DATA_END, bytes(4)) + entry(Opcode.FOOTER, bytes(20))
    return b''.join([MCAP0_MAGIC, header, *entries, end, MCAP0_MAGIC])


def zeros(compressor, size=GIGABYTE):
    """Return that many zeros, compressed."""
    block = bytes(2**24)
    parts = [compressor.compress(block) for _ in range(size // len(block))]
    return b''.join([*parts, compressor.flush()])


def zstd_zeros(*, says_size, size=GIGABYTE):
    """Return zeros compressed by zstd, in a frame that says how many they are or does not."""
    return zeros(zstandard.ZstdCompressor().compressobj(size if says_size else -1), size)


def lz4_zeros():
    compressor = lz4.frame.LZ4FrameCompressor()
    start = compressor.begin()
    return start + zeros(compressor)


def definitions():
    """Return a file whose schemas take little room until they are decompressed."""
    chunks = []
    for number in range(1, 6):
        body = struct.pack('<H', number) + text(b'a/msg/A') + text(b'ros2msg')
        size = 2**24 - 2**22
        schema = entry(Opcode.SCHEMA, body + text(bytes(size)))
        chunks.append(chunk(b'zstd', zstandard.compress(schema), len(schema)))
    return whole(*chunks)


MCAPS = {
    'zstd that says its size': lambda: whole(
        chunk(b'zstd', zstd_zeros(says_size=True), GIGABYTE),
    ),
    'zstd in a chunk that says less': lambda: whole(
        chunk(b'zstd', zstd_zeros(says_size=True), 1000),
    ),
    'zstd that does not say its size': lambda: whole(
        chunk(b'zstd', zstd_zeros(says_size=False), 1000),
    ),
    'lz4': lambda: whole(chunk(b'lz4', lz4_zeros(), GIGABYTE)),
    'lz4 in a chunk that says less': lambda: whole(chunk(b'lz4', lz4_zeros(), 1000)),
    'many definitions': definitions,
    'record that says it is endless': lambda: whole(entry(Opcode.METADATA, b'', 2**60)),
    'file compressed as a whole': lambda: zstd_zeros(says_size=True),
    'no log': lambda: bytes(2**26),
}


@pytest.mark.processes
@for_each('kind', MCAPS)
def test_a_hostile_mcap_file_is_refused(kind, tmp_path):
    log = tmp_path / 'mission.mcap'
    log.write_bytes(MCAPS[kind]())
    check_refused(log)


@pytest.mark.processes
@for_each('kind', MCAPS, every=4)
def test_a_hostile_mcap_file_is_not_repaired(kind, tmp_path):
    log = tmp_path / 'mission.mcap'
    log.write_bytes(MCAPS[kind]())
    check_refused(log, *REPAIR)


@pytest.mark.processes
@for_each('kind', [Opcode.METADATA, Opcode.ATTACHMENT, Opcode.CHUNK, 0])
def test_a_record_that_is_as_large_as_it_says_is_not_kept(kind, tmp_path):
    log = tmp_path / 'mission.mcap'
    large = entry(kind, b'', 2**28)
    start, end = whole(large).split(large)
    with log.open('wb') as file:
        file.write(start + large)
        file.truncate(file.tell() + 2**28)
        file.seek(0, os.SEEK_END)
        file.write(end)
    check_refused(log)


def test_what_other_programs_attach_is_passed_over(whole_mission, tmp_path):
    log = record(tmp_path / 'mission.mcap', whole_mission.sent)
    content = log.read_bytes()
    at = content.index(entry(Opcode.DATA_END, b'', 4))
    # Its checksum is left out, since what is attached changes it.
    ended = entry(Opcode.DATA_END, bytes(4))
    attached = entry(Opcode.ATTACHMENT, bytes(2 * 2**20))
    after = at + len(ended)
    log.write_bytes(content[:at] + attached + ended + content[after:])
    assert len(list(read_log(log))) == len(whole_mission.sent)


VIEWS = {
    'endless view': """
        ALTER TABLE messages RENAME TO old;
        CREATE VIEW messages AS
        WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)
        SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(1000000) AS data FROM n""",
    'endless view of topics': """
        ALTER TABLE topics RENAME TO old;
        CREATE VIEW topics AS
        WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)
        SELECT i AS id, i AS name, 'a/msg/A' AS type, 'cdr' AS serialization_format FROM n""",
    'view of views': 'ALTER TABLE messages RENAME TO v0;'
    + ''.join(f'CREATE VIEW v{n} AS SELECT a.* FROM v{n - 1} a, v{n - 1} b;' for n in range(1, 16))
    + 'CREATE VIEW messages AS SELECT * FROM v15',
    'view that says it is a table': """
        ALTER TABLE messages RENAME TO old;
        CREATE VIEW messages AS
        WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)
        SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(1000000) AS data FROM n;
        PRAGMA writable_schema = ON;
        UPDATE sqlite_master SET type = 'table' WHERE name = 'messages'""",
    'computed column': """
        ALTER TABLE messages RENAME TO old;
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,
                              data AS (zeroblob(900000000)));
        INSERT INTO messages(topic_id, timestamp) SELECT topic_id, timestamp FROM old""",
    'trigger': 'CREATE TRIGGER t AFTER INSERT ON messages BEGIN SELECT 1; END',
    'comment for a space': """
        PRAGMA writable_schema = ON;
        INSERT INTO sqlite_master VALUES
        ('table', 'other', 'other', 0, 'CREATE/**/VIEW other AS SELECT 1')""",
    'virtual table': """
        ALTER TABLE messages RENAME TO old;
        CREATE VIRTUAL TABLE messages USING fts4(topic_id, timestamp, data)""",
}


def write_database(mission, folder):
    """Write a bag in SQLite, and return its file."""
    return write_bag(folder / 'bag', mission.sent, 'sqlite3') / 'bag.db3'


def write_hostile_database(kind, mission, folder):
    """Write a bag in SQLite whose tables are not what they seem, and return its file."""
    database = write_database(mission, folder)
    with closing(sqlite3.connect(database)) as opened:
        opened.executescript(VIEWS[kind])
    return database


@pytest.mark.processes
@for_each('kind', VIEWS)
def test_a_hostile_database_is_refused(kind, whole_mission, tmp_path):
    check_refused(write_hostile_database(kind, whole_mission, tmp_path))


@pytest.mark.processes
@for_each('kind', VIEWS, every=4)
def test_a_hostile_database_is_not_repaired(kind, whole_mission, tmp_path):
    check_refused(write_hostile_database(kind, whole_mission, tmp_path), *REPAIR)


NO_FILES = {
    'pipe': os.mkfifo,
    'link to a device': lambda path: path.symlink_to('/dev/zero'),
    'folder': lambda path: path.mkdir(),
}


NAMES = ('mission.mcap', 'mission.db3', 'mission_1.mcap', 'metadata.yaml')


def write_no_file(kind, name, mission, tmp_path):
    """Make a log of which one file is none, and return its folder."""
    folder = tmp_path / 'run'
    folder.mkdir()
    if name in ('mission_1.mcap', 'metadata.yaml'):
        record(folder / 'mission.mcap', mission.sent[:1])
        folder.joinpath('metadata.yaml').unlink()
    NO_FILES[kind](folder / name)
    return folder


@pytest.mark.processes
@for_each('kind, name', product(NO_FILES, NAMES), every=2)
def test_what_is_no_file_is_refused(kind, name, whole_mission, tmp_path):
    check_refused(write_no_file(kind, name, whole_mission, tmp_path))


@pytest.mark.processes
@for_each('kind, name', product(NO_FILES, NAMES), every=4)
def test_what_is_no_file_is_not_repaired(kind, name, whole_mission, tmp_path):
    check_refused(write_no_file(kind, name, whole_mission, tmp_path), *REPAIR)


@pytest.mark.processes
@for_each('suffix', ['-wal', '-journal'])
def test_a_pipe_beside_a_database_is_refused(suffix, whole_mission, tmp_path):
    database = write_database(whole_mission, tmp_path)
    os.mkfifo(database.with_name(database.name + suffix))
    check_refused(database)


@for_each('kind, name', product(NO_FILES, ['mission.mcap', 'metadata.yaml']))
def test_a_recorder_goes_on_with_nothing_that_is_no_file(kind, name, whole_mission, tmp_path):
    if name == 'metadata.yaml':
        record(tmp_path / 'mission.mcap', whole_mission.sent[:1])
        tmp_path.joinpath('metadata.yaml').unlink()
    NO_FILES[kind](tmp_path / name)
    with pytest.raises((LogError, OSError)):
        LogWriter(tmp_path / 'mission.mcap', resume=True)


@pytest.mark.processes
def test_the_qos_of_a_channel_is_not_read_beyond_bounds(whole_mission, tmp_path):
    laughs = ''.join(
        f'a{n}: &a{n} [{", ".join([f"*a{n - 1}"] * 10) if n else "x, x"}]\n' for n in range(40)
    )
    log = tmp_path / 'mission.mcap'
    path = whole_mission.sent[0]
    with LogWriter(log) as writer:
        writer.add_topic(path.topic, path.type_name, laughs)
        writer.write(path.topic, path.data, path.time, path.time)
    assert [each.data for each in read_log(log)] == [path.data]
    ended = run_command('replay', log, '--repair', tmp_path / 'out.mcap')
    assert ended.code == 0, ended
    assert ended.megabytes < megabytes_at_start('replay') + ENOUGH


@pytest.mark.processes
@for_each(
    'definition, complaint',
    [
        # Any number of those fits into any message.
        (
            b'Nothing[] poses\n' + b'=' * 80 + b'\nMSG: nav_msgs/Nothing\nuint8[0] nothing\n',
            'it has an array of no elements',
        ),
        (b'uint8 much\n' * 2**20, 'it is defined in 11534336 bytes'),
    ],
)
def test_a_hostile_type_is_refused(definition, complaint, tmp_path):
    defined = b''.join(map(text, (b'nav_msgs/msg/Path', b'ros2msg', definition)))
    schema = entry(Opcode.SCHEMA, struct.pack('<H', 1) + defined)
    said = b''.join(map(text, (b'/a/path', b'cdr', b'')))
    channel = entry(Opcode.CHANNEL, struct.pack('<HH', 1, 1) + said)
    message = struct.pack('<HIQQ', 1, 1, 1, 1) + b'\0\1\0\0' + struct.pack('<I', 2**32 - 1)
    log = tmp_path / 'mission.mcap'
    log.write_bytes(whole(schema, channel, entry(Opcode.MESSAGE, message)))
    check_refused(log, complaint=complaint)


def check_refused(log, *options, complaint=''):
    """Check that a command refuses a log in one sentence and with little memory."""
    options = [log.parent / 'out.mcap' if each == 'out.mcap' else each for each in options]
    ended = run_command('replay', log, *options)
    assert ended.code == 2, ended
    (said,) = ended.said.splitlines()
    assert str(log.parent) in said
    assert complaint in said
    assert ended.megabytes < megabytes_at_start('replay') + ENOUGH
