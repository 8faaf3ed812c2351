# SPDX-License-Identifier: Apache-2.0
"""
A robot written by the contract alone, which refuses orders and crashes anywhere.

`python3 fickle_robot.py AGENT NAMESPACE FIELD.json JOURNAL`. The fate of an order is drawn from
its stamp. After a crash the restarted process resumes with the journal: in place of a destroyed
robot comes another, which repeats the reports on its orders.
"""

import json
import os
from pathlib import Path
import sys
import time

from kbnitp_msgs.msg import AgentState, AgentStatus, DeploymentReport, Recorded
from kbnitp_ros.core import DeploymentKey, Grid, Observation
from kbnitp_ros.messages.deployments import OrderState, read_path, report_message, status_message
from kbnitp_ros.messages.headers import content_hash, from_stamp
from kbnitp_ros.messages.states import Readiness, state_message
from kbnitp_ros.nodes.runtime import qos
from nav_msgs.msg import Path as PathMessage
import numpy as np
import rclpy
from std_msgs.msg import Bool

# Stages at which an order ends, with probabilities.
FATES = {
    'home': 0.3, 'late': 0.1, 'refuse': 0.15, 'crash before': 0.1, 'crash before and refuse': 0.05,
    'crash at the gate': 0.1, 'crash in the field': 0.1, 'crash at home': 0.1,
}  # fmt: skip
# The exit code of crashes.
CRASHED = 9

# Seconds for which it gives a reason, and gives none.
SAID = 2.0

# Seconds that a late robot is away: it has been given up by then.
LATE = 3.0


class Robot:
    """An agent and its robots; its journal has a line for each irreversible event."""

    def __init__(self, agent, namespace, field, journal):
        self._agent, self._journal = agent, Path(journal)
        self._grid = Grid(*field['size'])
        self._seed = field['seed']
        self._orders = {}
        self._waiting = {}
        self._recorded = set()
        self._held = True
        node = self._node = rclpy.create_node('robot', namespace=f'{namespace}/{agent}')
        self._statuses = node.create_publisher(AgentStatus, 'status', qos.EVIDENCE)
        self._reports = node.create_publisher(DeploymentReport, 'report', qos.EVIDENCE)
        self._states = node.create_publisher(AgentState, 'state', qos.LATCHED)
        self._reason, self._said_at = '', 0.0
        self._say_state()
        self._read_journal()
        node.create_subscription(Recorded, 'recorded', self._on_recorded, qos.EVIDENCE)
        node.create_subscription(Bool, f'{namespace}/hold', self._on_hold, qos.LATCHED)
        node.create_subscription(PathMessage, 'path', self._on_path, qos.EVIDENCE)

    def _read_journal(self):
        """Publish all recorded events again, and finish those of the process before."""
        lines = self._journal.read_text().splitlines() if self._journal.exists() else []
        for stamp, what, value in map(json.loads, lines):
            self._orders.setdefault(stamp, {})[what] = value
        for stamp, order in self._orders.items():
            if 'refused' in order:
                self._say(stamp, OrderState.REFUSED, order['time'], order['refused'])
            if 'departed' in order:
                self._say(stamp, OrderState.DEPARTED, order['departed'])
                if not order.keys() & {'home', 'lost'}:
                    self._write(stamp, 'home', [[self._grid.base, self._grid.base], [-1]])
            if 'home' in order:
                self._report(stamp)

    def _write(self, stamp, what, value):
        self._orders.setdefault(stamp, {})[what] = value
        with self._journal.open('a') as file:
            file.write(json.dumps([stamp, what, value]) + '\n')
            file.flush()
            os.fsync(file.fileno())

    def _say(self, stamp, state, at, reason=''):
        message = status_message(DeploymentKey(self._agent, stamp), state, at, reason)
        self._statuses.publish(message)
        return content_hash(message)

    def _say_state(self):
        """Give a reason and withdraw it, so that the base sends it again after two crashes."""
        if time.monotonic() > self._said_at + SAID:
            self._reason = '' if self._reason else 'restarted'
            self._said_at = time.monotonic()
            state = Readiness.READY, self._reason, False, time.time_ns()
            self._states.publish(state_message(self._grid, self._agent, *state))

    def _report(self, stamp):
        cells, readings = self._orders[stamp]['home']
        made = Observation(cells, True, readings)
        key = DeploymentKey(self._agent, stamp)
        self._reports.publish(report_message(key, made, stamp + 10**9))

    def _on_recorded(self, message):
        self._recorded.add((from_stamp(message.stamp), message.content))

    def _on_hold(self, message):
        self._held = message.data

    def _on_path(self, message):
        key, cells = read_path(self._grid, self._agent, message)
        if self._orders.get(key.stamp, {}).keys() <= {'accepted', 'lived'}:
            self._waiting[key.stamp] = [int(cell) for cell in cells], content_hash(message)

    def go_on(self):
        """Handle messages, and execute orders that may start."""
        self._listen()
        self._say_state()
        for stamp, (cells, content) in list(self._waiting.items()):
            if (stamp, content) in self._recorded and not self._held:
                del self._waiting[stamp]
                self._obey(stamp, cells)

    def _obey(self, stamp, cells):
        """Execute an order as its stamp says; a crash is like a power loss."""
        rng = np.random.default_rng((self._seed, stamp % 2**63, len(self._agent)))
        fate = str(rng.choice([*FATES], p=[*FATES.values()]))
        self._say(stamp, OrderState.ACCEPTED, stamp)
        if fate.startswith('crash before') and 'lived' not in self._orders.get(stamp, {}):
            self._write(stamp, 'lived', True)
            os._exit(CRASHED)
        if 'refuse' in fate:
            self._write(stamp, 'time', stamp)
            self._write(stamp, 'refused', fate)
            self._say(stamp, OrderState.REFUSED, stamp, fate)
            return
        self._write(stamp, 'departed', stamp)
        content = self._say(stamp, OrderState.DEPARTED, stamp)
        if fate == 'crash at the gate':
            # With or without the departure on the base's disk.
            time.sleep(rng.uniform(0.0, 0.1))
            os._exit(CRASHED)
        while (stamp, content) not in self._recorded:
            self._listen()
        if fate == 'crash in the field':
            self._write(stamp, 'lost', True)
            os._exit(CRASHED)
        if fate == 'late':
            end = time.monotonic() + LATE
            while time.monotonic() < end:
                self._listen()
        readings = rng.integers(0, 2, len(cells) - 1).tolist()
        self._write(stamp, 'home', [cells, readings])
        if fate == 'crash at home':
            os._exit(CRASHED)
        self._report(stamp)

    def _listen(self):
        rclpy.spin_once(self._node, timeout_sec=0.02)


def main():
    agent, namespace, field, journal = sys.argv[1:]
    rclpy.init()
    robot = Robot(agent, namespace, json.loads(Path(field).read_text()), journal)
    while True:
        robot.go_on()


if __name__ == '__main__':
    main()
