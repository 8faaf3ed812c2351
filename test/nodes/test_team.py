# SPDX-License-Identifier: Apache-2.0
"""Several agents, one planner and one estimator."""

from __future__ import annotations

from collections import Counter
import math
import signal

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.bag import read_log
from kbnitp_ros.cli.report import main as report_on
from kbnitp_ros.configuration import estimator_of, grid_of
from kbnitp_ros.core import Ledger
from kbnitp_ros.log.configuration import read_parameters
from kbnitp_ros.log.history import read_history
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_path, read_report
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.report import curves_of, read_mission
from laws import for_each
from mcap.reader import make_reader
from nav_msgs.msg import Path
from pyarrow import parquet
import pytest
from tf2_msgs.msg import TFMessage
from unbroken import core_mission, with_defaults

FIELD = {'grid.width': 5, 'grid.height': 4, 'max_steps': 8, 'planner': 'relaxed', 'seed': 2}


class Team:
    """A planner, an estimator and agents, and what is heard of them."""

    def __init__(
        self, field, agents, parameters, *, processes=False, own=None, namespace='/m', log=None
    ):
        self.field = field
        self.agents = [f'scout_{number}' for number in range(1, agents + 1)]
        self.parameters = {**FIELD, **parameters, 'agents': self.agents}
        self.namespace = namespace
        self.beliefs = field.listen(BeliefMaps, f'{namespace}/belief')
        self.paths = {
            agent: field.listen(Path, f'{namespace}/{agent}/path') for agent in self.agents
        }
        self.reports = {
            agent: field.listen(DeploymentReport, f'{namespace}/{agent}/report')
            for agent in self.agents
        }
        recorder = ['recorder'] if log else []
        if log:
            field.start('recorder', {**self.parameters, 'file': str(log)}, namespace)
        given = {
            'planner': {'await_nodes': ['agent', 'estimator', *recorder]},
            'estimator': {'await_nodes': ['planner']},
            'agent': {'await_nodes': ['planner', 'estimator']},
        }
        for node in ('estimator', 'planner'):
            field.start(node, self.parameters | given[node], namespace)
        playing = self.parameters | given['agent'] | (own or {})
        if processes:
            for agent in self.agents:
                field.start('agent', playing | {'agent': agent}, f'{namespace}/{agent}')
        else:
            field.start('agent', playing, namespace)

    def until_done(self, patience=180):
        """Wait until the planner says that all robots are deployed."""
        planner = f'{self.namespace}/planner'
        self.field.until(lambda: 'done' in self.field.state(planner), 'end', patience)
        held = self.parameters['robots']
        self.field.until(
            lambda: self.beliefs and self.beliefs[-1].deployments == held, 'last belief'
        )
        # It may be heard before what it holds.
        self.field.until(lambda: len({key for key, _ in self.told}) == held, 'all reports')
        self.field.until(lambda: sum(map(len, self.paths.values())) >= held, 'all paths')

    @property
    def told(self):
        """Return all that was reported, in the order of the deployments."""
        reports = [read_report(report) for each in self.reports.values() for report in each]
        return sorted(reports, key=lambda item: (item[0].stamp, item[0].agent))

    def folded(self, reports):
        """Return the bits of the belief that core has after the paths and these reports."""
        values = with_defaults(self.parameters)
        grid = grid_of(values)
        ledger = Ledger(grid, values['max_steps'], estimator_of(values, grid))
        for agent, paths in self.paths.items():
            for path in paths:
                ledger.record_path(*read_path(grid, agent, path))
        for key, report in reports:
            ledger.record_report(key, report)
        assert len(ledger.deployments) == values['robots']
        return ledger.belief.joint.tobytes()

    @property
    def believed(self):
        """Return the bits of the last belief."""
        return read_belief_maps(self.beliefs[-1]).belief.joint.tobytes()

    def assert_is_the_fold_of_its_reports(self):
        """See that the last belief is what core makes of the same paths and reports."""
        assert self.believed == self.folded(self.told)


@pytest.mark.full
def test_eight_agents_in_eight_processes_make_the_mission_of_core(field):
    team = Team(field, 8, {'robots': 20, 'hazards.dynamics': 'used_up'}, processes=True)
    team.until_done()
    expected = core_mission(team.parameters)
    assert [report.survived for _, report in team.told] == [
        deployment.observation.survived for deployment in expected
    ]
    assert team.believed == expected[-1].belief.joint.tobytes()
    assert Counter(key.agent for key, _ in team.told) == {
        agent: 3 if number < 4 else 2 for number, agent in enumerate(team.agents)
    }
    team.assert_is_the_fold_of_its_reports()


@pytest.mark.full
def test_sixty_four_agents_in_one_process(field):
    size = {'grid.width': 9, 'grid.height': 9, 'allocation': 'independent'}
    team = Team(field, 64, {**size, 'robots': 100})
    team.until_done()
    assert len({key for key, _ in team.told}) == 100
    team.assert_is_the_fold_of_its_reports()


