# SPDX-License-Identifier: Apache-2.0
"""The lifecycle state of another node, where it has one."""

from __future__ import annotations

import time

from kbnitp_ros.messages.headers import shown
from kbnitp_ros.nodes.runtime.node import MissionNode
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.task import Future

PERIOD = 1.0  # seconds from one question to the next


class Lifecycle:
    """Asks another node, by its full name, for its lifecycle state."""

    def __init__(self, node: MissionNode, name: str) -> None:
        self._node = node
        self._name = name
        self._client = node.create_client(GetState, f'{name}/get_state')
        self._state: State | None = None
        self._asked_at = 0.0

    @property
    def is_there(self) -> bool:
        """Whether the node is there and has a lifecycle."""
        return self._client.service_is_ready()

    @property
    def awaited(self) -> str:
        """Return what the node must tell before it is active; empty if it is, or tells nothing."""
        if not self.is_there:
            return ''
        now = time.monotonic()
        if now > self._asked_at + PERIOD:
            if now > self._asked_at + 2 * PERIOD:
                # What it said before nobody asked for a while may hold no more.
                self._state = None
            self._asked_at = now
            answer = self._client.call_async(GetState.Request())
            answer.add_done_callback(self._node.guarded(self._on_answer))
        if self._state is None:
            return f'{self._name} to tell its lifecycle state'
        if self._state.id == State.PRIMARY_STATE_ACTIVE:
            return ''
        return f'{self._name} to be active: its lifecycle state is {shown(self._state.label)}'

    def _on_answer(self, answer: Future) -> None:
        self._state = answer.result().current_state
