# SPDX-License-Identifier: Apache-2.0
"""Operator actions by real services, and their effect across crashes."""

from pathlib import Path
import re
import shlex
from shutil import which
import subprocess

from base import Base, GRID, PARAMETERS, SERVICES
from documented import ROOT
from kbnitp_msgs.msg import Progress
from kbnitp_ros.base.state import BaseState
from kbnitp_ros.cli.replay import lines
from kbnitp_ros.messages.headers import in_seconds
from kbnitp_ros.messages.operator_actions import Action, MAX_TIMES
from kbnitp_ros.nodes.operator_services import Operator
from kbnitp_ros.nodes.runtime.node import MissionNode
import pytest
import rclpy
from std_srvs.srv import SetBool, Trigger
import yaml


def progress_waiter(field):
    """Return a function that waits for a state of `progress` and its reason."""
    heard = field.listen(Progress, '/progress')

    def until(state, reason):
        field.until(
            lambda: heard and (heard[-1].state, heard[-1].reason) == (state, reason),
            f'progress in state {state}: {reason}',
        )

    return until


def test_a_paused_mission_sends_no_robot(field):
    base = Base(field)
    until_progress = progress_waiter(field)
    base.until_sent(1)
    until_progress(Progress.RUNNING, '')
    assert base.do('pause', data=True) == 'the operator paused the mission'
    until_progress(Progress.PAUSED, '')
    assert base.do('pause', data=True) == 'the mission is paused already'
    base.come_back()
    base.until_held(1)
    reason = 'waiting for the operator to end the pause by the service /pause'
    base.until_state(reason)
    until_progress(Progress.PAUSED, reason)
    assert len(base.sent()) == 1
    base.do('pause', data=False)
    until_progress(Progress.RUNNING, '')
    assert base.do('pause', data=False) == 'the mission is not paused already'
    base.until_sent(2)
    report = base.replayed()
    assert [action.action for action in report.evidence.actions] == [Action.PAUSE, Action.RESUME]
    assert [each.robots_left for each in report.evidence.actions] == [1, 1]
    told = [line for line in lines(report) if line.startswith('the operator')]
    assert told == [
        f'the operator {what}, at {in_seconds(each.stamp)}'
        for what, each in zip(('paused the mission', 'ended the pause'), report.evidence.actions)
    ]


def test_approved_robots_depart_and_refused_ones_go_elsewhere(field):
    base = Base(field, ['scout_1', 'scout_2'], approval=True)
    ways = [[base.proposed(agent) for agent in base.paths]]
    base.until_state(
        'waiting for the operator to approve /scout_1/proposal, /scout_2/proposal by the '
        'service /approve (parameter approval)'
    )
    for _ in range(2):
        told = base.do('approve', data=False)
        assert told.startswith('the operator refused the paths of scout_1 at')
        field.until(
            lambda: [base.proposed(agent) for agent in base.paths] not in ways, 'another plan'
        )
        ways.append([base.proposed(agent) for agent in base.paths])
    assert not any(base.sent(agent) for agent in base.paths)
    base.do('approve', data=True)
    for agent in base.paths:
        base.until_sent(1, agent)
    assert [base.sent(agent)[0] for agent in base.paths] == ways[-1]
    field.until(lambda: not base.proposals['scout_1'][-1].poses, 'proposal withdrawn')
    assert base.refused('approve', data=True) == 'nothing is proposed'
    for agent in base.paths:
        base.come_back(agent)
    # Refusals concern one round.
    base.until_held(2)
    base.proposed()
    report = base.replayed()
    assert [each.action.name for each in report.evidence.actions] == [
        'REFUSE',
        'REFUSE',
        'APPROVE',
    ]
    for action, way in zip(report.evidence.actions, ways):
        assert [path.tolist() for path in action.paths.values()] == way
        assert [key.agent for key in action.paths] == ['scout_1', 'scout_2']


