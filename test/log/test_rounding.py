# SPDX-License-Identifier: Apache-2.0
"""A log of another processor is reproduced nearly, and replay says so."""

from copy import deepcopy
import os
import subprocess
import sys

from kbnitp_ros.cli.replay import main
from kbnitp_ros.core import METHODS
from kbnitp_ros.log.bag.writer import LogWriter
from kbnitp_ros.log.configuration import RUN, run_record
from kbnitp_ros.log.replay import replay
from mission_log import instead, mission, on, record, record_to
import numpy as np
import pytest

# What numpy uses of this processor beside what all have.
EXTENSIONS = np.show_config(mode='dicts')['SIMD Extensions'].get('found')


@pytest.mark.parametrize('gap, is_close', [(1e-10, True), (1e-8, False), (np.nan, False)])
@pytest.mark.parametrize('field', ['joint', 'hazard', 'target', 'kappa'])
def test_a_value_that_no_rounding_explains_is_found(
    whole_mission, tmp_path, capsys, field, gap, is_close
):
    original = on(whole_mission.sent, '/belief')[5]
    spoiled = deepcopy(original.message)
    getattr(spoiled, field)[7] += gap
    sent = instead(whole_mission.sent, original, spoiled)
    path = record(tmp_path / 'mission.mcap', sent)
    report = replay(path)
    assert report.is_close == is_close
    assert not report.reproduced
    assert main([str(path)]) == 1 - is_close
    told = capsys.readouterr().out
    if is_close:
        assert 'the largest difference of a belief is 1e-10' in told
    else:
        (mismatch,) = report.mismatches
        assert f'not reproduced: {mismatch}' in told
        assert f'/belief message 5 (after {mismatch.deployment}): {field} differs in 1 val' in told


@pytest.mark.parametrize('is_rounded', [True, False])
def test_a_percent_may_be_the_next_one_where_the_belief_is_rounded(
    whole_mission, tmp_path, is_rounded
):
    belief = on(whole_mission.sent, '/belief')[5]
    view = on(whole_mission.sent, '/belief/hazard')[5]
    spoiled, shown = deepcopy(belief.message), deepcopy(view.message)
    spoiled.hazard[7] += 1e-12 * is_rounded
    shown.data[7] += 1
    sent = instead(instead(whole_mission.sent, belief, spoiled), view, shown)
    report = replay(record(tmp_path / 'mission.mcap', sent))
    assert report.is_close == is_rounded
    rounded = ['/belief', '/belief/hazard'] if is_rounded else []
    assert [each.topic for each in report.roundings] == rounded
    shown.data[7] += 1
    sent = instead(sent, on(sent, '/belief/hazard')[5], shown)
    assert not replay(record(tmp_path / 'more.mcap', sent)).is_close


@pytest.mark.skipif(
    not (EXTENSIONS),
    reason='numpy knows one way to compute on this processor',
)
@pytest.mark.parametrize('method', METHODS)
def test_a_log_is_nearly_reproduced_by_another_processor(tmp_path, method):
    """One that can do less, which numpy computes logarithms otherwise for."""
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        log.add_metadata(RUN, run_record('rmw_fastrtps_cpp'))
        record_to(log, mission(method=method).sent)
    identical = run_replay(path, {})
    assert identical.returncode == 0
    assert 'equal' not in identical.stdout
    other = run_replay(path, {'NPY_DISABLE_CPU_FEATURES': ' '.join(EXTENSIONS)})
    assert other.returncode == 0, other
    assert '/belief: 9 of 9 reproduced' in other.stdout
    if 'nearly' in other.stdout:
        assert 'equal to 1e-09, not identical: the largest difference' in other.stdout
        (line,) = [each for each in other.stdout.splitlines() if each.startswith('computed with')]
        assert line.startswith('computed with processor features SSE')
        assert ', of the recorder SSE' in line
    else:
        assert other.stdout == identical.stdout


def run_replay(path, environment):
    return subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', 'replay', path],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
