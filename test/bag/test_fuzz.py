# SPDX-License-Identifier: Apache-2.0
"""
Corrupt logs of all kinds: no error but the reader's own, and no message that was not written.

With KBNITP_TESTS=full in the environment 10,000 logs are corrupt, which takes some minutes.
"""

import os
import struct

from bags import write_bag
from extent import FULL
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from kbnitp_ros.bag.reader import is_finished, LogError, read_log, read_metadata
from kbnitp_ros.bag.repair import repair
from kbnitp_ros.bag.writer import LogWriter
from laws import for_each
from mission_log import Mission, on, record_to
import pytest

KINDS = ['mcap', 'mcap zstd', 'mcap by rosbags', 'metadata.yaml']
CASES = 10_000 if FULL else 250

place = st.integers(0, 2**20)
some_bytes = st.binary(min_size=1, max_size=40)
length = st.sampled_from([0, 1, 22, 2**16, 2**31, 2**32, 2**62, 2**63, 2**64 - 1]) | place

corruption = st.one_of(
    st.tuples(st.just('flip'), place, st.integers(1, 255)),
    st.tuples(st.just('write'), place, some_bytes),
    st.tuples(st.just('insert'), place, some_bytes),
    st.tuples(st.just('delete'), place, st.integers(1, 5000)),
    st.tuples(st.just('cut'), place),
    st.tuples(st.just('splice'), place, place, st.integers(1, 5000)),
    st.tuples(st.just('number'), place, length, st.sampled_from([2, 4, 8])),
)


def corrupt(content, places, how):
    """
    Return a file's bytes after something has happened to them.

    Parameters
    ----------
    content : bytes
        The file.
    places : list of int
        Where in it there are lengths and kinds; half of what happens, happens there.
    how : tuple
        What happens, where and with what.

    """
    what, where, *arguments = how
    content = bytearray(content)
    if not content:
        return content
    at = places[where // 2 % len(places)] if places and where % 2 else where // 2
    at %= len(content)
    before, after = content[:at], content[at:]
    if what == 'flip':
        after[0] ^= arguments[0]
    elif what == 'write':
        after[: len(arguments[0])] = arguments[0]
    elif what == 'insert':
        before += arguments[0]
    elif what == 'delete':
        del after[: arguments[0]]
    elif what == 'cut':
        after.clear()
    elif what == 'splice':
        start = arguments[0] % len(content)
        end = start + arguments[1]
        before += content[start:end]
    else:
        number, size = arguments
        after[:size] = (number % 256**size).to_bytes(size, 'little')
    return before + after


def heads(content):
    """Return where in an MCAP file records have their kinds and lengths, also in chunks."""
    places = []
    at = 8
    while at + 9 <= len(content):
        places += [at, at + 1]
        kind, size = struct.unpack_from('<BQ', content, at)
        at += 9
        if kind == 6:
            # The chunk's own sizes, then what is in it.
            places += [at + 16, at + 24, at + 28, at + 32]
            (name,) = struct.unpack_from('<I', content, at + 28)
            size = 40 + name if not name else size
        at += size
    return places


@pytest.fixture(scope='module')
def logs(tmp_path_factory):
    """Return for each kind the file to corrupt, its bytes, where its heads are, the messages."""
    mission = Mission()
    for steps in ([0, 1], [2, 1, 2]):
        mission.send_out([2, *steps, 2], 'scout_1')
    sent = [*on(mission.sent, '/scout_1/path'), *on(mission.sent, '/belief/hazard')] * 2
    folder = tmp_path_factory.mktemp('logs')
    made = {}
    for kind, compression in (('mcap', 'none'), ('mcap zstd', 'zstd')):
        path = folder / compression / 'mission.mcap'
        path.parent.mkdir()
        with LogWriter(path, compression=compression) as log:
            log.add_metadata('run', {'seed': '7'})
            record_to(log, sent[:2])
            log.sync()
            record_to(log, sent[2:])
        made[kind] = path
    made['mcap by rosbags'] = write_bag(folder / 'rosbags', sent, 'mcap') / 'rosbags.mcap'
    made['metadata.yaml'] = write_bag(folder / 'bag', sent, 'mcap') / 'metadata.yaml'
    written = {(each.topic, each.type_name, each.time + 500, each.data) for each in sent}
    found = {}
    for kind, path in made.items():
        content = path.read_bytes()
        found[kind] = path, content, heads(content) if path.suffix == '.mcap' else [], written
    return found


@pytest.mark.slow
@for_each('kind', KINDS)
def test_a_corrupt_log_has_no_message_that_was_not_written(logs, kind, tmp_path, monkeypatch):
    # Nothing here is to survive a power cut, and waiting for the disk takes the most time.
    for name in ('fsync', 'fdatasync'):
        monkeypatch.setattr(os, name, lambda _: None)
    path, content, places, written = logs[kind]
    log = path.parent if kind == 'metadata.yaml' else path
    seen = {'cases': 0, 'refused': 0, 'read': 0}

    @settings(
        max_examples=-(-CASES // len(KINDS)),
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.lists(corruption, min_size=1, max_size=3))
    def check(happened):
        now = content
        for how in happened:
            now = corrupt(now, places, how)
        path.write_bytes(now)
        seen['cases'] += 1
        read = []
        try:
            for each in read_log(log):
                read.append(each)  # noqa: PERF402
            is_finished(log)
            read_metadata(log)
        except LogError:
            seen['refused'] += 1
        seen['read'] += len(read)
        if kind in ('mcap', 'mcap zstd', 'metadata.yaml'):
            assert {
                (each.topic, each.type_name, each.log_time, each.data) for each in read
            } <= written
        target = tmp_path / 'repaired.mcap'
        target.unlink(missing_ok=True)
        try:
            saved = repair(log, target)
        except LogError:
            assert not target.exists()
        else:
            assert saved.messages >= len(read)

    try:
        check()
    finally:
        path.write_bytes(content)
    assert seen['refused'] < seen['cases']
    assert seen['read']
    # pytest -s shows it.
    print(f'{kind}: {seen}')
