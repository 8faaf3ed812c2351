# SPDX-License-Identifier: Apache-2.0
"""What nodes say on the console: for whom they wait, and what becomes of each robot."""

import re

from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.core import Belief, Estimator, Grid, Ledger, plan, SensorModel
from kbnitp_ros.files import counted
from kbnitp_ros.messages.deployments import read_path, read_report
from kbnitp_ros.nodes.runtime.node import DEPLOYMENTS
from nav_msgs.msg import Path
import pytest

GRID = Grid(3, 3)
MODEL = SensorModel(0.5)
ROLES = ('agent', 'estimator', 'recorder', 'planner')
PARAMETERS = {'grid.width': 3, 'grid.height': 3, 'max_steps': 4}


def ledger():
    """Return what an estimator knows before the first deployment."""
    return Ledger(GRID, 4, Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), MODEL))


def until_said(field, name, *words):
    """Wait until a node has said all of this on its console."""
    field.until(lambda: all(each in field.said(name) for each in words), f'{words} of {name}')


def test_who_serves_a_role_may_be_called_anything(field):
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    for node in ROLES:
        # Agents do not listen to beliefs.
        passed_over = (node, 'agent') if node == 'estimator' else (node,)
        parameters = {
            **PARAMETERS,
            'robots': 2,
            'recorded': True,
            'await_nodes': [each for each in ROLES if each not in passed_over],
            'file': str(field.folder / 'mission.mcap'),
        }
        field.start(node, parameters, remaps={'__node': f'some_{node}'})
    field.until(lambda: len(paths) == len(reports) == 2, 'mission')


def test_the_others_say_for_whom_they_wait(field):
    field.start('recorder', {'file': str(field.folder / 'mission.mcap')})
    field.start('estimator', PARAMETERS)
    field.start('agent', PARAMETERS)
    until_said(
        field, '/agent', 'waiting for planner to listen to /scout_1/report (parameter await_nodes)'
    )
    until_said(
        field, '/estimator', 'waiting for planner to listen to /belief (parameter await_nodes)'
    )
    until_said(
        field,
        '/recorder',
        'waiting for a planner to publish AGENT/path in namespace /; recording ',
    )


def deployments_said(field, name):
    """Return what a node has said of each deployment."""
    lines = field.said(name).splitlines()
    return [line.partition(f'{DEPLOYMENTS}]: ')[2] for line in lines if DEPLOYMENTS in line]


def test_each_deployment_is_a_line_of_the_planner_and_one_of_the_estimator(field):
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    field.start_mission({**PARAMETERS, 'robots': 5, 'sensor.lethality': 0.5, 'seed': 3})
    field.until(
        lambda: (
            len(deployments_said(field, '/estimator')) == 5 == len(reports) and len(paths) == 5
        ),
        'mission',
    )
    known, lost = ledger(), 0
    for number, (path, report) in enumerate(zip(paths, reports), start=1):
        key, cells = read_path(GRID, 'scout_1', path)
        planned = plan(GRID, known.belief, MODEL, 4)
        left = deployments_said(field, '/planner')[number - 1]
        numbers = re.fullmatch(
            rf'{key} leaves for \((.*), (.*)\) m and back in {len(cells) - 1} steps: it returns '
            'with probability (.*), expected information (.*) nats',
            left,
        )
        assert numbers, left
        x, y, survival, information = map(float, numbers.groups())
        assert int(GRID.cells_at([(x, y)])[0]) in cells
        assert survival == pytest.approx(planned.survival, abs=0.006)
        assert information == pytest.approx(planned.information, rel=0.01)
        known.record_path(key, cells)
        known.record_report(*read_report(report))
        lost += not report.survived
        ended = 'came back' if report.survived else 'was lost'
        assert deployments_said(field, '/estimator')[number - 1] == (
            f'{key} {ended}: entropy {known.belief.entropy():.2f} nats after '
            f'{counted(number, "deployment")}, {counted(lost, "robot")} lost'
        )
    assert 0 < lost < 5
