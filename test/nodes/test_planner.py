# SPDX-License-Identifier: Apache-2.0
"""The planner sends one robot at a time, on the belief given all before it."""

import json
import time

from base import Base
from base import GRID as FIVE_BY_FIVE
from kbnitp_msgs.msg import (
    BeliefMaps,
    Decision,
    DeploymentReport,
    MissionStatus,
    Progress,
    Recorded,
    Standings,
)
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    plan,
    RobotType,
    SearchOptions,
    SensorModel,
)
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import read_path, read_report, report_message
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.planner import PlannerNode
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import POLL
from nav_msgs.msg import Path
import numpy as np
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from samples import belief, changed, in_frame, on_disk, standings

GRID = Grid(3, 3)
MODEL = SensorModel(0.5)
PARAMETERS = {'grid.width': 3, 'grid.height': 3, 'max_steps': 4, 'await_nodes': ['test']}


class Mission:
    """A planner; the test plays the agent and the estimator."""

    def __init__(self, field, parameters):
        self.field = field
        self.paths = field.listen(Path, '/scout_1/path')
        # Before the belief's publisher: a planner that has the belief then knows this agent.
        self.reports = field.node.create_publisher(
            DeploymentReport, '/scout_1/report', qos.EVIDENCE
        )
        field.stand('scout_1', GRID)
        self.beliefs = field.node.create_publisher(BeliefMaps, '/belief', qos.LATCHED)
        self.standings = field.node.create_publisher(Standings, '/standings', qos.STANDINGS)
        field.start('planner', {**PARAMETERS, **parameters})
        field.until(lambda: self.beliefs.get_subscription_count(), 'reader of belief')
        self.ledger = Ledger(GRID, 4, Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), MODEL))

    def show_standings(self):
        self.standings.publish(standings(self.ledger, author='/test/test'))

    def show_belief(self):
        """Publish all standings, and the belief with their evidence."""
        self.show_standings()
        self.beliefs.publish(belief(self.ledger, 0))

    def lose(self, number):
        """Report a deployment's robot lost, and assimilate the loss."""
        key, cells = read_path(GRID, 'scout_1', self.paths[number])
        report = report_message(key, Observation(cells, False), 0)
        self.ledger.record_path(key, cells)
        self.ledger.record_report(*read_report(report))
        return report

    def until_sent(self, number):
        self.field.until(lambda: len(self.paths) == number + 1, f'path {number}')
        return read_path(GRID, 'scout_1', self.paths[number])[1].tolist()

    def until_state(self, words):
        self.field.until(lambda: words in self.field.state('/planner'), words)

    def planned(self):
        return plan(GRID, self.ledger.belief, MODEL, SearchOptions(max_steps=4)).path.tolist()


def test_a_robot_is_sent_when_the_last_one_is_in_the_belief(field):
    mission = Mission(field, {'robots': 3})
    mission.until_state('waiting for the belief')
    mission.show_belief()
    assert mission.until_sent(0) == mission.planned()

    mission.until_state('waiting for the report of')
    report = mission.lose(0)
    mission.reports.publish(report)
    mission.until_state('waiting for the estimator to judge the report of')
    assert len(mission.paths) == 1
    mission.show_belief()
    assert mission.until_sent(1) == mission.planned()

    report = mission.lose(1)
    mission.reports.publish(report)
    mission.reports.publish(report)
    mission.until_state('waiting for the estimator to judge the report of')
    mission.show_standings()
    mission.until_state('waiting for a belief that holds all that counts on /belief')
    assert len(mission.paths) == 2
    mission.show_belief()
    assert mission.until_sent(2) == mission.planned()

    mission.reports.publish(mission.lose(2))
    mission.show_belief()
    mission.until_state('done: 3 of 3 robots deployed')
    assert len(mission.paths) == 3


def test_paths_are_planned_with_the_robot_types_of_the_belief(field):
    """Its model and robot types differ from the defaults of the parameters."""
    prior, model = Belief.prior(GRID, 0.5, 0.45, 0.8), SensorModel(0.9, malfunction=0.2)
    frail = RobotType(malfunction=0.4)
    mission = Mission(field, {'robots': 1})
    mission.ledger = Ledger(GRID, 4, Estimator(prior, model), {'scout_1': frail})
    mission.show_belief()
    path = mission.until_sent(0)
    options = SearchOptions(max_steps=4)
    assert path == plan(GRID, prior, frail.model(model), options).path.tolist()
    assert path != plan(GRID, prior, MODEL, options).path.tolist()


