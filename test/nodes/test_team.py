# SPDX-License-Identifier: Apache-2.0
"""Several agents, one planner and one estimator."""

from collections import Counter
import signal

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.configuration import estimator_of, grid_of
from kbnitp_ros.core import Ledger
from kbnitp_ros.messages.beliefs import read_belief_maps
from kbnitp_ros.messages.deployments import read_path, read_report
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import pytest
from tf2_msgs.msg import TFMessage
from unbroken import with_defaults

FIELD = {'grid.width': 5, 'grid.height': 4, 'max_steps': 8, 'planner': 'relaxed', 'seed': 2}


class Team:
    """A planner, an estimator and agents, and what is heard of them."""

    def __init__(self, field, agents, parameters, *, processes=False, own=None, namespace='/m'):
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
        given = {
            'planner': {'await_nodes': ['agent', 'estimator']},
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

    def assert_is_the_fold_of_its_reports(self):
        """See that the last belief is what core makes of the same paths and reports."""
        values = with_defaults(self.parameters)
        grid = grid_of(values)
        ledger = Ledger(grid, values['max_steps'], estimator_of(values, grid))
        for agent, paths in self.paths.items():
            for path in paths:
                ledger.record_path(*read_path(grid, agent, path))
        for key, report in self.told:
            ledger.record_report(key, report)
        assert len(ledger.deployments) == values['robots']
        believed = read_belief_maps(self.beliefs[-1]).belief
        assert believed.joint.tobytes() == ledger.belief.joint.tobytes()


@pytest.mark.parametrize('dynamics', ['static', 'used_up'])
def test_robots_leave_whenever_their_agent_is_free(field, dynamics):
    rolling = {'rolling': True, 'step_period': 0.02, 'robots': 30}
    team = Team(field, 3, {**rolling, 'method': 'kappa_bnitp', 'hazards.dynamics': dynamics})
    team.until_done()
    assert len(team.told) == len({key for key, _ in team.told}) == 30
    team.assert_is_the_fold_of_its_reports()
    # In rounds each would have ten.
    made = Counter(key.agent for key, _ in team.told)
    assert sum(made.values()) == 30
    assert min(made.values()) >= 5


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
