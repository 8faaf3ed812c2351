# SPDX-License-Identifier: Apache-2.0
"""
A node between those who publish paths and reports and those who listen to them.

It passes every message on one to three times, each after a delay of its own, so that they come
twice, late and in any order:

    python3 test/faults/relay.py SEED FROM TO

FROM and TO are the namespaces of the topics it listens to and publishes on. Started again, it
hears of the whole mission at once, and tells of it in any order.
"""

from __future__ import annotations

from functools import partial
import heapq
from itertools import count
import sys
import time

from kbnitp_msgs.msg import DeploymentReport
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path
import numpy as np
from onlooker import AGENT
import rclpy
from rclpy.node import Node

# In seconds: how late a message comes on average, so that a mission goes on, and how late its
# copies come at most, so that other deployments are made meanwhile.
LATE = 0.02
COPY_LATE = 0.5

TICK = 0.005


class Relay(Node):
    """Pass paths and reports on, some of them several times, late and in any order."""

    def __init__(self, seed, source, target):
        super().__init__('relay')
        self._rng = np.random.default_rng(seed)
        self._delayed = []
        self._numbers = count()
        for kind, name in ((Path, 'path'), (DeploymentReport, 'report')):
            topic = f'{AGENT}/{name}'
            publisher = self.create_publisher(kind, f'{target}/{topic}', qos.EVIDENCE)
            delay = partial(self._delay, publisher)
            self.create_subscription(kind, f'{source}/{topic}', delay, qos.EVIDENCE, raw=True)
        self.create_timer(TICK, self._pass_on)

    def _delay(self, publisher, data):
        copies = self._rng.uniform(0.0, COPY_LATE, size=self._rng.integers(3))
        for delay in (self._rng.exponential(LATE), *copies):
            # The number keeps publishers from being compared.
            due = time.monotonic() + delay, next(self._numbers), publisher, data
            heapq.heappush(self._delayed, due)

    def _pass_on(self):
        while self._delayed and self._delayed[0][0] <= time.monotonic():
            *_, publisher, data = heapq.heappop(self._delayed)
            publisher.publish(data)


def main():
    """Run the relay until it is killed."""
    seed, source, target = sys.argv[1:]
    rclpy.init(args=[])
    rclpy.spin(Relay(int(seed), source, target))


if __name__ == '__main__':
    main()
