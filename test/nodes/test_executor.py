# SPDX-License-Identifier: Apache-2.0
"""The executor makes all callbacks of a node, one after another, and raises what they raise."""

import time

from kbnitp_ros.nodes.runtime.executor import frames_of_callback, OneByOne
import pytest
import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

PROFILE = QoSProfile(depth=10)


@pytest.fixture
def here(field):
    """Provide a node in the test and how to spin it until something holds."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node, executor = rclpy.create_node('here'), OneByOne()
    executor.add_node(node)

    def until(condition):
        def spun():
            executor.spin_once(timeout_sec=0.05)
            return condition()

        field.until(spun, 'what is spun for')

    yield node, until
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


def test_what_is_created_while_it_spins_is_heard(here):
    node, until = here
    heard = []

    def listen_too():
        timer.cancel()
        node.create_subscription(Int32, 'numbers', lambda m: heard.append(m.data), PROFILE)
        info = []
        node.create_subscription(Int32, 'numbers', lambda m, i: info.append((m, i)), PROFILE)
        heard.append(info)

    timer = node.create_timer(0.01, listen_too)
    numbers = node.create_publisher(Int32, 'numbers', PROFILE)
    until(lambda: numbers.get_subscription_count() == 2)
    for number in range(5):
        numbers.publish(Int32(data=number))
    until(lambda: len(heard) == 6 and len(heard[0]) == 5)
    info, *data = heard
    assert data == list(range(5))
    assert [message.data for message, _ in info] == data
    assert all(each['source_timestamp'] for _, each in info)


def test_what_is_destroyed_is_not_called_though_messages_wait(here):
    node, until = here
    heard = []

    def hear_once(message):
        heard.append(message.data)
        node.destroy_subscription(subscription)

    subscription = node.create_subscription(Int32, 'numbers', hear_once, PROFILE)
    others = []
    node.create_subscription(Int32, 'numbers', others.append, PROFILE)
    numbers = node.create_publisher(Int32, 'numbers', PROFILE)
    until(lambda: numbers.get_subscription_count() == 2)
    for number in range(3):
        numbers.publish(Int32(data=number))
    until(lambda: len(others) == 3)
    assert heard == [0]
    until(lambda: numbers.get_subscription_count() == 1)


def test_services_are_answered_and_answers_are_heard(here):
    node, until = here

    def answer(_, response):
        response.message = 'well'
        return response

    node.create_service(Trigger, 'how', answer)
    client = node.create_client(Trigger, 'how')
    until(client.service_is_ready)
    heard = []
    client.call_async(Trigger.Request()).add_done_callback(
        lambda done: heard.append(done.result())
    )
    until(lambda: heard)
    assert heard[0].message == 'well'

    def fail(_):
        raise OSError('the disk is full')

    client.call_async(Trigger.Request()).add_done_callback(fail)
    with pytest.raises(OSError, match='the disk is full'):
        until(lambda: False)


def test_an_error_in_a_callback_is_raised_and_says_whose_it_is(here):
    node, until = here

    def fail():
        raise ValueError('no')

    timer = node.create_timer(0.01, fail)
    with pytest.raises(ValueError, match='no') as failed:
        until(lambda: False)
    assert [frame.f_code for frame in frames_of_callback(failed.value)] == [fail.__code__]
    timer.cancel()
    assert frames_of_callback(ValueError('never raised')) == []


def test_events_are_told_and_do_not_keep_the_executor_from_waiting(here):
    node, until = here
    told = []
    node.create_subscription(
        Int32,
        'numbers',
        lambda _: None,
        PROFILE,
        event_callbacks=SubscriptionEventCallbacks(
            matched=told.append, incompatible_qos=told.append, use_default_callbacks=False
        ),
    )
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_publisher(Int32, 'numbers', best_effort)
    until(lambda: len(told) == 1)
    node.create_publisher(Int32, 'numbers', PROFILE)
    until(lambda: len(told) == 2)
    end, spun = time.monotonic() + 1.0, 0
    while time.monotonic() < end:
        until(lambda: True)
        spun += 1
    assert spun < 50
