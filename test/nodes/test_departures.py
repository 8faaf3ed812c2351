# SPDX-License-Identifier: Apache-2.0
"""Silent robots at their base count as no evidence, and a pause keeps robots there."""

import os
import time

from bare_dds import BareParticipant, not_utf8
from base import Base, GRID
from extent import some
from kbnitp_msgs.msg import AgentStatus, DeploymentReport, Progress, Recorded
from kbnitp_ros.core import DeploymentKey, Observation
from kbnitp_ros.log.write import LogWriter
from kbnitp_ros.messages.deployments import OrderState, read_path, report_message, status_message
from kbnitp_ros.messages.headers import content_hash, from_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import pytest
import rclpy
from rclpy.serialization import serialize_message
from samples import FIELD, key, on_disk, path
from std_msgs.msg import Bool

SILENT = {
    'silent_loss': True,
    'step_period': 0.001,
    'return_deadline': 1.0,
    'presume_departure': False,
}


class StatedBase(Base):
    """A base that takes silence for loss; the test plays agents that state departures."""

    def __init__(self, field, agents=('scout_1',), fields=None, **parameters):
        self.statuses = {
            agent: field.node.create_publisher(AgentStatus, f'/{agent}/status', qos.EVIDENCE)
            for agent in agents
        }
        for agent in agents:
            # Before any departure, whatever the clock of the base.
            field.stand(agent, (fields or {}).get(agent, GRID), stamp=1)
        self.holds = field.listen(Bool, '/hold')
        self.progress = field.listen(Progress, '/progress')
        super().__init__(field, agents, **{**SILENT, **parameters})

    def say(self, state, reason='', agent='scout_1', stamp=None):
        """Publish the status of the newest order; return the message."""
        key = max(read_path(GRID, agent, path)[0] for path in self.paths[agent])
        message = status_message(key, state, key.stamp if stamp is None else stamp, reason)
        self.statuses[agent].publish(message)
        return message

    def until_named(self, message, agent='scout_1'):
        content = content_hash(message)
        self.field.until(
            lambda: content in [each.content for each in self.acknowledged[agent]], 'record'
        )


def test_a_robot_at_its_base_is_never_lost(field):
    base = StatedBase(field, robots=2, silent_loss=False)
    base.until_sent(1)
    base.say(OrderState.ACCEPTED)
    base.until_state('which its agent reports on /scout_1/status')
    key, cells = read_path(GRID, 'scout_1', base.paths['scout_1'][-1])
    base.reports['scout_1'].publish(report_message(key, Observation(cells, False), key.stamp + 1))
    awaited = 'a loss counts once scout_1 reports the departure on /scout_1/status'
    base.until_state(awaited)
    base.crash()
    base.until_state(awaited)
    base.until_named(base.say(OrderState.DEPARTED))
    base.come_back()
    base.until_held(1)
    base.until_sent(2)
    assert base.replayed().evidence.survived == 1


def test_only_robots_that_departed_are_lost_and_refused_orders_are_sent_again(field):
    base = StatedBase(field, robots=2)
    base.until_sent(1)
    # Neither silence nor acceptance is a departure, however long it lasts.
    base.say(OrderState.ACCEPTED)
    base.until_state('which its agent reports on /scout_1/status')
    told = base.refused('give_up', agent='scout_1', steps_survived=0)
    assert 'has not departed: its agent says on scout_1/status that its robot is at' in told
    # Longer than the deadline after a departure.
    begun = field.diagnosed_at('/planner')
    field.until(lambda: field.diagnosed_at('/planner') > begun + 2 * 10**9, 'two seconds')
    assert not base.heard['scout_1']
    assert 'leaves for' not in field.said('/planner')
    base.say(OrderState.REFUSED, 'the battery is low')
    base.until_sent(2)
    assert 'so its robot stays at the base: the battery is low' in field.said('/planner')
    base.until_named(base.say(OrderState.DEPARTED))
    field.until(lambda: base.heard['scout_1'], 'loss')
    base.until_held(1)
    newest = read_path(GRID, 'scout_1', base.paths['scout_1'][1])[0]
    assert [from_stamp(each.deployment) for each in base.heard['scout_1']] == [newest.stamp]
    assert f'{newest} leaves for' in field.said('/planner')
    field.until(lambda: base.progress[-1].out == 0, 'nobody to be out')
    assert max(each.out for each in base.progress) <= 1
    # After any crash, the refused order is none of the mission's deployments.
    base.until_sent(3)
    base.until_named(base.paths['scout_1'][-1])
    base.crash()
    # The log has two orders that count: the planner resends them, and no third.
    base.until_named(base.say(OrderState.DEPARTED))
    base.until_held(2)
    base.until_state('done: 2 of 2')
    report = base.replayed()
    assert report.evidence.ended == 2
    (refused,) = report.evidence.without_report
    assert report.evidence.void == {refused}
    assert report.evidence.status(refused).reason == 'the battery is low'


