# SPDX-License-Identifier: Apache-2.0
"""The paths that an agent is sent, each as it is on record, and its departures."""
# Of several paths of one stamp all nodes take the one that the recorder names. An acknowledgement
# before its path is not kept, since anybody can send any number: the publisher keeps it and is
# asked again.

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Generic, TypeVar

from kbnitp_msgs.msg import Recorded
from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.headers import from_stamp, read_name
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from nav_msgs.msg import Path
from rclpy.subscription import Subscription

P = TypeVar('P')

# Seconds after which AGENT/recorded is asked for again, at first and at the most.
ASK_FIRST, ASK_LAST = 1.0, 60.0


class RecordedPaths(Generic[P]):
    """The paths that an agent is sent."""

    def __init__(
        self,
        node: FieldNode,
        agent: str,
        read: Callable[[Path], P | None],
        take: Callable[[P], None],
    ) -> None:
        self._node = node
        self._agent = agent
        self._read = read
        self._take = take
        # Paths that the recorder has not named, by stamp and content.
        self._pending: dict[tuple[int, int], P] = {}
        # What follows from departures that the recorder has not named, by stamp and content.
        self._departures: dict[tuple[int, int], Callable[[], None]] = {}
        self._has_missed = False
        self._interval = ASK_FIRST
        self._ask_at = 0.0

    def listen(self) -> None:
        """Take paths from now on."""
        self._node.hear_agent(Path, self._agent, self._on_path)
        if self._node.values['recorded']:
            self._recorded = self._hear_recorded()
            self._node.create_poll(self._ask_again)

    @property
    def pending(self) -> int:
        """How many paths the recorder has not named."""
        return len(self._pending)

    @property
    def awaited(self) -> str:
        """Return what the first of these waits for; empty when there is none."""
        if not self._pending:
            return ''
        stamp, _ = next(iter(self._pending))
        return (
            f'the recorder to tell on {self._agent}/recorded that the path of '
            f'{DeploymentKey(self._agent, stamp)} is on disk (parameter recorded)'
        )

    def when_recorded(self, stamp: int, content: int, depart: Callable[[], None]) -> None:
        """Have a robot move when its departure is on record; at once without that parameter."""
        if self._node.values['recorded']:
            self._departures[stamp, content] = depart
        else:
            depart()

    def _hear_recorded(self) -> Subscription:
        self._has_missed = False
        self._ask_at = time.monotonic() + self._interval
        return self._node.hear_agent(Recorded, self._agent, self._on_recorded)

    def _on_path(self, message: Path) -> None:
        try:
            path = self._read(message)
            if path is None:
                return
            if not self._node.values['recorded']:
                self._take(path)
                return
        except ValueError as error:
            self._refuse(error)
            return
        if not self._pending:
            self._ask_at = time.monotonic() + self._interval
        self._pending[from_stamp(message.header.stamp), content_hash(message)] = path
        if len(self._pending) > qos.DEPTH:
            stamp, content = next(iter(self._pending))
            self._drop(stamp, content, f'{qos.DEPTH} later paths wait to be recorded as well')

    def _on_recorded(self, message: Recorded) -> None:
        try:
            stamp = read_name('stamp', message.stamp)
        except ValueError as error:
            self._node.diagnostics.refuse(f'{self._agent}/recorded', error)
            return
        if depart := self._departures.pop((stamp, message.content), None):
            depart()
            return
        path = self._pending.pop((stamp, message.content), None)
        if path is None:
            self._has_missed = True
            return
        self._interval = ASK_FIRST
        for other in [content for each, content in self._pending if each == stamp]:
            self._drop(stamp, other, 'another path with the same stamp was recorded first')
        try:
            self._take(path)
        except ValueError as error:
            self._refuse(error)

    def _drop(self, stamp: int, content: int, why: str) -> None:
        del self._pending[stamp, content]
        self._refuse(ValueError(f'deployment {DeploymentKey(self._agent, stamp)}: {why}'))

    def _refuse(self, error: ValueError) -> None:
        self._node.diagnostics.refuse(f'{self._agent}/path', error)

    def _ask_again(self) -> None:
        """Have the recorder say again what it said before a path came."""
        if self._pending and self._has_missed and time.monotonic() > self._ask_at:
            self._interval = min(2 * self._interval, ASK_LAST)
            self._node.destroy_subscription(self._recorded)
            self._recorded = self._hear_recorded()
