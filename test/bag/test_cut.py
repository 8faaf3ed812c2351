# SPDX-License-Identifier: Apache-2.0
"""A file cut at any byte yields every message before the cut, and replay says what is missing."""

from collections import Counter

from extent import FULL
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.log.read import is_finished, LogError, read_log
from kbnitp_ros.log.replay import replay
from kbnitp_ros.log.write import LogWriter
from mcap.reader import make_reader
from mission_log import record_to
import numpy as np
import pytest

CUTS = 360 if FULL else 100

# Messages between two syncs.
BATCH = 3


@pytest.fixture(scope='module', params=['none', 'zstd'])
def log(request, whole_mission, tmp_path_factory):
    """Return a finished log, the ends of its messages' chunks, and its sizes after each sync."""
    path = tmp_path_factory.mktemp('log') / 'mission.mcap'
    sent = whole_mission.sent
    synced = []
    with LogWriter(path, compression=request.param) as writer:
        for start in range(0, len(sent), BATCH):
            end = start + BATCH
            record_to(writer, sent[start:end])
            writer.sync()
            synced.append(path.stat().st_size)
    with path.open('rb') as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    ends = np.repeat([each.chunk_start_offset + each.chunk_length for each in chunks], BATCH)
    return path, ends[: len(sent)].tolist(), synced


def cuts(size, ends):
    """Return random places, and those at and around the end of each chunk and of the file."""
    near = [end + step for end in {*ends} for step in (-1, 0, 1)]
    return [*np.random.default_rng(4).integers(0, size, CUTS).tolist(), *near, 0, 8, size - 1]


@pytest.mark.slow
def test_every_message_before_the_cut_is_read(log, whole_mission, tmp_path):
    path, ends, synced = log
    content = path.read_bytes()
    whole = [each.data for each in read_log(path)]
    assert whole == [each.data for each in whole_mission.sent]
    cut_path = tmp_path / 'cut.mcap'
    for cut in cuts(len(content), ends):
        cut_path.write_bytes(content[:cut])
        read = [each.data for each in read_log(cut_path)]
        assert read == whole[: sum(end <= cut for end in ends)], f'cut at byte {cut}'
        assert len(read) >= min(len(whole), BATCH * sum(size <= cut for size in synced))
        assert not is_finished(cut_path)


@pytest.mark.slow
def test_a_cut_log_is_gone_on_with(log, whole_mission, tmp_path):
    path, ends, _ = log
    content = path.read_bytes()
    for number, cut in enumerate(cuts(len(content), ())[:CUTS:10]):
        cut_path = tmp_path / str(number) / 'mission.mcap'
        cut_path.parent.mkdir()
        cut_path.write_bytes(content[:cut])
        left = whole_mission.sent[: sum(end <= cut for end in ends)]
        with LogWriter(cut_path, resume=True) as writer:
            record_to(writer, whole_mission.sent[:BATCH])
        read = [each.data for each in read_log(cut_path)]
        assert read == [each.data for each in [*left, *whole_mission.sent[:BATCH]]]
        assert is_finished(cut_path)


@pytest.mark.slow
def test_replay_says_what_is_missing(log, whole_mission, tmp_path):
    """It knows of the deployments in the part that is left, and that there may be more."""
    path, ends, _ = log
    content = path.read_bytes()
    cut_path = tmp_path / 'cut.mcap'
    for cut in cuts(len(content), ())[:CUTS:10]:
        cut_path.write_bytes(content[:cut])
        left = whole_mission.sent[: sum(end <= cut for end in ends)]
        had = Counter(each.topic for each in left)
        if not had['/belief']:
            with pytest.raises(LogError, match='no beliefs on record'):
                replay(cut_path)
            continue
        report = replay(cut_path)
        said = list(lines(report))
        assert 'the log is unfinished: it was still being written, or its end is missing' in said
        assert report.reproduced
        assert report.compared['/belief'] == had['/belief']
        assert len(report.evidence.reports) == had['/scout_1/report']
        without_report = had['/scout_1/path'] - had['/scout_1/report']
        assert sum('has no report on record' in line for line in said) == without_report
        in_no_belief = had['/scout_1/report'] - (had['/belief'] - 1)
        assert sum('is in no belief yet' in line for line in said) == in_no_belief
