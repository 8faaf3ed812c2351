# SPDX-License-Identifier: Apache-2.0
"""
The messages of a mission passed round by bare rclpy: the upper limit of the nodes' speed.

    python3 benchmarks/ping_pong.py ROLE ROUNDS

Three processes with the ROLEs path, report and belief each answer the message before theirs: a
path of 18 steps, the report on it and the belief on 9x9 cells. That of path prints the rounds a
second.
"""

from __future__ import annotations

import sys
import time

from kbnitp_msgs.msg import BeliefMaps, DeploymentReport
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    SensorModel,
)
from kbnitp_ros.messages.beliefs import belief_maps
from kbnitp_ros.messages.deployments import path_message, report_message
from kbnitp_ros.messages.headers import to_stamp
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import rclpy
from rclpy.executors import SingleThreadedExecutor

GRID = Grid(9, 9)
STEPS = 18
CELLS = [0, 1] * (STEPS // 2) + [0]
KEY = DeploymentKey('scout_1', 1)
PRIOR = Estimator(Belief.prior(GRID, 0.5, 0.45, 0.8), SensorModel(0.5))

TOPICS = {
    'path': (Path, qos.EVIDENCE, path_message(GRID, CELLS, KEY.stamp)),
    'report': (
        DeploymentReport,
        qos.EVIDENCE,
        report_message(KEY, Observation(CELLS, True, [False] * STEPS), KEY.stamp),
    ),
    'belief': (BeliefMaps, qos.LATCHED, belief_maps(Ledger(GRID, STEPS, PRIOR), KEY.stamp)),
}


def main() -> None:
    """Answer as many messages as there are rounds."""
    role, rounds = sys.argv[1], int(sys.argv[2])
    before = {'path': 'belief', 'report': 'path', 'belief': 'report'}[role]
    rclpy.init()
    node = rclpy.create_node(role)
    kind, profile, message = TOPICS[role]
    publisher = node.create_publisher(kind, role, profile)
    times = []

    def answer(_=None):
        times.append(time.monotonic())
        message.header.stamp = to_stamp(len(times))
        publisher.publish(message)

    other, other_profile, _ = TOPICS[before]
    node.create_subscription(other, before, answer, other_profile)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    if role == 'path':
        # Late joiners receive it.
        answer()
    while len(times) <= rounds + 1:
        executor.spin_once()
    if role == 'path':
        print(rounds / (times[-1] - times[1]))


if __name__ == '__main__':
    main()
