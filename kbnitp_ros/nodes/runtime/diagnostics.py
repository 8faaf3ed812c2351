# SPDX-License-Identifier: Apache-2.0
"""What a node has accepted, refused and waits for, on the topic /diagnostics."""

from __future__ import annotations

from enum import auto, Enum
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from kbnitp_ros.files import in_words
from kbnitp_ros.nodes.runtime import qos
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node

TOPIC = '/diagnostics'

PERIOD = 1.0  # seconds

# By which the planner tells the state of its mission, and why it is in that state.
MISSION_STATE = 'mission_state'
MISSION_REASON = 'mission_reason'

# By which a node tells what it refused last.
LAST_REFUSAL = 'last_refusal'

# How many refusals are told at once in such a period, and how many characters are shown of each.
# Those beyond are only counted: whoever floods a node with messages must not have it flood others.
SHOWN_AT_ONCE = 10
SHOWN = 1000

# How long a node that cannot go on stays for its last words: until somebody listens, and until
# they have arrived, each in seconds.
LAST_WORDS = 1.0


class Activity(Enum):
    """What a node does."""

    WORKING = auto()
    WAITING = auto()
    DONE = auto()


class NodeState(NamedTuple):
    """What a node does, and of what."""

    # What it does.
    activity: Activity
    # The same with what it is about, as diagnostics and the console show it.
    sentence: str


def working(sentence: str) -> NodeState:
    """Return the state of a node that does what the sentence says."""
    return NodeState(Activity.WORKING, sentence)


def waiting_for(what: str) -> NodeState:
    """Return the state of a node that waits for somebody or something, and why."""
    return NodeState(Activity.WAITING, f'waiting for {what}')


def done(how: str) -> NodeState:
    """Return the state of a node whose work is done."""
    return NodeState(Activity.DONE, f'done: {how}')


class Diagnostics:
    """Counts what comes in and shows it every second, and at once when something is refused."""

    def __init__(self, node: Node) -> None:
        # Messages so far.
        self.accepted = 0
        self.refused = 0
        # Messages held until what they belong to has come.
        self.waiting = 0
        # What the node does.
        self.state = working('running')
        # What is not as it should be for now; empty when nothing.
        self.warning = ''
        # What else is to be told.
        self.values: dict[str, str] = {}
        self._last_refusal = ''
        self._failure = ''
        self._refused_lately = 0
        self._node = node
        # Its name is fixed, wherever the node is: tools know no other.
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, qos.DIAGNOSTICS)
        # Diagnostics go on when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self._publish_all, clock=steady)

    def accept(self) -> None:
        """Count one message as accepted."""
        self.accepted += 1

    def refuse(self, what: str, why: object) -> None:
        """Count one message as refused and say so, unless very many were refused just now."""
        self.refused += 1
        self._refused_lately += 1
        text = f'{what} refused: {why}'
        self._last_refusal = text if len(text) <= SHOWN else f'{text[:SHOWN]}...'
        if self._refused_lately <= SHOWN_AT_ONCE:
            self._node.get_logger().warning(self._last_refusal)
            self.publish()

    def _publish_all(self) -> None:
        """Show the counts, and say how many refusals were not told."""
        not_shown, self._refused_lately = self._refused_lately - SHOWN_AT_ONCE, 0
        if not_shown > 0:
            self._node.get_logger().warning(f'{not_shown} more messages were refused')
        self.publish()

    def fail(self, why: Exception) -> None:
        """Say why the node cannot go on, and stay until that has arrived if anybody listens."""
        self._failure = in_words(why)
        deadline = time.monotonic() + LAST_WORDS
        name = self._node.get_name(), self._node.get_namespace()
        while time.monotonic() < deadline:
            own = sum(
                (each.node_name, each.node_namespace) == name
                for each in self._node.get_subscriptions_info_by_topic(self._publisher.topic_name)
            )
            if self._publisher.get_subscription_count() > own:
                break
            time.sleep(0.01)
        self.publish()
        self._publisher.wait_for_all_acked(Duration(seconds=LAST_WORDS))

    def publish(self) -> None:
        """Show the counts now."""
        values = {
            'state': self.state.sentence,
            'accepted': self.accepted,
            'refused': self.refused,
            'waiting': self.waiting,
            **({LAST_REFUSAL: self._last_refusal} if self._last_refusal else {}),
            **self.values,
        }
        level = DiagnosticStatus.OK
        if self._failure:
            level = DiagnosticStatus.ERROR
        elif self.refused or self.warning:
            level = DiagnosticStatus.WARN
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message=self._failure or self.warning or self._last_refusal or self.state.sentence,
            hardware_id='kbnitp_ros',
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