def test_beliefs_of_other_bases_and_of_too_many_cameras_are_refused(field):
    agents = [f'scout_{number}' for number in range(1, 8)]
    mission = Mission(field, {'robots': 7, 'agents': agents, 'team.scout_2.base': 8})
    grid = Grid(3, 3, other_bases=(8,))
    estimator = Estimator(Belief.prior(grid, 0.5, 0.45, 0.8), MODEL)
    mission.ledger = Ledger(grid, 4, estimator, {'scout_1': RobotType(base=8)})
    mission.show_belief()
    told = field.until_refused('/planner', 1)
    assert 'the base of scout_1 is 8 for the estimator, which would refuse paths' in told
    assert ' from another base, but 0 for this planner' in told
    cameras = {agent: RobotType(true_positive=0.8 + n / 100) for n, agent in enumerate(agents)}
    cameras['scout_2'] = RobotType(true_positive=0.7, base=8)
    mission.ledger = Ledger(grid, 4, estimator, cameras)
    mission.show_belief()
    assert '7 different cameras' in field.until_refused('/planner', 2)


def test_the_first_path_waits_for_its_readers_and_a_mission_may_be_empty(field):
    mission = Mission(field, {'await_nodes': ['test', 'onlooker'], 'robots': 0})
    mission.show_belief()
    mission.until_state('done: 0 of 0 robots deployed')
    assert field.set_parameter('/planner', 'robots', 1).successful
    mission.until_state('waiting for onlooker to subscribe to /scout_1/path')
    assert not mission.paths
    onlooker = rclpy.create_node('onlooker', context=field.node.context)
    onlooker.create_subscription(Path, '/scout_1/path', lambda _: None, qos.EVIDENCE)
    mission.until_sent(0)
    onlooker.destroy_node()


def test_bad_beliefs_are_refused_and_counted(field):
    mission = Mission(field, {})
    prior = belief_maps(mission.ledger, 0)
    wider = belief_maps(
        Ledger(Grid(4, 3), 4, Estimator(Belief.prior(Grid(4, 3), 0.5, 0.45, 0.8), MODEL)), 0
    )
    cases = [
        (in_frame(prior, 'odom'), "header.frame_id is 'odom': it must be 'map'"),
        (wider, 'its grid is Grid(width=4'),
        (changed(prior, max_steps=3), 'max_steps of scout_1 is 3 for the estimator'),
        (changed(prior, joint=[float('nan')] * 36), 'joint of cell 0'),
        (changed(prior, deployments=2), "agent is ''"),
    ]
    for count, (message, told) in enumerate(cases, start=1):
        mission.beliefs.publish(message)
        assert told in field.until_refused('/planner', count)
    assert not mission.paths
    unnamed = report_message(DeploymentKey('', 0), Observation([0, 0], False), 0)
    mission.reports.publish(unnamed)
    assert "agent is ''" in field.until_refused('/planner', len(cases) + 1)
    mission.show_belief()
    assert mission.until_sent(0) == mission.planned()


def test_a_restarted_planner_keeps_the_path_of_a_robot_in_flight(field):
    mission = Mission(field, {'robots': 3})
    mission.show_belief()
    mission.until_sent(0)
    mission.reports.publish(mission.lose(0))
    mission.show_belief()
    mission.until_sent(1)
    field.kill('/planner')
    field.start('planner', {**PARAMETERS, 'robots': 3})
    mission.until_sent(2)
    assert mission.paths[2] == mission.paths[1]
    mission.reports.publish(mission.lose(1))
    mission.show_belief()
    assert mission.until_sent(3) == mission.planned()
    stamps = [from_stamp(path.header.stamp) for path in mission.paths]
    assert stamps[0] < stamps[1] == stamps[2] < stamps[3]


SILENT = {
    'silent_loss': True,
    'step_period': 0.001,
    'return_deadline': 0.3,
    'presume_departure': True,
}


def test_a_robot_whose_path_is_not_recorded_is_not_given_up(field):
    agents = ['scout_1', 'scout_2']
    paths = {agent: field.listen(Path, f'/{agent}/path') for agent in agents}
    reports = {agent: field.listen(DeploymentReport, f'/{agent}/report') for agent in agents}
    recorded = {
        agent: field.node.create_publisher(Recorded, f'/{agent}/recorded', qos.EVIDENCE)
        for agent in agents
    }
    field.node.create_publisher(DeploymentReport, '/scout_2/report', qos.EVIDENCE)
    mission = Mission(field, {**SILENT, 'agents': agents, 'robots': 2, 'recorded': True})
    mission.show_belief()
    field.until(lambda: all(paths.values()), 'paths')
    mission.until_state('waiting for the report of scout_1')
    # The other robot left later than this one would have, so it is given up no sooner.
    recorded['scout_2'].publish(on_disk(paths['scout_2'][0]))
    field.until(lambda: reports['scout_2'], 'loss of the robot that left')
    told = field.diagnosed_at('/planner')
    field.until(lambda: field.diagnosed_at('/planner') > told, 'newer diagnostics')
    assert 'waiting for the report of scout_1' in field.state('/planner')
    assert not reports['scout_1']
    recorded['scout_1'].publish(on_disk(paths['scout_1'][0]))
    field.until(lambda: reports['scout_1'], 'loss of the other one')