def test_robots_leave_whenever_their_agent_is_free(field):
    rolling = {'rolling': True, 'step_period': 0.02, 'robots': 30}
    team = Team(field, 3, {**rolling, 'method': 'kappa_bnitp'})
    team.until_done()
    assert len(team.told) == len({key for key, _ in team.told}) == 30
    team.assert_is_the_fold_of_its_reports()
    # In rounds each would have ten.
    made = Counter(key.agent for key, _ in team.told)
    assert sum(made.values()) == 30
    assert min(made.values()) >= 5


SILENT = {
    'silent_loss': True,
    'step_period': 0.001,
    'method': 'kappa_bnitp',
    'sensor.lethality': 0.9,
}


def test_every_silent_loss_is_declared_once_and_no_return_ever(field):
    team = Team(field, 4, {**SILENT, 'robots': 24, 'return_deadline': 1.0})
    team.until_done()
    expected = core_mission(team.parameters)
    assert Counter(key for key, _ in team.told).most_common(1)[0][1] == 1
    survived = [report.survived for _, report in team.told]
    assert survived == [deployment.observation.survived for deployment in expected]
    assert not all(survived)
    assert any(survived)
    assert team.believed == expected[-1].belief.joint.tobytes()


@pytest.mark.full
def test_a_robot_that_comes_back_late_is_as_if_it_had_never_been_given_up(field):
    """Eight robots at a time; the log is reported on."""
    late = {'return_deadline': 0.05, 'sensor.lethality': 0.2, 'robots': 16}
    log = field.folder / 'mission.mcap'
    own = {'step_period': 0.1, 'publish_truth': True}
    team = Team(field, 8, {**SILENT, **late}, own=own, log=log)
    returned = lambda: {key for key, report in team.told if report.survived}  # noqa: E731
    team.until_done()
    field.until(lambda: len(returned()) >= 3, 'late returns')
    given_up = {key for key, report in team.told if not report.survived}
    assert returned() <= given_up
    # Others come back meanwhile.
    field.until(
        lambda: (
            team.believed
            == team.folded((key, r) for key, r in team.told if r.survived or key not in returned())
        ),
        'belief in who is back',
    )
    assert set(field.processes.stop().values()) == {0}
    assert_is_reported(log)


def assert_is_reported(log):
    """See that a report tells all that was recorded of a team whose lost robots say nothing."""
    out = log.with_name('report')
    assert report_on([str(log), '--out', str(out)]) == 0
    table = parquet.read_table(out / 'deployments.parquet').to_pylist()
    assert {row['outcome'] for row in table} == {'returned', 'lost'}
    mission = read_mission(log)
    curves = curves_of(mission)
    late = [each for each in mission.moments if each.is_late]
    assert len(mission.moments) == 1 + len(table) + len(late) == 17 + len(late)
    assert late
    assert all(each.outcome.survived for each in late)
    assert {mission.deployments[each.deployment].key for each in late} <= {
        deployment.key for deployment in mission.deployments if deployment.outcome.survived
    }
    progress = [each.message for each in read_log(log) if each.topic == '/m/progress']
    assert_goes_with(progress, read_history(log), curves)
    # Of two records of one name, none has a key of the other.
    keys = [(record.name, key) for record in metadata_records(log) for key in record.metadata]
    assert len(keys) == len(set(keys))
    assert {'/m/planner', '/m/agent', '/m/estimator'} <= read_parameters(log).keys()


def assert_goes_with(progress, history, curves):
    """See that the numbers told while a mission ran are those of the beliefs on record."""
    moments = {each.snapshot.stamp: place for place, each in enumerate(history.heard)}
    assert {from_stamp(each.header.stamp) for each in progress} <= moments.keys()
    for message in progress:
        moment = moments[from_stamp(message.header.stamp)]
        assert message.deployments == history.heard[moment].snapshot.deployments
        assert message.lost == curves.lost[moment]
        for name in ('hazard_entropy', 'target_entropy', 'joint_entropy'):
            assert getattr(message, name) == getattr(curves, name)[moment]
        for name in ('expected', 'gained'):
            told = getattr(message, f'information_{name}')
            assert told == pytest.approx(getattr(curves, name)[moment], nan_ok=True)
    # The truth is published once, and may come after the prior.
    scored = [each for each in progress if not math.isnan(each.hazard_log_loss)]
    assert from_stamp(scored[-1].header.stamp) == history.heard[-1].snapshot.stamp
    for message in scored:
        moment = moments[from_stamp(message.header.stamp)]
        assert message.hazard_log_loss == curves.hazard_loss[moment]
        assert message.target_log_loss == curves.target_loss[moment]
    # Eight are in flight at once.
    assert max(message.out for message in progress) == 8


def metadata_records(log):
    """Return the records of named values in a file."""
    with log.open('rb') as file:
        return list(make_reader(file).iter_metadata())


