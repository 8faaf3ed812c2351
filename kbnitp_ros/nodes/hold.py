# SPDX-License-Identifier: Apache-2.0
"""Whether robots may depart, as the planner tells all agents."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
import time

from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import MissionNode
from std_msgs.msg import Bool

TOPIC = 'hold'
BOOL = 'std_msgs/msg/Bool'

# Least time between two answers to others, in seconds.
MIN_PAUSE = 0.1

# How long the graph may take to name the author of a message that was received, in seconds.
MAX_UNNAMED = 30.0


class Hold:
    """The planner's word on departures: none without it, in a pause, or if others publish it."""

    def __init__(self, node: MissionNode, act: Callable[[], None] = lambda: None) -> None:
        self._node = node
        self._act = act
        self.is_held: bool | None = None
        self._topic = node.resolve_topic_name(f'{node.above}/{TOPIC}')
        node.hear(Bool, self._topic, self._on_hold, qos.LATCHED)

    def _on_hold(self, message: Bool) -> None:
        self.is_held = message.data
        self._act()

    @property
    def awaited(self) -> str:
        """Return the condition that blocks departures; empty if there is none."""
        if self.is_held is None:
            return f'the planner to tell on {self._topic} whether robots may depart'
        if self.is_held:
            return f'the operator to end the pause ({self._topic} is true)'
        # A planner that was killed stays in the graph beside its successor, of the same name.
        if self._node.count_authors(self._topic, BOOL) > 1:
            others = sorted({*self._node.authors(self._topic, BOOL)})
            if len(others) > 1:
                return f'one node alone to publish {self._topic}: {", ".join(others)} do'
        return ''


class Holding:
    """The planner's publisher of `hold`; another value is answered with the planner's own."""

    def __init__(self, node: MissionNode) -> None:
        self._node = node
        self._is_held: bool | None = None
        self._is_contradicted = False
        self._published_at = self._heard_at = -inf
        self._publisher = node.create_publisher(Bool, TOPIC, qos.LATCHED)
        node.hear(Bool, TOPIC, self._on_hold, qos.LATCHED)
        node.create_poll(self._answer)

    def tell(self, is_held: bool) -> None:
        """Publish whether departures are held, if that has changed."""
        if is_held != self._is_held:
            self._is_held = is_held
            self._publish()

    def _publish(self) -> None:
        self._is_contradicted = False
        self._published_at = time.monotonic()
        self._publisher.publish(Bool(data=self._is_held))

    def _on_hold(self, message: Bool) -> None:
        if self._is_held is not None and message.data != self._is_held:
            self._is_contradicted = True
            self._heard_at = time.monotonic()
            self._answer()

    def _answer(self) -> None:
        """Publish the own value after another one, and refuse that once its author is known."""
        now = time.monotonic()
        if self._is_contradicted and now > self._published_at + MIN_PAUSE:
            self._publish()
        if now > self._heard_at + MAX_UNNAMED:
            return
        others = self._node.authors(self._publisher.topic_name, BOOL)
        # An own value from before the last change is received, too.
        if len(others) > 1:
            self._heard_at = -inf
            self._node.diagnostics.refuse(
                TOPIC,
                f'data is {not self._is_held}, and this planner says {self._is_held}, which '
                f'holds: nodes {", ".join(others)} publish it',
            )