@pytest.mark.full
@pytest.mark.interpreter
def test_deadlines_start_with_recorded_departures_under_any_clock(system_clock, field):
    """The base starts with a clock of years ago, gets the present time, and loses it again."""
    deadline = 8.0
    system_clock.touch()
    base = StatedBase(field, robots=2, return_deadline=deadline)
    for number, change in enumerate((system_clock.unlink, system_clock.touch), start=1):
        base.until_sent(number)
        base.until_named(base.paths['scout_1'][-1])
        field.kill('/recorder')
        departure = base.say(OrderState.DEPARTED)
        waited = time.monotonic() + deadline + 1.0
        field.until(lambda end=waited: time.monotonic() > end, 'end of its deadline')
        # It does not move before that is on disk.
        assert len(base.heard['scout_1']) == number - 1
        begun = time.monotonic()
        field.start('recorder', {**base.parameters, 'resume': str(base.log)})
        base.until_named(departure)
        change()
        field.until(lambda n=number: len(base.heard['scout_1']) == n, 'loss')
        assert time.monotonic() > begun + deadline
    base.until_state('done: 2 of 2')
    assert len(base.replayed().evidence.standings) == 2


def test_bad_statuses_are_refused_by_name_and_counted(field):
    base = StatedBase(field, robots=1, return_deadline=1000.0)
    base.until_sent(1)
    key = read_path(GRID, 'scout_1', base.paths['scout_1'][0])[0]
    unknown = status_message(DeploymentKey('scout_1', 5), OrderState.DEPARTED, 6)
    base.statuses['scout_1'].publish(unknown)
    assert ': this planner has not sent it' in field.until_refused('/planner', 1)
    other = status_message(DeploymentKey('scout_2', key.stamp), OrderState.DEPARTED, 6)
    base.statuses['scout_1'].publish(other)
    assert "agent is 'scout_2': on this topic" in field.until_refused('/planner', 2)
    field.until(lambda: field.count('/recorder', 'refused') == 1, 'refusal by the recorder')
    # A report that does not fit the path blocks no departure.
    jump = Observation([0, GRID.cells - 1, 0], True, [False, False])
    base.reports['scout_1'].publish(report_message(key, jump, 1))
    assert 'path jumps at step 1' in field.until_refused('/planner', 3)
    base.until_named(base.say(OrderState.DEPARTED))
    base.say(OrderState.DEPARTED, stamp=key.stamp + 1)
    assert f'another departure of deployment {key} counts' in field.until_refused('/planner', 4)
    base.say(OrderState.REFUSED, 'too late', stamp=key.stamp + 1)
    told = field.until_refused('/planner', 5)
    assert 'was refused by its agent and has departed, which counts' in told
    # Only the first departure is confirmed to be on disk.
    acknowledged = base.acknowledged['scout_1']
    departures = [each for each in acknowledged if each.kind == Recorded.DEPARTURE]
    assert len({(each.stamp.sec, each.content) for each in departures if each.stamp.sec}) == 1
    base.come_back()
    base.until_state('done: 1 of 1')
    # A duplicate is not news.
    base.say(OrderState.DEPARTED)
    field.talk(Bool, '/hold', qos.LATCHED).publish(Bool(data=True))
    assert 'hold refused: another node contradicts this one' in field.until_refused('/planner', 6)
    assert base.beliefs[-1].deployments == 1


