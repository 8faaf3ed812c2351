# SPDX-License-Identifier: Apache-2.0
"""A forged message does not end or stop a mission, and makes no node forget."""

from base import Base, GRID
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from kbnitp_msgs.msg import AgentState, Decision, MissionStatus, Standings
from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.deployments import read_path, report_message
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.states import Readiness, state_message
from kbnitp_ros.nodes.runtime import qos
from samples import changed

LANE = {'goal.kind': 'lane', 'goal.cells': [2], 'stop.confidence': 0.99, 'robots': 3}


class Goal(Base):
    """A base with a goal that its first robots do not reach."""

    def __init__(self, field, **parameters):
        self.decisions = field.listen(Decision, '/decision')
        self.told = field.listen(MissionStatus, '/mission')
        super().__init__(field, **{**LANE, **parameters})
        self.until_sent(1)

    def until_decided(self, deployments):
        self.field.until(
            lambda: self.decisions and self.decisions[-1].deployments == deployments,
            f'decision on {deployments}',
        )


def test_a_second_estimator_does_not_decide(field):
    base = Goal(field)
    field.set_aside('/estimator')
    heard = field.listen(Standings, '/standings')
    field.until(lambda: heard, 'standings')
    first = heard[-1].epoch
    # By its prior the goal is reached at once.
    own = {'prior.hazard': 0.001, 'await_nodes': ['planner']}
    field.start('estimator', {**base.parameters, **own})
    field.until(lambda: heard and heard[-1].epoch != first, 'standings of another')
    field.until(lambda: base.decisions[-1].reached, 'decision of another')
    words = '2 estimators publish standings, nodes /estimator, /estimator: the first one counts'
    field.until(lambda: words in field.said('/planner'), words)
    base.come_back()
    base.until_sent(2)
    assert base.told[-1].state == MissionStatus.RUNNING
    # Nor is it on record: a resumed planner follows the first one.
    field.until(lambda: words in field.said('/recorder'), words)
    assert {logged.said.epoch for _, logged in MissionLog(base.log).read('standings')} == {
        from_stamp(first)
    }
    field.kill('/estimator')
    field.kill('/planner')
    awaited = {'await_nodes': ['recorder', 'estimator']}
    field.start('planner', {**base.parameters, **awaited, 'resume': str(base.log)})
    base.come_back()
    base.until_state('done: 2 of 3 robots deployed: the goal lane is reached')


def test_a_forged_decision_does_not_end_a_mission(field):
    base = Goal(field, loss_cost=0.0)
    base.until_decided(0)
    true = base.decisions[-1]
    assert not true.reached
    stranger = field.node.create_publisher(Decision, '/decision', qos.LATCHED)
    base.come_back()
    base.until_decided(1)
    true = base.decisions[-1]
    for _ in range(3):
        heard = len(base.decisions)
        stranger.publish(changed(true, probability=1.0, reached=True, reason=''))
        field.until(
            lambda heard=heard: true in base.decisions[heard:], 'the decision of the estimator'
        )
    words = 'decision refused: another node contradicts this one, which repeats its message'
    field.until(lambda: words in field.said('/estimator'), words)
    base.until_sent(2)
    assert base.told[-1].state == MissionStatus.RUNNING


def test_forged_states_stop_nobody_for_long(field):
    grid = {'grid.width': 3, 'grid.height': 3}
    given = {**grid, 'max_steps': 6, 'robots': 6, 'agents': ['scout_1', 'scout_2']}
    base = field.node.create_publisher(AgentState, '/state', qos.LATCHED)
    agent = field.node.create_publisher(AgentState, '/scout_1/state', qos.LATCHED)
    said = {name: field.listen(AgentState, name) for name in ('/state', '/scout_1/state')}
    field.start_mission(given)
    field.until(lambda: all(said.values()), 'states')
    other, now = Grid(4, 3), field.now()
    base.publish(state_message(other, '', Readiness.READY, '', False, now))
    agent.publish(state_message(other, 'scout_1', Readiness.WAITING, 'nothing', True, now))
    own = Grid(3, 3).id
    for name, heard in said.items():
        field.until(lambda heard=heard: heard[-1].field_id == own, f'{name} said again')
    field.until(lambda: field.state('/planner') == 'done: 6 of 6 robots deployed', 'end')
    for name, node in (('state', '/planner'), ('scout_1/state', '/agent')):
        words = f'{name} refused: another node contradicts this one, which repeats its message'
        field.until(lambda words=words, node=node: words in field.said(node), words)


def test_diagnostics_that_name_a_node_change_nothing(field):
    told = field.listen(MissionStatus, '/mission')
    base = Base(field, robots=3)
    base.until_sent(1)
    key, cells = read_path(GRID, 'scout_1', base.paths['scout_1'][0])
    base.reports['scout_1'].publish(report_message(key, Observation(cells, False), 1))
    base.until_sent(2)
    # The path may be read before the status that was published before it.
    field.until(lambda: told[-1].lost == 1, 'loss')
    publisher = field.node.create_publisher(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
    words = f'report of deployment {key} is impossible under this belief and sensor model'
    values = [KeyValue(key='state', value=words), KeyValue(key='refused', value='9')]
    for name in ('/estimator', '/recorder', '/planner', '/agent'):
        status = DiagnosticStatus(level=b'\2', name=name, message=words, values=values)
        publisher.publish(DiagnosticArray(status=[status]))
    base.come_back()
    base.until_sent(3)
    base.come_back()
    field.until(lambda: told and told[-1].state == MissionStatus.DONE, 'end')
    assert (told[-1].ordered, told[-1].lost, told[-1].held) == (3, 1, 0)


def test_parameters_that_an_operator_set_outlast_a_crash(field):
    base = Base(field, robots=4, loss_cost=0.0, **{'prior.hazard': 0.3})
    base.until_sent(1)
    for name, value in (('minimum_survival', 0.97), ('loss_cost', 0.01)):
        assert field.set_parameter('/planner', name, value).successful
    base.come_back()
    base.until_held(1)
    base.until_state('done: 1 of 4 robots deployed: no path')
    base.crash()
    # The state may still be that of the killed planner.
    for value in ('minimum_survival is 0.97', 'loss_cost is 0.01'):
        words = f'parameter {value}, as the operator had set'
        field.until(lambda words=words: words in field.said('/planner'), words)
    base.until_state('done: 1 of 4 robots deployed: no path')
    assert len(base.sent()) == 1
    # What is given at a start and differs from what was given before counts.
    field.kill('/planner')
    own = {**base.parameters, 'minimum_survival': 0.2, 'resume': str(base.log)}
    field.start('planner', {**own, 'await_nodes': ['recorder', 'estimator']})
    base.until_sent(2)
    words = 'parameter minimum_survival is 0.2, as given at this start, and not 0.97'
    assert words in field.said('/planner')
    assert base.replayed().evidence.operator.settings['loss_cost'] == 0.01


def test_the_confidence_of_the_estimator_is_that_of_the_planner(field):
    base = Goal(field, **{'stop.confidence': 0.99, 'goal.cells': [24]})
    base.until_decided(0)
    assert not base.decisions[-1].reached
    assert field.set_parameter('/planner', 'stop.confidence', 0.3).successful
    words = 'stop.confidence is 0.3, as for the planner'
    field.until(lambda: words in field.said('/estimator'), words)
    field.until(lambda: base.decisions[-1].reached, 'decision by the new confidence')
    base.come_back()
    base.until_state('done: 1 of 3 robots deployed: the goal')
