# SPDX-License-Identifier: Apache-2.0
"""What a node has accepted, refused and waits for, on the topic diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from kbnitp_ros.nodes import qos
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

PERIOD = 1.0  # seconds


class Diagnostics:
    """
    Counts what comes in and shows it every second, and at once when something is refused.

    Attributes
    ----------
    accepted, refused : int
        Messages so far.
    waiting : int
        Messages held until what they belong to has come.
    state : str
        What the node is doing, in a few words.

    """

    def __init__(self, node: Node) -> None:
        self.accepted = 0
        self.refused = 0
        self.waiting = 0
        self.state = 'running'
        self._last_refusal = ''
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, 'diagnostics', qos.DIAGNOSTICS)
        # Diagnostics go on when simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self.publish, clock=steady)

    def accept(self) -> None:
        """Count one message as accepted."""
        self.accepted += 1

    def refuse(self, what: str, why: object) -> None:
        """Count one message as refused and say so."""
        self.refused += 1
        self._last_refusal = f'{what} refused: {why}'
        self._node.get_logger().warning(self._last_refusal)
        self.publish()

    def publish(self) -> None:
        """Show the counts now."""
        values = {
            'state': self.state,
            'accepted': self.accepted,
            'refused': self.refused,
            'waiting': self.waiting,
        }
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if self.refused else DiagnosticStatus.OK,
            name=self._node.get_fully_qualified_name(),
            message=self._last_refusal or self.state,
            hardware_id='kbnitp_ros',
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
