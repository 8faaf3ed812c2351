# SPDX-License-Identifier: Apache-2.0
"""Whether robots may depart, as the planner tells all agents."""

from __future__ import annotations

from collections.abc import Callable

from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import MissionNode
from std_msgs.msg import Bool

TOPIC = 'hold'
BOOL = 'std_msgs/msg/Bool'


class Hold:
    """What an agent is told: it lets robots depart once it has heard that none is held."""

    def __init__(
        self, node: MissionNode, prefix: str, act: Callable[[], None] = lambda: None
    ) -> None:
        self._act = act
        self._is_held: bool | None = None
        above = node.get_namespace().rpartition('/')[0]
        self._topic = node.resolve_topic_name(TOPIC if prefix else f'{above}/{TOPIC}')
        node.hear(Bool, self._topic, self._on_hold, qos.LATCHED)

    def _on_hold(self, message: Bool) -> None:
        self._is_held = message.data
        self._act()

    @property
    def awaited(self) -> str:
        """Return what keeps robots from departing; empty when nothing does."""
        if self._is_held is None:
            return f'the planner to tell on {self._topic} whether robots may depart'
        return f'the operator to end the pause ({self._topic} is true)' * self._is_held


class Holding:
    """What the planner tells all agents."""

    def __init__(self, node: MissionNode) -> None:
        self._node = node
        self._is_held: bool | None = None
        self._publisher = node.create_publisher(Bool, TOPIC, qos.LATCHED)
        node.hear(Bool, TOPIC, self._on_hold, qos.LATCHED)

    def tell(self, is_held: bool) -> None:
        """Have no robot depart from now on, or let them."""
        if is_held != self._is_held:
            self._is_held = is_held
            self._publisher.publish(Bool(data=is_held))

    def _on_hold(self, message: Bool) -> None:
        if self._is_held is None or message.data == self._is_held:
            return
        others = self._node.authors(self._publisher.topic_name, BOOL)
        # What was told just before is heard, too.
        if len(others) > 1:
            self._node.diagnostics.refuse(
                TOPIC,
                f'data is {message.data}, and this planner says {self._is_held}, which holds: '
                f'nodes {", ".join(others)} publish it',
            )
            self._publisher.publish(Bool(data=self._is_held))