def test_a_team_carries_on_when_an_agent_leaves(field):
    team = Team(field, 3, {'robots': 20_000, 'step_period': 0.01}, processes=True)
    field.until(lambda: all(len(each) > 2 for each in team.reports.values()), 'reports')
    gone = field.processes.started.pop('/m/scout_2/agent')
    gone.send_signal(signal.SIGINT)
    assert gone.wait(timeout=60) == 0
    field.until(lambda: field.count('/m/planner', 'refused') == 1, 'word of the agent gone')
    assert 'agent scout_2 has left' in field.diagnosed('/m/planner').message

    def others_report():
        before = {agent: len(team.reports[agent]) for agent in ('scout_1', 'scout_3')}
        field.until(
            lambda: all(len(team.reports[agent]) > made + 3 for agent, made in before.items()),
            'reports of the others',
        )

    # What the agent reported last may still be on its way.
    others_report()
    of_gone = len(team.reports['scout_2'])
    others_report()
    assert len(team.reports['scout_2']) == of_gone


@for_each(
    'node, parameters, told',
    [
        ('planner', {'agents': ['a', 'b', 'a']}, "agents is ['a', 'b', 'a']"),
        ('agent', {'agents': [f's{n}' for n in range(21)]}, 'one for each of the 20 free cells'),
        ('agent', {'agent': 'scout_2'}, 'agent is scout_2: it must be one of agents, scout_1'),
        ('planner', {'return_deadline': 0.0}, 'return_deadline is 0.0'),
        ('planner', {'return_deadline': -1.0}, 'return_deadline is -1.0'),
        ('planner', {'loss_cost': -1.0}, 'loss_cost is -1.0'),
        ('planner', {'allocation': 'magic'}, "allocation is 'magic'"),
    ],
)
def test_teams_that_cannot_be_are_refused(field, node, parameters, told):
    process = field.start(node, {**FIELD, **parameters})
    assert process.wait(timeout=60) == 2
    assert told in field.said(f'/{node}')


def test_an_agent_that_answers_for_another_is_refused(field):
    team = Team(field, 2, {'robots': 4})
    team.until_done()
    imposter = field.node.create_publisher(DeploymentReport, '/m/scout_2/report', qos.EVIDENCE)
    field.until(lambda: imposter.get_subscription_count() > 1, 'listeners')
    field.until(lambda: field.count('/m/planner', 'refused') == 1, 'word of two nodes')
    assert '2 nodes answer for agent scout_2' in field.diagnosed('/m/planner').message
    for name in ('scout_1', 'scout_9'):
        report = DeploymentReport(agent=name)
        report.header.frame_id = 'map'
        imposter.publish(report)
    field.until(lambda: field.count('/m/estimator', 'refused') == 2, 'refusals')
    assert "agent is 'scout_9': on this topic it must be 'scout_2'" in (
        field.diagnosed('/m/estimator').message
    )
    team.assert_is_the_fold_of_its_reports()


@pytest.mark.full
def test_two_teams_do_not_meet(field):
    teams = [
        Team(field, agents, {'robots': 9, 'seed': agents}, namespace=f'/team_{agents}')
        for agents in (2, 3)
    ]
    for team in teams:
        team.until_done()
        expected = core_mission(team.parameters)
        joint = read_belief_maps(team.beliefs[-1]).belief.joint
        assert joint.tobytes() == expected[-1].belief.joint.tobytes()


def test_a_team_in_a_namespace_called_like_an_agent_has_its_topics_below_it(field):
    team = Team(field, 2, {'robots': 4}, namespace='/scout_1')
    team.until_done()
    assert Counter(key.agent for key, _ in team.told) == {'scout_1': 2, 'scout_2': 2}
    team.assert_is_the_fold_of_its_reports()


def test_robots_that_are_out_are_shown_only_on_request(field):
    shown = field.listen(TFMessage, '/tf', volatile=True)
    parameters = {'robots': 4, 'step_period': 0.02, 'sensor.malfunction': 0.0}
    hidden = Team(field, 2, parameters)
    hidden.until_done()
    assert not shown
    seen = Team(field, 2, parameters, own={'publish_pose': True}, namespace='/seen')
    seen.until_done()
    poses = [pose for message in shown for pose in message.transforms]
    assert {pose.header.frame_id for pose in poses} == {'map'}
    assert {pose.child_frame_id for pose in poses} == {
        'scout_1/base_link',
        'scout_2/base_link',
    }
    first = poses[0].transform.translation
    assert (first.x, first.y) == (0.5, 0.5)
    on_paths = {
        (pose.pose.position.x, pose.pose.position.y)
        for paths in seen.paths.values()
        for path in paths
        for pose in path.poses
    }
    walked = {(each.transform.translation.x, each.transform.translation.y) for each in poses}
    assert walked <= on_paths
    assert len(walked) > 2
