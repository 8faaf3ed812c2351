# SPDX-License-Identifier: Apache-2.0
"""Two missions side by side: what the page says is what the two logs say."""

import re

from kbnitp_ros.cli.report import main
from kbnitp_ros.core import Grid
from kbnitp_ros.report.comparison import differences, given_differently, Pair, reservations
from kbnitp_ros.report.mission import read_mission
from kbnitp_ros.report.tables import curves_of
from mission_log import record
from missions import Shown, single
import numpy as np
import pytest


@pytest.fixture(scope='module')
def logs(tmp_path_factory):
    """Return the logs of two missions in one field: the second has three robots more."""
    folder = tmp_path_factory.mktemp('two')
    return [single(folder / f'{name}.mcap', robots) for name, robots in (('one', 6), ('two', 9))]


@pytest.fixture(scope='module')
def pairs(logs):
    return [Pair(each, curves_of(each)) for each in map(read_mission, logs)]


def last(pair):
    """Return the hazard at the end, and which cells robots entered, by themselves."""
    mission, _ = pair
    entered = np.zeros(mission.grid.cells, dtype=bool)
    for deployment in mission.deployments:
        entered[deployment.outcome.path] = True
    return mission.moments[-1].belief.hazard, entered


def test_differences_are_those_of_the_beliefs(pairs):
    (one, was), (other, since) = map(last, pairs)
    said = list(differences(*pairs))
    assert said[0] == (
        f'{((one <= 0.05) & (other > 0.05)).sum()} cells free in A alone, '
        f'{((other <= 0.05) & (one > 0.05)).sum()} in B alone.'
    )
    suspected = [(hazard >= 0.5) & entered for hazard, entered in ((one, was), (other, since))]
    assert said[2].startswith(f'{(suspected[0] & suspected[1]).sum()} in both; in A alone: ')
    only = int((suspected[1] & ~suspected[0]).sum())
    assert (said[2].rpartition(': ')[2] == 'none.') == (only == 0)
    entered = [(was & ~since).sum(), (since & ~was).sum()]
    assert re.findall(r'(\d+) cells? entered in A alone, (\d+) in B', said[3]) == [
        tuple(map(str, entered))
    ]
    assert 'B sent 3 robots more' in said[6]


def test_a_mission_beside_itself_has_no_difference(pairs):
    one, _ = pairs
    said = ' '.join(differences(one, one))
    assert set(re.findall(r'(\d+)(?: cells?)? (?:\w+ )?in [AB] alone', said)) == {'0'}
    assert said.count('in A alone: none; in B alone: none') == 2
    assert 'as many nats left in B' in said
    assert 'B sent as many robots and lost as many.' in said
    assert 'No difference.' in said
    assert list(reservations(one.mission, one.mission)) == []
    assert list(given_differently(one.mission, one.mission)) == []


def test_another_truth_is_said(tmp_path, pairs):
    whole = Shown(seed=5)
    whole.publish_truth()
    whole.deploy(whole.walk())
    other = read_mission(record(tmp_path / 'mission.mcap', whole.sent))
    first = pairs[0].mission
    hazards = (other.world.hazard != first.world.hazard).sum()
    (said,) = reservations(first, other)
    assert f'differ: in {hazards} cell' in said
    unknown = read_mission(single(tmp_path / 'unknown.mcap', 2, with_truth=False))
    assert list(reservations(first, unknown)) == ['The truth is on record in A alone.']


def test_the_command_writes_one_page(logs, tmp_path, capsys):
    folder = tmp_path / 'compared'
    assert main([*map(str, logs), '--out', str(folder)]) == 0
    assert [each.name for each in folder.iterdir()] == ['comparison.html']
    assert 'comparison.html' in capsys.readouterr().out
    page = (folder / 'comparison.html').read_text()
    for log in logs:
        assert str(log) in page
    assert main([*map(str, logs), '--out', str(folder)]) == 2
    assert 'not empty' in capsys.readouterr().err


def test_other_fields_are_refused(logs, tmp_path, capsys):
    other = single(tmp_path / 'other.mcap', 2, grid=Grid(7, 6, resolution=0.5))
    folder = tmp_path / 'compared'
    assert main([str(logs[0]), str(other), '--out', str(folder)]) == 2
    assert '7x6 cells of 0.5 m' in capsys.readouterr().err
    assert not folder.exists()
