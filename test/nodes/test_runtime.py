# SPDX-License-Identifier: Apache-2.0
"""How nodes spin, and parts of rclpy and Fast DDS that they use."""

from contextlib import contextmanager
from itertools import takewhile
import os
from pathlib import Path
import signal
import subprocess
import sys
from threading import Timer
import time

from ament_index_python.packages import get_package_share_directory
from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.nodes import recorded_topics
from kbnitp_ros.nodes.recorded_topics import Inquiry, ParameterWatch
from kbnitp_ros.nodes.runtime.graph import discovery_warning, PROFILES, udp_only
from kbnitp_ros.nodes.runtime.node import MissionNode, spin_once
from kbnitp_ros.nodes.runtime.qos import EVIDENCE
import pytest
from rcl_interfaces.srv import ListParameters
import rclpy
from rclpy.parameter_service import ParameterService
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_msgs.msg import Int32
from std_srvs.srv import Trigger


@pytest.fixture
def here(field):
    """Provide a node in the test, and a function that spins it until a condition holds."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = MissionNode('estimator')
    executor = node.make_executor()
    executor.add_node(node)

    def until(condition):
        def spun():
            spin_once(node, executor, 0.05)
            return condition()

        field.until(spun, 'what is spun for')

    yield node, until
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


def fail(*_):
    raise OSError('the disk is full')


def ask(node, until):
    client = node.create_client(Trigger, 'how')
    until(client.service_is_ready)
    return client.call_async(Trigger.Request())


def fail_in_a_subscription(node, _):
    node.create_subscription(Int32, 'numbers', fail, EVIDENCE)
    node.create_publisher(Int32, 'numbers', EVIDENCE).publish(Int32())


def fail_in_a_service(node, until):
    node.create_service(Trigger, 'how', fail)
    ask(node, until)


def fail_at_an_answer(node, until):
    node.create_service(Trigger, 'how', lambda _, response: response)
    ask(node, until).add_done_callback(node.guarded(fail))


@pytest.mark.parametrize('fail_in', [
    lambda node, _: node.create_timer(0.01, fail),
    fail_in_a_subscription,
    fail_in_a_service,
    fail_at_an_answer,
    lambda node, _: Timer(0.1, node.call_next, [fail]).start(),
])  # fmt: skip
def test_an_error_in_a_callback_is_raised(here, fail_in):
    node, until = here
    fail_in(node, until)
    with pytest.raises(OSError, match='the disk is full'):
        until(lambda: False)


def test_another_thread_does_not_wait_for_a_callback(here):
    node, _ = here
    called = []
    begun = time.monotonic()
    Timer(0.3, node.call_next, [lambda: called.append(time.monotonic())]).start()
    while not called:
        spin_once(node, node.executor, 60.0)
    assert 0.3 <= called[0] - begun < 5.0


def test_a_service_may_answer_later(here):
    node, until = here
    answer = Future()
    node.create_service(Trigger, 'how', lambda *_: answer)
    heard = ask(node, until)
    node.create_poll(lambda: answer.set_result(Trigger.Response(message='well')), 0.2)
    until(heard.done)
    assert heard.result().message == 'well'


def test_an_answer_after_an_inquiry_is_ignored(here):
    """The executor may call back once more for an answer that had arrived before."""
    node, until = here
    taken = []
    name = node.get_fully_qualified_name()
    inquiry = Inquiry(node, name, lambda *given: taken.append(given), fail)

    def is_over():
        inquiry.pursue()
        return inquiry.over

    until(is_over)
    inquiry.destroy()
    late, called = Future(), []
    late.set_result(ListParameters.Response())
    for call_back in (inquiry._on_names, lambda _: called.append(True)):
        node.call_next(lambda call_back=call_back: call_back(late))
    until(lambda: called)
    assert [who for who, _ in taken] == [name]


def test_parameters_are_taken_from_a_node_that_answers_late(here, monkeypatch):
    """A busy machine may discover the services of a node long after its name."""
    node, until = here
    monkeypatch.setattr(recorded_topics, 'GIVE_UP', 1.0)
    monkeypatch.setattr(recorded_topics, 'REST', 0.2)
    slow = rclpy.create_node('slow', start_parameter_services=False)
    slow.declare_parameter('robots', 7)
    node.executor.add_node(slow)
    taken = {}
    watch = ParameterWatch(node, '/', lambda name, values: taken.update({name: values}), fail)

    def looked():
        watch.look()
        return watch.is_over('/slow')

    until(looked)
    assert '/slow' not in taken
    services = ParameterService(slow)
    until(lambda: looked() and '/slow' in taken)
    assert taken['/slow']['robots'] == 7
    del services
    slow.destroy_node()


@pytest.mark.processes
def test_a_node_that_cannot_leave_the_graph_ends_as_it_would_have():
    program = """
