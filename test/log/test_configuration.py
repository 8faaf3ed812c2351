# SPDX-License-Identifier: Apache-2.0
"""A log says how its run was configured."""

from datetime import datetime, timezone
import math
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_ros.log.configuration import (
    numerical_environment,
    PARAMETERS,
    parameters_record,
    read_parameters,
    RUN,
    run_record,
)
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import read_metadata
from kbnitp_ros.log.write import LogWriter
from mcap.reader import make_reader
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.processes
def test_the_run_names_its_versions():
    record = run_record('rmw_fastrtps_cpp')
    assert record['python'] == '.'.join(map(str, sys.version_info[:3]))
    assert record['numpy'] == np.__version__
    assert set(numerical_environment()) < record.keys()
    assert record['rmw_implementation'] == 'rmw_fastrtps_cpp'
    for package in ('kbnitp_ros', 'kbnitp_msgs', 'rclpy', 'rmw_fastrtps_cpp'):
        assert re.fullmatch(r'\d+\.\d+\.\d+', record[package]), package
    since = datetime.now(timezone.utc) - datetime.fromisoformat(record['time'])
    assert 0 <= since.total_seconds() < 60


@pytest.mark.processes
def test_what_is_not_installed_has_no_version():
    assert run_record('rmw_of_nobody')['rmw_of_nobody'] == 'unknown'


@pytest.mark.processes
@pytest.mark.skipif(not ROOT.joinpath('.git').exists(), reason='the source is no checkout')
def test_the_run_names_the_revision_of_a_checkout():
    command = ['git', 'rev-parse', 'HEAD']
    head = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    revision = run_record('rmw_fastrtps_cpp')['git_revision']
    assert revision.removesuffix('-dirty') == head.stdout.strip()


def test_parameters_come_back_as_they_were(tmp_path):
    path = tmp_path / 'mission.mcap'
    planner = {
        'flag': True,
        'count': 3,
        'rate': 3.0,
        'tiny': 5e-324,
        'far': math.inf,
        'text': 'two\nlines, ünïcode and "quotes"',
        'empty': [],
        'cells': [1, 2],
        'origin': [0.1, -2.0],
        'names': ['a', 'b'],
        'unset': None,
    }
    with LogWriter(path) as log:
        log.add_metadata(RUN, {'python': '3.11.7'})
        log.add_metadata(f'{PARAMETERS}/m/planner', parameters_record({'flag': False}))
        log.add_metadata(f'{PARAMETERS}/m/planner', parameters_record(planner))
        log.add_metadata(f'{PARAMETERS}/m/agent', parameters_record({'bytes': [b'\1', b'\2']}))
    parameters = read_parameters(path)
    assert parameters == {'/m/planner': planner, '/m/agent': {'bytes': [1, 2]}}
    assert all(type(parameters['/m/planner'][name]) is type(planner[name]) for name in planner)


def test_a_record_that_is_changed_repeats_nothing(tmp_path):
    """Some tools warn of each name that stands in two records."""
    name = f'{PARAMETERS}/planner'
    with LogWriter(tmp_path / 'mission.mcap') as log:
        for values in ({'seed': 1, 'robots': 5}, {'seed': 1}, {'robots': 5, 'rolling': True}):
            log.add_metadata(name, parameters_record(values))
        log.add_metadata(name, parameters_record({'robots': 8}))
    with log.path.open('rb') as file:
        records = [
            each.metadata for each in make_reader(file).iter_metadata() if each.name == name
        ]
    assert records == [{'robots': '5', 'seed': '1'}, {'rolling': 'true'}, {'robots': '8'}]
    assert read_parameters(log.path) == {'/planner': {'seed': 1, 'robots': 8, 'rolling': True}}


def test_parameters_are_read_from_an_unfinished_log(tmp_path):
    log = LogWriter(tmp_path / 'mission.mcap')
    log.add_metadata(f'{PARAMETERS}/agent', parameters_record({'seed': 1}))
    log.sync()
    assert read_parameters(log.path) == {'/agent': {'seed': 1}}
    assert RUN not in read_metadata(log.path)


def test_parameters_of_0_3_are_read_by_the_names_of_today(tmp_path):
    then = {'goal': 'lane', 'goal.cells': [3], 'learn': [], 'robots': 5, 'robots.a.sensor.b': 0.1}
    with LogWriter(tmp_path / 'mission.mcap') as log:
        log.add_metadata(f'{PARAMETERS}/planner', parameters_record(then))
    now = ('goal.kind', 'goal.cells', 'learn.numbers', 'robots', 'team.a.sensor.b')
    assert read_parameters(log.path) == {'/planner': dict(zip(now, then.values()))}


def test_a_corrupt_record_is_told(tmp_path):
    path = tmp_path / 'mission.mcap'
    with LogWriter(path) as log:
        log.add_metadata(f'{PARAMETERS}/agent', {'seed': 'one'})
    with pytest.raises(LogError, match="record 'parameters/agent' is corrupt"):
        read_parameters(path)
