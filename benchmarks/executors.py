# SPDX-License-Identifier: Apache-2.0
"""Time a callback with the executor of the nodes and with that of rclpy."""

from __future__ import annotations

from functools import partial
import os
import time

from cases import Benchmark
from kbnitp_ros.cli.processes import environment, free_domain
from kbnitp_ros.nodes.runtime.executor import OneByOne
import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Int32

# As many as the recorder of a mission with two agents has.
TOPICS = 20
MESSAGES = 2000


def time_callback(make: type[Executor]) -> float:
    """Return the CPU time of the process for a message that it sends itself, in seconds."""
    with free_domain() as domain:
        os.environ |= environment(domain)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node, executor = rclpy.create_node('timed'), make()
        profile = QoSProfile(depth=10)
        heard: list[Int32] = []
        for number in range(TOPICS):
            node.create_subscription(Int32, f'topic_{number}', heard.append, profile)
        publisher = node.create_publisher(Int32, 'topic_0', profile)
        executor.add_node(node)

        def send(count: int) -> None:
            for _ in range(count):
                known = len(heard)
                publisher.publish(Int32())
                while len(heard) == known:
                    executor.spin_once(timeout_sec=1.0)

        send(MESSAGES // 10)
        start = time.process_time()
        send(MESSAGES)
        seconds = (time.process_time() - start) / MESSAGES
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
    return seconds


BENCHMARKS = (
    Benchmark(
        'A callback by executor',
        f'The CPU time of a process for a message that it sends itself, the mean of {MESSAGES:,}, '
        f'with {TOPICS} subscriptions.\nThe executor of the nodes collects what it waits for only '
        'when something is created or destroyed. It uses private\nparts of rclpy for that; '
        '`test/nodes/test_rclpy_internals.py` fails first when these change.\n\nAt its end a '
        'process ignores signals by `PyOS_setsig`. Of 25 nodes that ended under a flood of SIGINT '
        'none printed a\ntraceback then; without that call 5 did.',
        {
            'rclpy.executors.SingleThreadedExecutor': partial(
                time_callback, SingleThreadedExecutor
            ),
            'nodes/runtime/executor.py': partial(time_callback, OneByOne),
        },
    ),
)
