# SPDX-License-Identifier: Apache-2.0
"""The forecast command: from a prior, from a log, and bad input."""

import gzip
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_ros.cli.forecast import main
from kbnitp_ros.cli.parameters import asked_on_record, recorded_planner
from kbnitp_ros.log.read import read_parameters
from kbnitp_ros.log.record import last_belief, read_ledger
from kbnitp_ros.log.roles import MissionLog
from laws import for_each
import pytest

RECORDED = Path(__file__).parents[1] / 'log/recorded'
SMALL = [
    *('--set', 'grid.width=4', '--set', 'grid.height=4', '--set', 'max_steps=8'),
    *('--set', 'robots=4', '--worlds', '5'),
]
LANE = ['--set', 'goal.kind=lane', '--set', 'goal.cells=[15]']


def log(folder, name='kappa_bnitp'):
    folder.mkdir(exist_ok=True)
    path = folder / 'mission.mcap'
    path.write_bytes(gzip.decompress((RECORDED / f'{name}.mcap.gz').read_bytes()))
    return path


@pytest.mark.processes
@pytest.mark.full
def test_any_number_of_workers_writes_the_same_bytes(tmp_path):
    told = []
    for workers in ('1', '2'):
        out = tmp_path / workers
        arguments = [*SMALL, *LANE, '--set', 'stop.confidence=0.8', '--workers', workers]
        done = subprocess.run(
            [sys.executable, '-m', 'kbnitp_ros', 'forecast', *arguments, '--out', out],
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith('5 missions of at most 4 robots, goal lane at a confidence')
        files = {path.name: path.read_bytes() for path in out.iterdir()}
        assert set(files) == {'forecast.csv', 'forecast.png', 'forecast.svg'}
        told.append((done.stdout.replace(str(out), ''), files))
    assert told[0] == told[1]
    assert told[0][1]['forecast.csv'].decode().count('\n') == 6


@pytest.mark.processes
def test_a_mission_on_record_goes_on(tmp_path, capsys):
    path = log(tmp_path / 'run')
    sent = last_belief(MissionLog(path)).deployments
    options = ['--set', f'robots={sent + 2}', '--worlds', '3', '--workers', '1']
    assert main([str(tmp_path / 'run'), *options]) == 0
    told, _ = capsys.readouterr()
    assert told.startswith('3 missions of at most 2 robots, no goal')
    assert '| robots sent | 2.0 | 2 | 2 | 2 |' in told


@for_each('name', ['kappa_bnitp', 'kappa_bnitp_sampled', 'late_return'])
def test_the_ledger_of_a_log_has_its_last_belief(tmp_path, name):
    path = log(tmp_path, name)
    ledger, last = read_ledger(MissionLog(path)), last_belief(MissionLog(path))
    assert len(ledger.deployments) == last.deployments
    assert ledger.belief.joint == pytest.approx(last.belief.joint, abs=1e-9)


@for_each('options, complaint', [
    (['--set', 'robots=0'], 'robots is 0: it must be a whole number at least 1'),
    ([*LANE, '--set', 'max_steps=2'], 'cell 15, 3 steps from cell 0: at most max_steps = 2'),
    ([*LANE, '--set', 'grid.blocked=[15]'], 'cell 15, an obstacle'),
    (['--set', 'estimator:grid.width=5'], 'planner and estimator have different fields'),
    (['--set', 'agent:seed=3'], "'agent' is no node of the forecast"),
    (['--set', 'map_topic=map'], 'map_topic is map: the forecast subscribes to no map'),
    (['nothere.mcap'], 'nothere.mcap cannot be read: No such file'),
    (['--out', '/proc'], '/proc exists and is not empty'),
    (['--workers', '2000'], 'workers is 2000: it must be from 1 to 1024'),
])  # fmt: skip
def test_bad_input_is_refused(capsys, options, complaint):
    small = [] if options[0] == 'nothere.mcap' else SMALL
    assert main([*small, *options]) == 2
    told = capsys.readouterr().err
    assert re.match(f'forecast: .*{re.escape(complaint)}', told), told


def test_a_log_in_which_all_robots_were_sent_is_refused(tmp_path, capsys):
    path = log(tmp_path)
    robots = read_parameters(path)['/planner']['robots']
    assert main([str(path)]) == 2
    assert f'has 8 deployments, and robots is {robots}' in capsys.readouterr().err
    assert main([str(path), '--set', 'sensor.lethality=0.3']) == 2
    assert 'unknown to the planner: it is a parameter of' in capsys.readouterr().err


def test_a_log_with_a_bad_value_of_the_planner_is_refused(tmp_path):
    recorded = MissionLog(log(tmp_path))
    recorded.parameters['/planner']['max_steps'] = 'x'
    with pytest.raises(ValueError, match=r"max_steps is 'x': it must be a whole number, from 1"):
        recorded_planner(recorded)
    assert asked_on_record(recorded) is None


@for_each('option', ['--worlds', '--workers'])
def test_numbers_are_whole_and_from_1(option, capsys):
    with pytest.raises(SystemExit):
        main([option, '0'])
    assert 'must be a whole number of at least 1' in capsys.readouterr().err
