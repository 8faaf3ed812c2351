# SPDX-License-Identifier: Apache-2.0
"""How a mission ends, and what console and log tell of that."""

from base import Base, GRID
from kbnitp_msgs.msg import Progress
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.core import Observation
from kbnitp_ros.log.configuration import read_parameters
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.messages.progress import MissionState

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
    key, _ = read_path(GRID, 'scout_1', base.paths['scout_1'][0])
    stay = Observation([GRID.base, GRID.base], True, [-1])
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
