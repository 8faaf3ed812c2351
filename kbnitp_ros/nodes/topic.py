# SPDX-License-Identifier: Apache-2.0
"""A topic as the recorder hears it."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
import time
from typing import Any

from kbnitp_ros.bag import check_installed
from kbnitp_ros.log.roles import Role
from kbnitp_ros.nodes.runtime import qos
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

# How many messages of a topic are remembered before it has a second subscription, by which some of
# them may come again. Each of two may be a whole queue behind the other.
RECENT = 1000

# A topic, the bytes that came on it and what rclpy knows of them.
Message = tuple['HeardTopic', bytes, dict[str, Any]]


class Recent:
    """A set that forgets what was added first."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._added: dict[Hashable, None] = {}

    def add(self, each: Hashable) -> None:
        """Remember something; nothing is remembered twice."""
        self._added[each] = None
        while len(self._added) > self.size:
            del self._added[next(iter(self._added))]

    def discard(self, each: Hashable) -> None:
        """Forget something, if it is remembered."""
        self._added.pop(each, None)

    def __contains__(self, each: object) -> bool:
        """Say whether something is remembered."""
        return each in self._added


@dataclass
class HeardTopic:
    """A topic that the recorder hears, and what of it is on record."""

    # Full names; a topic has one type.
    name: str
    type_name: str
    # What it is to the mission; None if nothing.
    role: Role | None = None
    # One for each reliability and durability offered, by these two. A publisher that comes back
    # with others is heard by one more subscription, so that no message is lost while one is
    # replaced, and no history comes twice.
    subscriptions: dict[tuple[Any, Any], Subscription] = field(default_factory=dict)
    # Which messages came last: time sent and hash of the bytes.
    recent: Recent = field(default_factory=lambda: Recent(RECENT))
    # For the paths of an agent and what the operator decides: tells which are on the disk.
    recorded: Publisher | None = None
    # Of those that are written and not acknowledged on `recorded` yet: stamp in nanoseconds, hash
    # of the content, and when the mission began, in nanoseconds.
    unacknowledged: list[tuple[int, int, int]] = field(default_factory=list)

    def is_new(self, sent: int, data: bytes) -> bool:
        """Say whether a message has not come by another subscription, and remember it."""
        message = sent, hash(data)
        if message in self.recent:
            return False
        self.recent.size = qos.DEPTH if len(self.subscriptions) > 1 else RECENT
        self.recent.add(message)
        return True

    def arrived(self) -> list[Iterator[Message]]:
        """Return, by subscription, the messages that wait to be read, but none from now on."""
        now = time.time_ns()
        return [self._taken(each, now) for each in self.subscriptions.values()]

    def _taken(self, subscription: Subscription, end: int) -> Iterator[Message]:
        """Take the messages that came by a subscription until a time, in nanoseconds."""
        handle, kind = subscription.handle, subscription.msg_type
        received = 0
        with handle:
            while received < end and (taken := handle.take_message(kind, True)):
                message = self, *taken
                received = time_received(message)
                yield message


def time_received(message: Message) -> int:
    """Return when a message came, in nanoseconds."""
    _, _, info = message
    return int(info['received_timestamp'])


@cache
def message_class(type_name: str) -> type:
    """Return the Python class of a message type, such as 'nav_msgs/msg/Path'."""
    check_installed(type_name)
    package, kind, name = type_name.split('/')
    try:
        found: type = getattr(import_module(f'{package}.{kind}'), name)
    except (ImportError, AttributeError) as error:
        raise LookupError(f'type {type_name!r} has no Python class: {error}') from error
    return found
