# SPDX-License-Identifier: Apache-2.0
"""Orders that the operator takes back before their robots have departed."""

import signal

from base import Base
from fleet import Fleet
from fleet import GRID as ARENA
from kbnitp_msgs.msg import AgentStatus, DeploymentReport, OperatorAction, Recorded
from kbnitp_ros.configuration.starts import awaited_nodes
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.deployments import OrderState
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.operator_actions import Action, operator_action_message
from kbnitp_ros.messages.operator_actions import OperatorAction as Decided
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
from samples import FIELD, GRID, HOME, key, on_disk, path
from std_msgs.msg import Bool
from test_departures import StatedBase
from test_operator import typed
import yaml

SAID = 'taken back by Ann: no longer needed'


def taken_back(deployment, cells=HOME, grid=GRID):
    said = {'reason': 'no longer needed', 'author': 'Ann'}
    action = Decided(deployment.stamp + 1, Action.TAKE_BACK, 0, {deployment: cells}, **said)
    return operator_action_message(grid, action)


def states(statuses):
    """Return the states and reasons of each order, by its stamp."""
    said = {}
    for status in statuses:
        order = said.setdefault(from_stamp(status.deployment), [])
        order.append((status.state, status.reason))
    return said


def test_a_simulated_agent_refuses_what_is_taken_back_before_its_departure(field):
    # The agent waits for a reader.
    field.listen(DeploymentReport, '/scout_1/report')
    statuses = field.listen(AgentStatus, '/scout_1/status')
    recorded = field.node.create_publisher(Recorded, '/scout_1/recorded', qos.EVIDENCE)
    holds = field.node.create_publisher(Bool, '/hold', qos.LATCHED)
    holds.publish(Bool(data=True))
    parameters = {**FIELD, 'await_nodes': ['test'], 'recorded': True}
    field.start('agent', parameters)
    paths, actions = field.talk(Path, '/scout_1/path'), field.talk(OperatorAction, '/operator')
    for number in (1, 2):
        paths.publish(path(number))
        recorded.publish(on_disk(path(number)))
    field.until(lambda: len(statuses) == 2, 'acceptances')
    actions.publish(taken_back(key(1)))
    field.until(lambda: len(statuses) == 3, 'refusal')
    holds.publish(Bool(data=False))
    field.until(lambda: len(statuses) == 4, 'departure')
    holds.publish(Bool(data=True))
    paths.publish(path(3))
    recorded.publish(on_disk(path(3)))
    # Too late for the second one.
    for number in (2, 3):
        actions.publish(taken_back(key(number)))
    field.until(lambda: len(statuses) == 6, 'refusal')
    accepted, departed = (OrderState.ACCEPTED, ''), (OrderState.DEPARTED, '')
    refused = (OrderState.REFUSED, SAID)
    assert states(statuses) == {
        key(1).stamp: [accepted, refused],
        key(2).stamp: [accepted, departed],
        key(3).stamp: [accepted, refused],
    }
    # An order that arrives after it was taken back, at an agent that is restarted.
    actions.publish(taken_back(key(4)))
    field.kill('/agent')
    holds.publish(Bool(data=False))
    paths.publish(path(4))
    recorded.publish(on_disk(path(4)))
    field.start('agent', parameters)
    field.until(lambda: refused in states(statuses).get(key(4).stamp, ()), 'refusal')
    said = states(statuses)
    assert said[key(4).stamp] == [accepted, refused]
    # What is said again is the same message.
    for number in (1, 3):
        assert said[key(number).stamp] == 2 * [accepted, refused]
        told = [each for each in statuses if from_stamp(each.deployment) == key(number).stamp]
        assert told[:2] == told[2:]


def test_a_robot_refuses_what_is_taken_back_also_with_a_new_journal(field):
    fleet = Fleet(field)
    said, reports = fleet.statuses['scout_1'], fleet.reports()
    actions = field.node.create_publisher(OperatorAction, '/operator', qos.EVIDENCE)
    # Without a place it does not leave.
    fleet.start()
    orders = [0, 1, 0]
    sent = {}

    def until_said(number, *wanted):
        field.until(lambda: states(said).get(sent[number].stamp) == [*wanted], f'{wanted}')

    def take_back(number):
        actions.publish(taken_back(sent[number], orders, ARENA))

    accepted, refused = (OrderState.ACCEPTED, ''), (OrderState.REFUSED, SAID)
    sent[1] = fleet.send(1, orders)
    until_said(1, accepted)
    take_back(1)
    until_said(1, accepted, refused)
    field.kill('/scout_1/robot')
    fleet.start()
    until_said(1, accepted, refused, refused)
    sent[2] = fleet.send(2, orders)
    until_said(2, accepted)
    field.kill('/scout_1/robot')
    take_back(2)
    fleet.journal('scout_1').unlink()
    fleet.start()
    until_said(2, accepted, refused)
    # It takes the next one, on which it departs.
    fleet.simulate()
    sent[3] = fleet.send(3, orders)
    field.until(lambda: said[-1].state == OrderState.DEPARTED, 'departure')
    take_back(3)
    fleet.wait_for_report(reports, sent[3])
    until_said(3, accepted, (OrderState.DEPARTED, ''))


