# SPDX-License-Identifier: Apache-2.0
"""The parts of rclpy that are private and used here are as they were when that was written."""

import inspect
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
import pytest
import rclpy
from rclpy.client import Client
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.waitable import NumberOfEntities, Waitable

REMEDY = 'compare rclpy/executors.py with nodes/runtime/executor.py, and take the changes over'


@pytest.fixture
def node():
    rclpy.init(args=[])
    node = rclpy.create_node('here')
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_rclpy_is_of_jazzy():
    text = Path(get_package_share_directory('rclpy'), 'package.xml').read_text()
    assert '<version>7.1.' in text, REMEDY


@pytest.mark.parametrize('owner, name, parameters', [
    (Executor, 'wake', ['self']),
    (Executor, 'shutdown', ['self', 'timeout_sec']),
    (Executor, 'spin_once', ['self', 'timeout_sec']),
    (Client, 'get_pending_request', ['self', 'sequence_number']),
    (Future, '_set_executor', ['self', 'executor']),
    (Waitable, 'take_data', ['self']),
    (Waitable, 'add_to_wait_set', ['self', 'wait_set']),
    (Waitable, 'is_ready', ['self', 'wait_set']),
    (Waitable, 'get_num_entities', ['self']),
])  # fmt: skip
def test_methods_take_what_they_took(owner, name, parameters):
    assert [*inspect.signature(getattr(owner, name)).parameters] == parameters, REMEDY


def test_executors_and_nodes_hold_what_they_held(node):
    executor = SingleThreadedExecutor()
    held = {'_guard', '_context', '_tasks', '_tasks_lock'}
    assert held <= vars(executor).keys(), REMEDY
    executor.shutdown()
    assert node._parameter_overrides == {}, 'see nodes/runtime/declared.py'
    assert Subscription.CallbackType.MessageOnly, REMEDY
    counts = {*NumberOfEntities.__slots__}
    kinds = ('subscriptions', 'guard_conditions', 'timers', 'clients', 'services', 'events')
    assert counts == {f'num_{kind}' for kind in kinds}, REMEDY


def test_the_wait_set_does_what_it_did():
    used = {
        *('clear_entities', 'add_subscription', 'add_timer', 'add_client', 'add_service'),
        *('add_guard_condition', 'wait', 'get_ready_entities'),
    }
    assert used <= {*dir(rclpy_implementation.WaitSet)}, REMEDY
    assert issubclass(rclpy_implementation.InvalidHandle, Exception), REMEDY