import ctypes, os, signal
from kbnitp_ros.nodes import estimator
from kbnitp_ros.nodes.runtime import process
process.TEARDOWN = 1
estimator.EstimatorNode.destroy_node = lambda self: ctypes.PyDLL(None).pause()
estimator.EstimatorNode.create_poll = lambda self, look: os.kill(os.getpid(), signal.SIGTERM)
estimator.main()
"""
    with free_domain() as domain:
        ended = subprocess.run(
            [sys.executable, '-c', program],
            env=environment(domain),
            timeout=60,
            capture_output=True,
        )
    assert ended.returncode == 0, ended.stderr


@pytest.mark.processes
def test_a_start_that_hangs_prints_its_stack():
    program = """
import ctypes
from kbnitp_ros.nodes import estimator
from kbnitp_ros.nodes.runtime import process
process.STARTUP = 1
estimator.EstimatorNode.create_publisher = lambda *_, **__: ctypes.PyDLL(None).pause()
estimator.main()
"""
    with free_domain() as domain:
        process = subprocess.Popen(
            [sys.executable, '-c', program],
            env=environment(domain),
            stderr=subprocess.PIPE,
            text=True,
        )
        with process.stderr:
            stack = ''.join(takewhile(lambda line: '<module>' not in line, process.stderr))
            process.kill()
        process.wait()
    assert stack.startswith('Timeout (0:00:01)!')
    assert 'estimator.py", line' in stack


def test_rclpy_is_of_jazzy():
    text = Path(get_package_share_directory('rclpy'), 'package.xml').read_text()
    assert '<version>7.1.' in text, 'rclpy.experimental may be another'


CONFIG = Path(__file__).parents[2] / 'config'


PROGRAM = """
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node('told')
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_{what}
print('ready', flush=True)
rclpy.spin(node)
"""
TALKER = PROGRAM.format(what="publisher(String, 'told', qos).publish(String(data='{word}'))")
LISTENER = PROGRAM.format(
    what="subscription(String, 'told', lambda message: print(message.data, flush=True), qos)"
)

LOCAL = [{'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}, {'ROS_LOCALHOST_ONLY': '1'}]


def of_user(domain, **variables):
    """Return the environment of a user with these variables of ROS."""
    others = {name: value for name, value in os.environ.items() if not name.startswith('ROS_')}
    others.pop(PROFILES, None)
    return {**others, 'ROS_DOMAIN_ID': str(domain), **variables}


@contextmanager
def started(program, variables):
    process = subprocess.Popen(
        [sys.executable, '-c', program], env=variables, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == 'ready\n'
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def shared_memory(process):
    """Return the shared memory of Fast DDS that a process has mapped."""
    lines = Path(f'/proc/{process.pid}/maps').read_text().splitlines()
    return {line.split()[-1] for line in lines if '/dev/shm/fastrtps' in line}


@pytest.mark.processes
@pytest.mark.parametrize('said', LOCAL)
def test_robots_that_are_killed_leave_no_shared_memory_and_are_found_again(said):
    with free_domain() as domain:
        user = of_user(domain, **said)
        nodes = user | udp_only(user, CONFIG)
        with started(LISTENER, nodes) as listener:
            for word in ('first', 'second', 'third'):
                with started(TALKER.format(word=word), nodes) as talker:
                    assert listener.stdout.readline() == f'{word}\n'
                    assert shared_memory(talker) == set()
                    talker.send_signal(signal.SIGKILL)
            assert shared_memory(listener) == set()


@pytest.mark.processes
def test_the_demo_uses_no_shared_memory_under_any_setting(monkeypatch):
    for variables in LOCAL:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
    with free_domain() as domain, started(TALKER.format(word='a'), environment(domain)) as talker:
        assert shared_memory(talker) == set()


@pytest.mark.processes
def test_a_tool_on_localhost_hears_nodes_without_shared_memory():
    with free_domain() as domain:
        user = of_user(domain, **LOCAL[0])
        nodes = user | udp_only(user, CONFIG)
        with started(LISTENER, user) as tool, started(TALKER.format(word='heard'), nodes):
            assert tool.stdout.readline() == 'heard\n'


@pytest.mark.processes
def test_settings_of_the_user_are_kept():
    assert udp_only({PROFILES: 'mine.xml', **LOCAL[0]}, CONFIG) == {}
    for far in (
        {},
        {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'},
        LOCAL[0] | {'ROS_STATIC_PEERS': 'base'},
    ):
        assert udp_only(far, CONFIG) == {
            PROFILES: str(CONFIG / 'fastdds.xml'),
            'RMW_FASTRTPS_USE_QOS_FROM_XML': '1',
        }


@pytest.mark.processes
def test_a_node_warns_of_a_discovery_server_that_hides_nodes(tmp_path):
    server = {'ROS_DISCOVERY_SERVER': '127.0.0.1:11811'}
    told = discovery_warning(server)
    for client in ({}, server | {'ROS_SUPER_CLIENT': 'TRUE'}, {'ROS_SUPER_CLIENT': 'FALSE'}):
        assert not discovery_warning(client)
    with free_domain() as domain:
        recorder = subprocess.Popen(
            [sys.executable, '-m', 'kbnitp_ros', 'recorder'],
            env=environment(domain) | server,
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert told in recorder.stderr.readline()
        finally:
            recorder.kill()
            recorder.communicate()
