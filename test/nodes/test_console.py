# SPDX-License-Identifier: Apache-2.0
"""What nodes say on the console, and how a mission ends."""

import re

from base import Base
from base import GRID as BASE_GRID
from kbnitp_msgs.msg import DeploymentReport, Progress
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.core import Belief, Estimator, Grid, Ledger, Observation, plan, SensorModel
from kbnitp_ros.files import counted
from kbnitp_ros.log.configuration import read_parameters
from kbnitp_ros.messages.deployments import read_path, read_report, report_message
from kbnitp_ros.messages.progress import MissionState
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


# How a mission ends, and what console and log tell of that.


SILENT = {'silent_loss': True, 'step_period': 0.001, 'return_deadline': 2.0}


def test_a_base_stays_for_robots_that_were_given_up(field):
    base = Base(field, robots=1, keep_running=False, **SILENT)
    base.until_sent(1)
    base.until_held(1)
    stays = 'in which robots that were given up may come home: scout_1 at '
    field.until(lambda: stays in field.said('/planner'), 'that the base stays')
    base.come_back()
    field.until(lambda: len(base.beliefs) > 2, 'belief in the return')
    planner = field.processes.started['/planner']
    field.until(lambda: planner.poll() is not None, 'end', may_end=True)
    assert planner.returncode == 0
    report = base.replayed()
    assert [each.survived for each in report.evidence.reports.values()] == [True]


def test_console_and_replay_tell_how_a_mission_ended(field):
    progress = field.listen(Progress, '/progress')
    base = Base(field, robots=2)
    base.until_sent(1)
    key, _ = read_path(BASE_GRID, 'scout_1', base.paths['scout_1'][0])
    stay = Observation([BASE_GRID.base, BASE_GRID.base], True, [-1])
    base.reports['scout_1'].publish(report_message(key, stay, key.stamp + 1))
    base.until_sent(2)
    assert f'{key} is back without a step' in field.said('/planner')

    def is_recorded(loss_cost):
        planner = read_parameters(base.log).get('/planner', {})
        return planner.get('loss_cost') == loss_cost

    field.until(lambda: is_recorded(0.0), 'parameters on record')
    assert field.set_parameter('/planner', 'loss_cost', 0.5).successful
    field.until(lambda: is_recorded(0.5), 'the change on record')
    base.do('end_mission')
    base.come_back()
    ended = 'done: 2 of 2 robots deployed, ended by the operator'
    base.until_state(ended)
    said = field.said('/planner')
    assert 'parameter loss_cost is 0.5 now, and was 0.0' in said
    assert f'the mission is over: {ended}' in said
    # The estimator tells it in `progress`, from the diagnostics of the planner.
    field.until(lambda: progress and progress[-1].reason.startswith('done'), 'end in progress')
    report = base.replayed()
    assert f'the log of the mission is {base.log}' in field.said('/recorder')
    told = [*lines(report)]
    assert 'parameter loss_cost of /planner changed from 0.0 to 0.5' in told
    assert f'the mission was ENDED when the log ended: {ended}' in told


def test_states_of_missions_are_those_of_the_message():
    assert all(getattr(Progress, each.name) == each for each in MissionState)