def test_a_pending_report_prevents_giving_up_its_robot(field, monkeypatch, request):
    paths = field.listen(Path, '/scout_1/path')
    reports = field.listen(DeploymentReport, '/scout_1/report')
    agent = field.node.create_publisher(DeploymentReport, '/scout_1/report', qos.EVIDENCE)
    beliefs = field.node.create_publisher(BeliefMaps, '/belief', qos.LATCHED)
    judged = field.node.create_publisher(Standings, '/standings', qos.STANDINGS)
    ledger = Ledger(GRID, 4, Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), MODEL))
    judged.publish(standings(ledger, author='/test/test'))
    beliefs.publish(belief(ledger, 0))
    # The planner is in the test, with a clock of the test in nanoseconds.
    clock = [1]
    for name in ('now', 'elapsed'):
        monkeypatch.setattr(PlannerNode, name, lambda _: clock[-1])
    args = ['--ros-args', '--log-level', 'fatal']
    for name, value in {**PARAMETERS, **SILENT, 'robots': 3}.items():
        args += ['--param', f'{name}:={json.dumps(value)}']
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    request.addfinalizer(rclpy.try_shutdown)
    executor = SingleThreadedExecutor()
    executor.add_node(PlannerNode())

    def until(condition, what):
        field.until(lambda: executor.spin_once(timeout_sec=0.02) or condition(), what)

    until(lambda: paths, 'path')
    # Enough checks to see it leave. With another timeout the executor waits anew.
    for _ in range(20):
        executor.spin_once(timeout_sec=0.05)
    key, cells = read_path(GRID, 'scout_1', paths[0])
    report = report_message(key, Observation(cells, True, [True] * (len(cells) - 1)), 5)
    # After other work, a planner has two things to do: receive the report, check the clock.
    clock.append(10**10)
    agent.publish(report)
    assert agent.wait_for_all_acked(Duration(seconds=10))
    time.sleep(2 * POLL)
    ledger.record_path(key, cells)
    ledger.record_report(*read_report(report))
    judged.publish(standings(ledger, author='/test/test'))
    beliefs.publish(belief(ledger, 0))
    until(lambda: len(paths) == 2, 'next path')
    until(lambda: clock.append(clock[-1] + 10**9) or len(reports) == 2, 'loss of the next robot')
    assert [read_report(report)[0] for report in reports] == [
        read_path(GRID, 'scout_1', path)[0] for path in paths
    ]


def test_an_agent_that_is_none_of_the_team_is_refused_by_name(field):
    for topic in ('/other/scout_8/report', '/scout_9/report'):
        field.node.create_publisher(DeploymentReport, topic, qos.EVIDENCE)
    mission = Mission(field, {'robots': 2})
    told = field.until_refused('/planner', 1)
    assert 'agent scout_9 is unknown' in told
    assert told.endswith('the parameter agents names scout_1')
    for number in range(2):
        mission.show_belief()
        mission.until_sent(number)
        mission.reports.publish(mission.lose(number))
    mission.show_belief()
    mission.until_state('done: 2 of 2 robots deployed')
    assert field.count('/planner', 'refused') == 1


def test_waiting_for_plans_is_stated_once(field):
    mission = Mission(field, {'robots': 2, 'step_period': 1e-9})
    for number in range(2):
        mission.show_belief()
        mission.until_sent(number)
        mission.reports.publish(mission.lose(number))
    said = field.said('/planner')
    assert said.count('planning took') == 1
    assert 'reduce beam_width, or set planner to relaxed' in said


