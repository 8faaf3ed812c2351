# SPDX-License-Identifier: Apache-2.0
"""Errors of all callbacks of a node are raised where it spins, and no thread is kept waiting."""

import subprocess
import sys
from threading import Timer
import time

from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.nodes.runtime.node import MissionNode, spin_once
from kbnitp_ros.nodes.runtime.qos import EVIDENCE
import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_msgs.msg import Int32
from std_srvs.srv import Trigger


@pytest.fixture
def here(field):
    """Provide a node in the test and how to spin it until something holds."""
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
    """Call a service, and return what its answer comes to."""
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
