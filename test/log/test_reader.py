# SPDX-License-Identifier: Apache-2.0
"""The reader reads as much as is intact, and raises one kind of error."""

from collections import Counter
import struct

from extent import FULL
from hypothesis import given, Phase, settings
from hypothesis import strategies as st
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.log.read import is_finished, LogError, read_log, read_metadata, read_recorded
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.schema import qos_profiles_yaml
from kbnitp_ros.log.write import LogWriter, MAX_MESSAGE
from laws import for_each
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mission_log import on, QOS, record, record_to, same
import pytest

# Bytes of a chunk before its messages: header, times, sizes, checksum, compression name.
CHUNK_START = 60


@pytest.fixture(scope='module')
def files(whole_mission, tmp_path_factory):
    """Return finished logs, with one message a chunk or all in one, and an unfinished one."""
    folder = tmp_path_factory.mktemp('log')
    with LogWriter(folder / 'finished.mcap') as log:
        record_to(log, whole_mission.sent, synced=True)
    with log.path.open('rb') as file, (folder / 'compressed.mcap').open('wb') as target:
        compress(file, target)
    record(folder / 'one_chunk.mcap', whole_mission.sent)
    log = LogWriter(folder / 'open.mcap')
    record_to(log, whole_mission.sent, synced=True)
    (folder / 'unfinished.mcap').write_bytes(log.path.read_bytes())
    log.close()
    return folder