def test_a_robot_declared_lost_is_given_up(field):
    base = Base(field)
    assert base.refused('give_up', agent='scout_9') in (
        "no robot of 'scout_9' is in flight (agents in flight: none)",
        "no robot of 'scout_9' is in flight (agents in flight: scout_1)",
    )
    base.until_sent(1)
    base.until_state('without a time limit')
    many = base.refused('give_up', agent='scout_1', steps_survived=100)
    assert 'steps_survived is 100' in many
    told = base.do('give_up', agent='scout_1', steps_survived=1)
    assert 'gave up scout_1 at' in told
    assert told.endswith(', last contact after step 1')
    base.until_held(1)
    base.until_sent(2)
    field.until(lambda: base.heard['scout_1'], 'loss')
    (loss,) = base.heard['scout_1']
    assert (loss.survived, loss.steps_survived) == (False, 1)
    report = base.replayed()
    assert [action.action for action in report.evidence.actions] == [Action.GIVE_UP]
    assert report.evidence.survived == 0


def test_an_ended_mission_is_over_when_its_robots_have_returned(field):
    base = Base(field)
    base.until_sent(1)
    told = base.do('end_mission')
    assert told.startswith('the operator ended the mission; the mission is over once scout_1 at ')
    for service, request in (('end_mission', {}), ('pause', {'data': True})):
        assert base.refused(service, **request) == 'the mission has been ended already'
    base.until_state('waiting for')
    base.come_back()
    reason = 'done: 1 of 4 robots deployed, ended by the operator'
    until_progress = progress_waiter(field)
    base.until_state(reason)
    until_progress(Progress.ENDED, reason)
    assert len(base.sent()) == 1
    assert [action.action for action in base.replayed().evidence.actions] == [Action.END]


def test_a_mission_ended_before_its_start_is_over_at_once(field):
    parameters = {**PARAMETERS, 'recorded': False, 'keep_running': False}
    planner = field.start('planner', parameters)
    client = field.node.create_client(Trigger, '/end_mission')
    field.until(client.service_is_ready, 'service')
    client.call_async(Trigger.Request())
    # DDS does not acknowledge the answer of a planner that ends at once.
    field.until(lambda: planner.poll() is not None, 'end', may_end=True)
    assert planner.returncode == 0
    assert 'the mission is over: done: 0 of 4 robots deployed, ended by' in field.said('/planner')


def megabytes(process):
    status = Path(f'/proc/{process.pid}/status').read_text()
    return int(re.search(r'VmRSS:\s*(\d+) kB', status)[1]) / 1024


def test_a_flood_of_calls_is_answered_and_changes_nothing(field):
    base = Base(field)
    base.until_sent(1)
    base.until_state('without a time limit')
    base.refused('approve', data=True)
    planner = field.processes.started['/planner']
    before = megabytes(planner)
    absurd = [
        ('give_up', {'agent': 'x' * 10**6}),
        ('give_up', {'agent': 'scout_1', 'steps_survived': 2**32 - 1}),
        ('approve', {'data': True}),
    ]
    for _ in range(8):
        calls = [
            base.clients[name].call_async(SERVICES[name].Request(**request))
            for name, request in absurd * 5
        ]
        field.until(lambda calls=calls: all(call.done() for call in calls), 'answers')
        assert not any(call.result().success for call in calls)
        assert all(len(call.result().message) < 1000 for call in calls)
    assert megabytes(planner) < before + 50
    base.come_back()
    base.until_held(1)
    base.until_sent(2)
    assert base.replayed().evidence.actions == []


def test_endless_pauses_and_resumptions_do_not_fill_the_log(field, request):
    rclpy.init(args=[])
    request.addfinalizer(rclpy.shutdown)
    node = MissionNode('planner')
    state = BaseState(GRID, 1)
    operator = Operator(node, [], state, lambda _: None)

    def call(data):
        return operator._on_pause(SetBool.Request(data=data), SetBool.Response())

    for _ in range(MAX_TIMES):
        assert call(True).success
        assert call(False).success
    assert call(True).success
    for _ in range(10):
        told = call(False)
        assert not told.success
        assert f'RESUME was called {MAX_TIMES} times' in told.message
        assert state.operator.is_paused
    assert len(state.operator.actions) == 2 * MAX_TIMES + 1
    assert operator._on_end(Trigger.Request(), Trigger.Response()).success
    node.destroy_node()


