# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node: accepted, refused and pending messages, on /diagnostics."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from kbnitp_ros.files import in_words
from kbnitp_ros.nodes.runtime import qos
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node

TOPIC = '/diagnostics'

PERIOD = 1.0  # Seconds.

# Key for the last refusal.
LAST_REFUSAL = 'last_refusal'

# Maximum number of refusals published per period, and of characters of each. Further refusals are
# only counted, so that a flood of messages does not become a flood of diagnostics.
SHOWN_AT_ONCE = 10
MAX_REFUSAL = 1000

# Seconds that a failing node waits for a subscriber of its last message, and for its delivery.
LAST_WORDS = 2.0


class Diagnostics:
    """Counts of a node's messages, published every second and after each refusal."""

    def __init__(self, node: Node) -> None:
        # Numbers of messages.
        self.accepted = 0
        self.refused = 0
        # Number of messages held until another message arrives.
        self.waiting = 0
        # The state of the node in a sentence.
        self.state = 'running'
        # A current problem; empty if there is none.
        self.warning = ''
        # Further values, by key.
        self.values: dict[str, str] = {}
        self._last_refusal = ''
        self._failure = ''
        self._refused_lately = 0
        self._node = node
        # Tools expect this topic name in every namespace.
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, qos.DIAGNOSTICS)
        # A steady clock, since diagnostics continue when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self._publish_all, clock=steady)

    def refuse(self, what: str, why: object) -> None:
        """Count a refused message, and report it unless too many were reported in this period."""
        self.refused += 1
        self._refused_lately += 1
        text = f'{what} refused: {why}'
        self._last_refusal = text if len(text) <= MAX_REFUSAL else f'{text[:MAX_REFUSAL]}...'
        if self._refused_lately <= SHOWN_AT_ONCE:
            self._node.get_logger().warning(self._last_refusal)
            self.publish()

    def _publish_all(self) -> None:
        """Publish the counts, and the number of refusals not reported."""
        not_shown, self._refused_lately = self._refused_lately - SHOWN_AT_ONCE, 0
        if not_shown > 0:
            self._node.get_logger().warning(f'{not_shown} more messages were refused')
        self.publish()

    def fail(self, why: Exception) -> None:
        """Publish the error that ends the node, and wait until subscribers have received it."""
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
        """Publish the counts now."""
        values = {
            'state': self.state,
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
            message=self._failure or self.warning or self._last_refusal or self.state,
            hardware_id='kbnitp_ros',
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