def compress(file, target):
    """Copy an MCAP file with zstd, one message a chunk, as other programs write it."""
    writer = Writer(target, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start()
    channels = {}
    for schema, channel, message in make_reader(file).iter_messages():
        if channel.id not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, number, channel.metadata
            )
        writer.add_message(
            channels[channel.id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
        writer.flush()
    writer.finish()


def messages(path):
    """Return the messages before the end or an error, and the error."""
    read = []
    try:
        read.extend(read_log(path))  # keeps messages before an error
    except LogError as error:
        return read, error
    return read, None


def is_prefix(read, sent):
    return len(read) <= len(sent) and all(
        (one.topic, one.type_name, one.publish_time, one.log_time)
        == (each.topic, each.type_name, each.time, each.time + 500)
        and same(one.message, each.message)
        for one, each in zip(read, sent)
    )


@for_each('name', ['finished.mcap', 'one_chunk.mcap', 'unfinished.mcap'])
def test_everything_is_read_in_order(files, whole_mission, name):
    read, error = messages(files / name)
    assert error is None
    assert len(read) == len(whole_mission.sent)
    assert is_prefix(read, whole_mission.sent)
    assert is_finished(files / name) == (name != 'unfinished.mcap')


def test_types_can_be_chosen(files, whole_mission):
    wanted = 'kbnitp_msgs/msg/DeploymentReport'
    read = list(read_log(files / 'finished.mcap', [wanted]))
    assert is_prefix(read, on(whole_mission.sent, '/scout_1/report'))
    assert len(read) == 8


def test_positions_grow_to_the_size_of_the_file(files):
    path = files / 'finished.mcap'
    positions = [message.position for message in read_log(path)]
    assert positions == sorted(positions)
    assert 0 < positions[0] < positions[-1] <= path.stat().st_size


def records(content):
    """Yield (start, end) of an MCAP file's records; the last may be truncated."""
    start = 8
    while start + 9 <= len(content):
        (length,) = struct.unpack_from('<Q', content, start + 1)
        yield start, start + 9 + length
        start += 9 + length


def chunks(content):
    """Return (start, end) of the complete chunks in the first bytes of an MCAP file."""
    whole = ((start, end) for start, end in records(content) if end <= len(content))
    return [(start, end) for start, end in whole if content[start] == 6]


def test_files_compressed_by_rosbag2_are_refused(tmp_path):
    path = tmp_path / 'bag_0.mcap'
    path.write_bytes(b'\x28\xb5\x2f\xfd and so on')
    with pytest.raises(LogError, match=r'bag_0.mcap is compressed: decompress it with zstd -d'):
        list(read_log(path))


def changed(content, draw):
    """Return a log's bytes with some removed, changed, inserted or repeated."""
    start, end = draw(st.sampled_from(list(records(content[:-8]))))
    # Lengths and kinds of records are few of the bytes but matter most.
    place = min(start + draw(st.integers(0, 60) | st.integers(0, end - start - 1)), end - 1)
    what = draw(st.sampled_from(['cut', 'flip', 'flip', 'delete', 'insert', 'repeat']))
    before, after = content[:place], content[place:]
    if what == 'cut':
        return what, place, before
    if what == 'flip':
        return what, place, before + bytes([after[0] ^ draw(st.integers(1, 255))]) + after[1:]
    if what == 'delete':
        left_out = draw(st.integers(1, 5000))
        return what, place, before + after[left_out:]
    more = draw(st.binary(min_size=1, max_size=40)) if what == 'insert' else content[start:end]
    return what, place, before + more + after


@pytest.mark.slow
@given(st.data())
@settings(max_examples=400 if FULL else 60, phases=[Phase.generate])
def test_corrupt_logs_are_read_correctly_or_raise_an_error(
    files, whole_mission, tmp_path_factory, data
):
    """No silent loss or change, no other error, and no resumed log."""
    name = data.draw(st.sampled_from(['finished.mcap', 'compressed.mcap', 'unfinished.mcap']))
    content = (files / name).read_bytes()
    what, place, content_now = changed(content, data.draw)
    path = tmp_path_factory.mktemp('changed') / 'mission.mcap'
    path.write_bytes(content_now)
    read, error = messages(path)
    whole = chunks(content)
    before = sum(end <= place for _, end in whole)
    if what == 'cut':
        assert error is None
        assert not is_finished(path)
        assert len(read) == before
        assert is_prefix(read, whole_mission.sent)
        with LogWriter(path, resume=True) as log:
            record_to(log, whole_mission.sent[:2])
        after = [message.data for message in read_log(path)]
        assert after == [each.data for each in [*read, *whole_mission.sent[:2]]]
        return
    sent = whole_mission.sent
    if what in ('repeat', 'delete'):
        # No checksum shows that a whole chunk of an unfinished file stands twice, or is gone.
        read = list({(one.topic, one.publish_time, one.data): one for one in read}.values())
        held = {(one.topic, one.publish_time) for one in read}
        sent = [
            each for each in sent if name != 'unfinished.mcap' or (each.topic, each.time) in held
        ]
    if error is None:
        assert is_prefix(read, sent)
        assert len(read) == len(whole_mission.sent) or name == 'unfinished.mcap'
    in_chunk = any(start + CHUNK_START <= place < end for start, end in whole)
    if what == 'flip' and (in_chunk or (name != 'unfinished.mcap' and place < whole[-1][1])):
        assert f'{path} is corrupt after byte ' in str(error)
        if in_chunk:
            # Some bits of a zstd frame carry nothing: then all is read, up to the file's checksum.
            unchanged = name == 'compressed.mcap' and len(read) == len(whole_mission.sent)
            assert len(read) == before or unchanged
            assert is_prefix(read, whole_mission.sent)
        with pytest.raises(LogError, match='is corrupt after byte'):
            LogWriter(path, resume=True)
        assert [*path.parent.iterdir()] == [path]


def test_replay_states_the_gaps_of_a_truncated_log(files, whole_mission, tmp_path):
    """Replay knows the deployments in the remaining part, and that some may be missing."""
    content = (files / 'unfinished.mcap').read_bytes()
    path = tmp_path / 'mission.mcap'
    ends = [end for _, end in chunks(content)]
    for kept in (0, 3, 8, 20, len(ends) - 1):
        path.write_bytes(content[: ends[kept] - 1])
        had = Counter(message.topic for message in whole_mission.sent[:kept])
        if not had['/belief']:
            with pytest.raises(LogError, match='has no readable beliefs'):
                replay(path)
            continue
        report = replay(path)
        said = list(lines(report))
        assert 'the log is unfinished: it was still being written, or its end is missing' in said
        assert report.reproduced
        assert report.compared['/belief'] == had['/belief']
        assert len(report.evidence.standings) == had['/standings'] - 1
        without_report = had['/scout_1/path'] - had['/scout_1/report']
        assert sum('has no report on record' in line for line in said) == without_report
        unjudged = had['/scout_1/report'] - (had['/standings'] - 1)
        assert sum('is not judged' in line for line in said) == unjudged


@for_each('place, bits, read', [
    ('of its kind', 0x80, 20), ('of its length', 1, 20), ('of its content', 1, 20),
    ("of its index's length", 1, 21),
])  # fmt: skip
def test_a_corrupt_chunk_is_an_error_after_those_before(files, tmp_path, place, bits, read):
    content = bytearray((files / 'unfinished.mcap').read_bytes())
    start, end = chunks(content)[20]
    content[
        {
            'of its kind': start,
            'of its length': start + 4,
            'of its content': end - 5,
            "of its index's length": end + 4,
        }[place]
    ] ^= bits
    path = tmp_path / 'corrupt.mcap'
    path.write_bytes(content)
    found, error = messages(path)
    assert 'corrupt.mcap is corrupt after byte ' in str(error)
    assert 'mcap recover saves what is intact' in str(error)
    assert len(found) == read
    # On request the error is returned, not raised.
    assert len(list(read_log(path, None, corrupt := []))) == read
    assert len(corrupt) == 1


def test_a_missing_chunk_is_noticed(files, tmp_path):
    """Also without checksums, as in bags by rosbag2."""
    content = bytearray((files / 'finished.mcap').read_bytes())
    (data_end,) = (start for start, _ in records(content[:-8]) if content[start] == 15)
    start, end = data_end + 9, data_end + 13
    content[start:end] = bytes(4)
    written = len(chunks(content))
    start, end = chunks(content)[20]
    del content[start:end]
    path = tmp_path / 'corrupt.mcap'
    path.write_bytes(content)
    _, error = messages(path)
    assert f'it has {written - 1} messages, but its statistics state {written}' in str(error)


def test_a_corrupt_record_of_values_is_noticed(tmp_path):
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        log.add_metadata('run', {'seed': '1234567'})
    path.write_bytes(path.read_bytes().replace(b'1234567', b'1234568', 1))
    with pytest.raises(LogError, match='crc validation failed in DataEnd'):
        list(read_log(path))
    assert read_metadata(path, [])['run'] == {'seed': '1234568'}


def test_a_large_message_of_another_writer_is_read(tmp_path):
    path = tmp_path / 'mission.mcap'
    data = bytes(MAX_MESSAGE + 2**20)
    with path.open('wb') as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel('/points', 'cdr', 0), 1, data, 1)
        writer.finish()
    (read,) = read_recorded(path)
    assert read.data == data


def test_a_tail_of_zeros_is_ignored(files, whole_mission, tmp_path):
    """A file system may have reserved space that was never written."""
    path = tmp_path / 'mission.mcap'
    path.write_bytes((files / 'unfinished.mcap').read_bytes() + bytes(5000))
    read, error = messages(path)
    assert error is None
    assert len(read) == len(whole_mission.sent)


def test_a_growing_log_is_read_up_to_its_size_at_the_start(files, whole_mission, tmp_path):
    content = (files / 'finished.mcap').read_bytes()
    end = len(content) // 2
    path = tmp_path / 'mission.mcap'
    path.write_bytes(content[:end])
    read = read_log(path)
    first = next(read)
    with path.open('ab') as file:
        file.write(content[end:])
    both = [first, *read]
    assert is_prefix(both, whole_mission.sent)
    assert 1 < len(both) < len(whole_mission.sent)


def test_bytes_that_cannot_be_deserialized_are_an_error(tmp_path):
    with LogWriter(tmp_path / 'mission.mcap') as log:
        log.add_topic('/scout_1/path', 'nav_msgs/msg/Path', qos_profiles_yaml([QOS]))
        log.write('/scout_1/path', b'\0\1\0\0abc', 1, 1)
    with pytest.raises(LogError, match='mission.mcap: a message of topic /scout_1/path is no'):
        list(read_log(log.path))
    assert list(read_log(log.path, ['kbnitp_msgs/msg/BeliefMaps'])) == []


@for_each('schema', [0, 1])
def test_other_encodings_are_an_error_only_if_requested(tmp_path, schema):
    path = tmp_path / 'mission.mcap'
    with path.open('wb') as file:
        writer = Writer(file)
        writer.start()
        writer.register_schema('Temperature', 'jsonschema', b'{}')
        channel = writer.register_channel('/temperature', 'json', schema)
        writer.add_message(channel, 1, b'{}', 1)
        writer.finish()
    with pytest.raises(
        LogError, match=r"topic /temperature has messages in 'json'.* must be 'cdr'"
    ):
        list(read_log(path))
    assert list(read_log(path, ['nav_msgs/msg/Path'])) == []