def test_what_cannot_be_taken_back_is_refused_by_name(field):
    base = StatedBase(field, ['scout_1', 'scout_2'], rolling=True, return_deadline=1000.0)
    for agent in base.paths:
        base.until_sent(1, agent)
    first, second = (
        DeploymentKey(agent, from_stamp(base.paths[agent][0].header.stamp)) for agent in base.paths
    )
    orders = f'(open orders: {first}, {second})'
    told = base.refused('take_back', agent='scout_9')
    assert told == f"no order of 'scout_9' is open {orders}"
    told = base.refused('take_back')
    assert told == f'agent is empty: name the agent whose order is taken back {orders}'
    for name in ('reason', 'author'):
        told = base.refused('take_back', agent='scout_1', **{name: 'x' * 201})
        assert told == f'{name} has 201 characters, at most 200 fit'
    base.until_named(base.say(OrderState.DEPARTED, agent='scout_2'), 'scout_2')
    late = f'{second} left: its robot can only be given up or annotated'
    field.until(lambda: f'{second} leaves' in field.said('/planner'), 'departure')
    assert base.refused('take_back', agent='scout_2') == late
    told = base.do('take_back', agent='scout_1')
    assert told == (
        f'the operator took back the order of {first}: it counts as never sent once its agent has '
        'refused it; if its robot has left by then, it stays out'
    )
    again = f'{first} is taken back by the operator: its agent has not refused it so far'
    assert base.refused('take_back', agent='scout_1') == again
    # It left before it heard that.
    base.until_named(base.say(OrderState.DEPARTED))
    base.come_back()
    base.until_held(1)
    assert base.replayed().evidence.outcomes.keys() == {first}


def test_an_order_that_is_taken_back_counts_as_never_sent(field):
    # Robots stay at the base while two nodes publish `hold`.
    stranger = field.node.create_publisher(Bool, '/hold', qos.LATCHED)
    statuses = field.listen(AgentStatus, '/scout_1/status')
    base = Base(field, presume_departure=False, robots=1, approval=True)
    field.node.destroy_publisher(base.reports['scout_1'])

    def start(node, **more):
        awaited = {'await_nodes': awaited_nodes(node, is_recorded=True)}
        field.start(node, {**base.parameters, **awaited, **more})

    def until_accepted(number):
        # Also the same path is approved anew.
        base.proposed()
        base.do('approve', data=True)
        base.until_sent(number)
        field.until(lambda: statuses[-1:] and number == len(states(statuses)), 'acceptance')

    start('agent')
    until_accepted(1)
    base.until_state('which its agent reports on /scout_1/status')
    # The agent answers when the planner was killed and resumed.
    field.processes.started['/agent'].send_signal(signal.SIGSTOP)
    (request,) = (each[2] for each in typed('docs/operator.md') if each[0] == '/take_back')
    base.do('take_back', **yaml.safe_load(request))
    field.kill('/planner')
    start('planner', resume=str(base.log))
    field.until(lambda: len(base.actions) == 4, 'the resumed planner to say it again')
    field.processes.started['/agent'].send_signal(signal.SIGCONT)
    until_accepted(2)
    first, second = sorted(states(statuses))
    refused = (OrderState.REFUSED, SAID)
    assert states(statuses)[first] == [(OrderState.ACCEPTED, ''), refused]
    # An agent that is restarted says the same, and goes nowhere.
    base.do('pause', data=True)
    field.until(lambda: 'the operator to end the pause' in field.state('/agent'), 'pause')
    field.node.destroy_publisher(stranger)
    field.kill('/agent')
    start('agent', resume=str(base.log))
    field.until(lambda: states(statuses)[first].count(refused) == 2, 'refusal again')
    base.do('take_back', agent='scout_1')
    told = f'{DeploymentKey("scout_1", second)} is taken back by the operator: its robot stays'
    field.until(lambda: told in field.said('/planner'), told)
    base.do('pause', data=False)
    until_accepted(3)
    assert 'was refused by its agent' not in field.said('/planner')
    base.until_state('done: 1 of 1')
    report = base.replayed()
    assert {each.stamp for each in report.evidence.void} == {first, second}
    assert report.evidence.ended == 1
    assert [each.action.name for each in report.evidence.actions] == [
        *('APPROVE', 'TAKE_BACK', 'APPROVE', 'PAUSE', 'TAKE_BACK', 'RESUME', 'APPROVE')
    ]
