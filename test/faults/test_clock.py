# SPDX-License-Identifier: Apache-2.0
"""A clock that jumps back in the middle of a mission."""

from __future__ import annotations

import pytest
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
import rosgraph_msgs.msg
from schedule import NODES

PARAMETERS = {
    'use_sim_time': True,
    'grid.width': 5,
    'grid.height': 5,
    'max_steps': 10,
    'robots': 15,
    'planner': 'relaxed',
    'seed': 12,
}
TICK = 0.02


class SimulatedClock:
    """The time on /clock, in seconds, for others to set."""

    def __init__(self, node, now):
        self.now = now
        self._publisher = node.create_publisher(rosgraph_msgs.msg.Clock, '/clock', 1)
        node.create_timer(TICK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _tick(self):
        self.now += TICK
        message = rosgraph_msgs.msg.Clock()
        message.clock.sec = int(self.now)
        message.clock.nanosec = int(self.now % 1 * 1e9)
        self._publisher.publish(message)


@pytest.mark.full
def test_no_deployment_is_lost_when_the_clock_jumps_back(set_out):
    mission = set_out(PARAMETERS)
    clock = SimulatedClock(mission.node, 1000.0)
    mission.start(*NODES)
    reports = mission.onlooker.evidence.reports
    for number, node in enumerate(NODES):
        mission.until(lambda number=number: len(reports) >= 3 * number + 2, 'more reports')
        clock.now -= 200.0
        mission.restart(node)
    mission.until(lambda: len(reports) >= 14, 'report 14')
    for node in NODES:
        mission.kill(node)
    clock.now -= 100.0
    mission.start(*NODES)
    mission.until_over()
    assert not mission.findings()
    assert min(key.stamp for key in reports) > 999 * 10**9