def test_a_loss_that_the_model_rules_out_is_held_and_can_be_given_up(field):
    """The estimator refuses it, and the planner waits for nobody but the operator."""
    base = Base(field, robots=1, **{'prior.hazard': 0.0, 'sensor.malfunction': 0.0})
    told = field.listen(MissionStatus, '/mission')
    base.until_sent(1)
    sent, cells = read_path(FIVE_BY_FIVE, 'scout_1', base.paths['scout_1'][0])
    base.reports['scout_1'].publish(report_message(sent, Observation(cells, False), 1))
    base.until_state('the outcome is impossible under this belief and sensor model: allow')
    field.until(lambda: told and told[-1].held == 1, 'held deployment')
    assert told[-1].ends_by == MissionStatus.OPERATOR
    assert told[-1].out == 0
    assert 'impossible' in told[-1].reason
    answer = base.do('give_up', agent='scout_1')
    assert 'it counts as lost from now on' in answer
    field.until(lambda: told and told[-1].state == MissionStatus.DONE, 'end')
    assert (told[-1].lost, told[-1].held) == (1, 0)


AGENTS = ['scout_1', 'scout_2']
SEARCHING = 'waiting for the search for the paths of scout_1, scout_2 to end'


@pytest.fixture
def base(gate, field):
    """Return a base whose planner searches until the gate opens."""
    base = Base(field, AGENTS, planner='gated:search', recorded=False)
    base.until_state(SEARCHING)
    return base


def until_said(field, words):
    field.until(lambda: words in field.said('/planner'), words)


def test_a_pause_during_a_search_is_answered_and_no_robot_is_sent(gate, base):
    for data in (True, False, True, False, True):
        base.do('pause', data=data)
    field = base.field
    assert 'paths were found' not in field.said('/planner')
    gate.touch()
    kept = 'the plan for scout_1, scout_2 is ready, but robots cannot leave yet: '
    until_said(field, f'{kept}waiting for the operator')
    assert not any(base.paths.values())
    base.do('pause', data=False)
    for agent in AGENTS:
        field.until(lambda agent=agent: len(base.paths[agent]) == 1, f'path of {agent}')


def test_plans_by_other_parameters_are_discarded(gate, base):
    assert base.field.set_parameter('/planner', 'loss_cost', 1.0).successful
    gate.touch()
    until_said(base.field, 'discarding the plan for scout_1, scout_2')
    base.until_sent(1)
    base.do('end_mission')
    assert base.field.processes.stop(30)['/planner'] == 0


def test_a_pause_during_a_decision_is_answered(gate, field):
    gate.touch()
    goal = {'goal.kind': 'gated:lane', 'goal.cells': [24]}
    base = Base(field, ['scout_1'], recorded=False, **goal)
    paths, decisions = base.paths['scout_1'], field.listen(Decision, '/decision')
    field.until(lambda: paths and decisions, 'path')
    gate.unlink()
    base.come_back()
    base.until_held(1)
    base.do('pause')
    assert len(decisions) == 1
    gate.touch()
    field.until(lambda: len(decisions) == 2, 'decision')
    base.do('pause', data=False)
    field.until(lambda: len(paths) == 2, 'next path')


def test_a_path_that_never_leaves_the_base_is_not_sent(gate, field):
    base = Base(field, planner='gated:stay', recorded=False)
    base.until_state(
        'the planner gated:stay found the path [0, 0, 0, 0], which never leaves the base'
    )
    assert not base.paths['scout_1']
    assert field.set_parameter('/planner', 'planner', 'relaxed').successful
    base.until_sent(1)
    assert base.sent()[0][1] != 0


def test_plans_without_value_are_not_sent(field):
    progress = field.listen(Progress, '/progress')
    base = Base(field, loss_cost=1000.0)
    why = 'nothing is worth a robot: the best plan is expected to bring'
    field.until(lambda: progress and why in progress[-1].reason, 'why no robot leaves')
    assert progress[-1].state == Progress.RUNNING
    assert not base.paths['scout_1']
    assert field.set_parameter('/planner', 'loss_cost', 0.0).successful
    base.until_sent(1)
    base.come_back()
    base.until_sent(2)


def test_robots_keep_their_agent_s_distance_and_a_distance_below_a_step_is_refused(field):
    own = {'team.scout_2.max_distance': 2.0}
    base = Base(field, ['scout_1', 'scout_2'], max_distance=4.0, **own)
    for agent, longest in (('scout_1', 4.0), ('scout_2', 2.0)):
        base.until_sent(1, agent)
        (way,) = base.sent(agent)
        assert 0.0 < FIVE_BY_FIVE.path_length(np.array(way)) <= longest
    refused = field.set_parameter('/planner', 'max_distance', 1.5)
    assert not refused.successful
    assert 'max_distance is 1.5 m, which allows no step' in refused.reason
    assert 'it must be at least 2 m, or 0 for no limit' in refused.reason
    refused = field.set_parameter('/planner', 'planner', 'coverage')
    assert 'the planner coverage does not keep to it' in refused.reason
