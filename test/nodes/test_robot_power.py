# SPDX-License-Identifier: Apache-2.0
"""A robot that loses its power, in the field or at home, and what it had not synced with it."""

import json
import os
import signal
import subprocess

from extent import FULL
from fleet import FIELD, Fleet
from launches import interrupt, launched, nodes_of
import numpy as np
import pytest

pytestmark = [pytest.mark.processes, pytest.mark.interpreter]

ORDERS = [0, 1, 2, 3, 16, 15, 14, 13, 0]

# When the power is cut, in seconds after the robot has left: in the field, or at any time.
CUTS = np.random.default_rng(6).uniform(0, 4.5, 100) if FULL else (0.7,)


@pytest.fixture
def synced(tmp_path, monkeypatch):
    """Have processes that are started keep how much of each journal is on the disk."""
    library = tmp_path / 'keep_synced.so'
    source = Fleet.SOURCES / 'keep_synced.c'
    subprocess.run(['cc', '-shared', '-fPIC', '-o', library, source, '-ldl'], check=True)
    monkeypatch.setenv('LD_PRELOAD', str(library))


def cut_power(fleet, rng):
    """Cut the power of a robot: it is off, it stands, and what was not synced is gone."""
    fleet.field.kill('/scout_1/robot')
    fleet.inject('die')
    fleet.inject('live')
    journal = fleet.journal('scout_1')
    content = journal.read_bytes()
    synced = int(journal.with_name(f'{journal.name}.synced').read_text())
    assert synced <= len(content)
    # Of what was written and not synced, any part may be there, and blocks of zeros.
    end = int(rng.integers(synced, len(content) + 1))
    journal.write_bytes(content[:end] + bytes(int(rng.integers(0, 20))))


@pytest.mark.usefixtures('synced')
def test_a_robot_that_loses_its_power_anywhere_reports_its_walk_once(request):
    field = request.getfixturevalue('field')
    rng = np.random.default_rng(5)
    fleet, reports = Fleet.simulated(field)

    fleet.start()
    where = {'in the field': 0, 'at home': 0}
    for number, after in enumerate(CUTS, 1):
        since = len(fleet.truth()['scout_1'])
        key = fleet.send(number, ORDERS)
        field.until(lambda: 'driving' in fleet.state(), 'robot under way')
        fleet.wait(after)
        is_home = any(each.deployment.sec == number for each in reports)
        cut_power(fleet, rng)
        fleet.start()
        report = fleet.report_of(reports, key)
        fleet.see_that_it_is_true(report, since)
        where['at home' if is_home else 'in the field'] += 1
        field.until(lambda: fleet.state().startswith('taking paths'), 'robot at home')
    print(where)
    # Each start says again what all before it said, in the same words: `report_of` sees to that.
    for number in range(1, len(CUTS) + 1):
        told = {str(each.readings) for each in reports if each.deployment.sec == number}
        assert len(told) == 1
    assert where['in the field'] >= len(CUTS) // 3
    assert 'it goes home' in field.said('/scout_1/robot')


def test_a_launched_robot_that_is_killed_in_the_field_comes_home(field):
    pytest.importorskip('launch_ros', reason='launch comes with an installation of ROS 2 only')
    fleet, reports = Fleet.simulated(field)
    parameters = field.folder / 'robot.yaml'
    given = {**FIELD, 'await_nodes': ['test'], 'stay_time': 0.3}
    # JSON is YAML.
    parameters.write_text(json.dumps({'/**/robot': {'ros__parameters': given}}))
    arguments = {
        'nav_namespace': 'scout_1',
        'journal': fleet.journal('scout_1'),
        'params_file': parameters,
    }
    robot = launched(
        field.folder,
        int(os.environ['ROS_DOMAIN_ID']),
        *(f'{name}:={value}' for name, value in arguments.items()),
        launch_file='robot',
    )
    try:
        key = fleet.send(1, ORDERS)
        field.until(lambda: {2, 3} & set(fleet.walked()), 'robot under way')
        os.kill(nodes_of(robot)['/scout_1/robot'], signal.SIGKILL)
        fleet.inject('die')
        fleet.inject('live')
        report = fleet.report_of(reports, key)
    finally:
        interrupt(robot)
    assert robot.wait(60) == 0
    fleet.see_that_it_is_true(report)