def test_a_pause_holds_before_it_is_recorded_and_against_strangers(field):
    base = StatedBase(field)
    field.until(lambda: [each.data for each in base.holds] == [False], 'word that none is held')
    base.until_sent(1)
    field.kill('/recorder')
    base.clients['pause'].wait_for_service(10.0)
    answer = base.clients['pause'].call_async(base.clients['pause'].srv_type.Request(data=True))
    field.until(lambda: base.holds[-1].data, 'hold')
    assert not answer.done()
    # Not on disk, but not over.
    told = base.refused('pause', data=False)
    assert told.endswith(': call again after that')
    base.until_state(
        'waiting for the recorder to confirm the action "the operator paused the mission" on '
        '/operator/recorded (parameter recorded)'
    )
    field.start('recorder', {**base.parameters, 'resume': str(base.log)})
    field.until(answer.done, 'answer')
    stranger = field.node.create_publisher(Bool, '/hold', qos.LATCHED)
    # Before or after the planner's graph lists its publisher.
    stranger.publish(Bool(data=False))
    why = 'hold refused: another node contradicts this one, which repeats its message: nodes'
    field.until(lambda: f'{why} /planner, /test/test publish it' in field.said('/planner'), why)
    field.until(lambda: base.holds[-1].data, 'the planner to say it again')
    base.crash()
    # The resumed planner knows that the mission is paused.
    base.do('pause', data=False)
    field.until(lambda: not base.holds[-1].data, 'end of the pause')
    # While the graph cannot be read, publishers are unknown.
    bare = BareParticipant(int(os.environ['ROS_DOMAIN_ID']))
    bare.announce('rt/hold', not_utf8('std_msgs::msg::é'))
    field.until(lambda: 'is not UTF-8' in field.said('/planner'), 'a graph that cannot be read')
    heard = len(base.holds)
    stranger.publish(Bool(data=True))
    field.until(lambda: [each.data for each in base.holds[heard:]] == [True, False], 'answer')
    bare.leave()
    why = 'hold refused: another node contradicts this one, which repeats its message: nodes'
    field.until(lambda: why in field.said('/planner'), 'name of the stranger')


def test_simulated_robots_stay_while_held_and_move_once_recorded(field):
    reports = field.listen(DeploymentReport, '/scout_1/report')
    statuses = field.listen(AgentStatus, '/scout_1/status')
    recorded = field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE)
    field.start('agent', {**FIELD, 'await_nodes': ['test'], 'recorded': True})
    holds = field.node.create_publisher(Bool, '/hold', qos.LATCHED)
    paths = field.talk(Path, '/scout_1/path')
    paths.publish(path(1))
    field.until(lambda: field.count('/agent', 'waiting') == 1, 'path')
    recorded.publish(on_disk(path(1)))
    field.until(lambda: statuses, 'acceptance')
    stranger = rclpy.create_node('stranger', context=field.node.context)
    for state, is_held in (
        ('the planner to publish on /hold', True),
        ('the operator to end the pause', False),
        ('all nodes but one to stop publishing /hold: /stranger, /test/test publish it', None),
    ):
        field.until(lambda state=state: state in field.state('/agent'), state)
        assert [status.state for status in statuses] == [OrderState.ACCEPTED]
        if is_held is True:
            stranger.create_publisher(Bool, '/hold', qos.LATCHED)
        if is_held is not None:
            holds.publish(Bool(data=is_held))
    stranger.destroy_node()
    field.until(lambda: len(statuses) == 2, 'departure')
    assert statuses[1].state == OrderState.DEPARTED
    assert not reports
    recorded.publish(on_disk(statuses[1]))
    field.until(lambda: reports, 'report')
    assert reports[0].deployment == path(1).header.stamp


@pytest.mark.parametrize('known_by', some(['log', 'recorder'], 2))
def test_a_pause_does_not_hold_a_simulated_robot_in_flight_at_a_restart(field, known_by):
    departed = status_message(key(1), OrderState.DEPARTED, key(1).stamp)
    log = field.folder / 'mission.mcap'
    with LogWriter(log) as writer:
        for topic, kind, message in (
            ('/scout_1/path', 'nav_msgs/msg/Path', path(1)),
            ('/scout_1/status', 'kbnitp_msgs/msg/AgentStatus', departed),
        ):
            writer.add_topic(topic, kind, '[]')
            writer.write(topic, serialize_message(message), 1, 1)
    reports = field.listen(DeploymentReport, '/scout_1/report')
    statuses = field.listen(AgentStatus, '/scout_1/status')
    field.node.create_publisher(Bool, '/hold', qos.LATCHED).publish(Bool(data=True))
    recorded = field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE)
    for message in (path(1), path(2), departed):
        recorded.publish(on_disk(message))
    resumed = {'resume': str(log)} if known_by == 'log' else {}
    field.start('agent', {**FIELD, 'await_nodes': ['test'], 'recorded': True, **resumed})
    paths = field.talk(Path, '/scout_1/path')
    for number in (1, 2):
        paths.publish(path(number))
    field.until(lambda: reports, 'report')
    field.until(lambda: field.count('/agent', 'waiting') == 1, 'the other robot to be held')
    assert [report.deployment for report in reports] == [path(1).header.stamp]

    def told():
        return {(from_stamp(status.deployment), status.state) for status in statuses}

    # The departure may be read after the report.
    field.until(lambda: (key(1).stamp, OrderState.DEPARTED) in told(), 'departure')
    assert (key(2).stamp, OrderState.DEPARTED) not in told()