def typed(page):
    """Return the service calls on a page: name, type and request."""
    text = ROOT.joinpath(page).read_text()
    return [shlex.split(line) for line in re.findall(r'(?m)^ros2 service call (.*)$', text)]


def test_services_are_called_as_on_the_page(field):
    base = Base(field, approval=True)
    # Agents of this base state no departures: test_taken_back.py calls take_back.
    commands = [each for each in typed('docs/operator.md') if each[0] != '/take_back']
    assert len(commands) == 7
    for name, kind, request in commands:
        # Each call needs the state that the one before brought about.
        if name == '/give_up':
            base.until_state('without a time limit')
        elif name == '/approve':
            base.proposed()
        if which('ros2'):
            call = ['ros2', 'service', 'call', name, kind, request]
            ended = subprocess.run(call, capture_output=True, text=True, timeout=60)
            assert 'success=True' in ended.stdout, ended.stdout + ended.stderr
            continue
        assert (
            kind
            == f'{SERVICES[name[1:]].__module__.split(".")[0]}/srv/{SERVICES[name[1:]].__name__}'
        )
        told = base.do(name[1:], **yaml.safe_load(request))
        assert told.startswith('the operator')
    base.until_state('ended by the operator')
    assert len(base.replayed().evidence.actions) == 7


def has_left(base):
    # A path that was not on disk is sent anew, and not before.
    base.field.until(base.sent, 'path')
    assert all(way == base.second for way in base.sent())
    base.until_state('waiting for the report of scout_1 at ')


def is_proposed_elsewhere(base):
    base.field.until(lambda: base.proposed() != base.first, 'another plan')
    base.second = base.proposed()


def is_given_up(base):
    base.until_held(1)
    base.field.until(lambda: base.heard['scout_1'], 'loss')
    assert base.heard['scout_1'][-1].steps_survived == 2
    base.proposed()


GIVE_UP = {'agent': 'scout_1', 'steps_survived': 2}
STEPS = {
    'PAUSE': (
        Base.proposed,
        ('pause', {'data': True}),
        lambda base: base.until_state('waiting for the operator to end the pause'),
    ),
    'RESUME': (
        None,
        ('pause', {'data': False}),
        lambda base: setattr(base, 'first', base.proposed()),
    ),
    'REFUSE': (None, ('approve', {'data': False}), is_proposed_elsewhere),
    'APPROVE': (None, ('approve', {'data': True}), has_left),
    # The robot departs when its path is on disk.
    'GIVE_UP': (
        lambda base: base.until_state('without a time limit'),
        ('give_up', GIVE_UP),
        is_given_up,
    ),
    'END': (
        None,
        ('end_mission', {}),
        lambda base: base.until_state('done: 1 of 4 robots deployed, ended by the operator'),
    ),
}

# Steps after which all nodes are killed, and whether before these take effect.
CASES = [
    (('REFUSE', 'GIVE_UP'), True),
    *(
        pytest.param(steps, at_once, marks=pytest.mark.full)
        for at_once in (True, False)
        for steps in [*((step,) for step in STEPS), tuple(STEPS)]
    ),
]


@pytest.mark.parametrize('crashes, at_once', CASES)
def test_operator_actions_survive_any_crash(field, crashes, at_once):
    base = Base(field, approval=True)
    for step, (prepare, (service, request), holds) in STEPS.items():
        if prepare:
            prepare(base)
        base.do(service, **request)
        if step in crashes and at_once:
            base.crash()
        holds(base)
        if step in crashes and not at_once:
            base.crash()
            holds(base)
    report = base.replayed()
    assert [action.action.name for action in report.evidence.actions] == [*STEPS]
    assert len(report.evidence.standings) == 1
    assert [report.evidence.paths[key].tolist() for key in report.evidence.paths] == [base.second]
    assert not any(call.done() for call in base.lost_calls)
