# SPDX-License-Identifier: Apache-2.0
"""What the recorder hears: topics, and the parameters of the nodes of a mission."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
import time
from typing import Any

from kbnitp_ros.log.roles import Role
from kbnitp_ros.log.schema import check_installed
from kbnitp_ros.messages.headers import shown
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.graph import full_name
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_parameter_events
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.validate_full_topic_name import validate_full_topic_name

# How many messages of a topic are remembered before it has a second subscription, by which some of
# them may come again. Each of two may be a whole queue behind the other.
RECENT = 1000

# A topic, the bytes that came on it and what rclpy knows of them.
Message = tuple['HeardTopic', bytes, dict[str, Any]]


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
    recent: dict[tuple[int, int], None] = field(default_factory=dict)
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
        self.recent[message] = None
        while len(self.recent) > (qos.DEPTH if len(self.subscriptions) > 1 else RECENT):
            del self.recent[next(iter(self.recent))]
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


# In seconds: when a node is asked first, so that it has found whom to answer; when one that does
# not answer is asked again; and when it is left alone.
ASK_FIRST = 0.5
ASK_AGAIN = 1.0
GIVE_UP = 5.0

# What ROS calls a node whose publishers are known already, but not its name; and for good what is
# no ROS node.
NAMELESS = '_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_'

# Called with the full name of a node and its parameters, and with what was refused and why.
Tell = Callable[[str, dict[str, Any]], None]
Refuse = Callable[[str, object], None]


class ParameterWatch:
    """Asks the nodes of a namespace for their parameters, and never waits for an answer."""

    def __init__(self, node: Node, namespace: str, tell: Tell, refuse: Refuse) -> None:
        self._node = node
        self._namespace = namespace
        self._tell = tell
        self._refuse = refuse
        self._present: Counter[str] = Counter()
        self._due: set[str] = set()
        self._inquiries: dict[str, Inquiry] = {}
        self._over: set[str] = set()
        self._nameless_since = 0.0
        node.create_subscription(
            ParameterEvent, '/parameter_events', self._on_event, qos_profile_parameter_events
        )

    def look(self) -> None:
        """Ask those that are to be asked; to be called again and again."""
        present = Counter(
            full_name(namespace, name)
            for name, namespace in self._node.get_node_names_and_namespaces()
        )
        self._due |= (present - self._present).keys()
        self._present = present
        # Those that are being asked are due again when that is over.
        for name in self._due - self._inquiries.keys():
            self._due.remove(name)
            if not name.startswith(self._namespace):
                continue
            try:
                self._inquiries[name] = Inquiry(self._node, name, self._tell, self._refuse)
            except NameValidationException as error:
                self._over.add(name)
                self._refuse('the name of a node', error)
        for name, inquiry in list(self._inquiries.items()):
            inquiry.pursue()
            if inquiry.over:
                self._inquiries.pop(name).destroy()
                self._over.add(name)

    def is_present(self, name: str) -> bool:
        """Return whether a node was in the graph at the last look."""
        return name in self._present

    def is_over(self, name: str) -> bool:
        """Return whether a node has once told its parameters, will not or is not to be asked."""
        if name == NAMELESS:
            self._nameless_since = self._nameless_since or time.monotonic()
            return time.monotonic() > self._nameless_since + GIVE_UP
        if name in self._over or not name.startswith(self._namespace):
            return True
        if name not in self._inquiries:
            self._due.add(name)
        return False

    def _on_event(self, event: ParameterEvent) -> None:
        try:
            validate_full_topic_name(event.node)
        except NameValidationException:
            self._refuse('/parameter_events', f'no node is called {shown(event.node)}')
        # What anybody says of a node that is not there is no reason to look for it.
        if event.node in self._present:
            self._due.add(event.node)


class Inquiry:
    """Asks one node for all its parameters."""

    def __init__(self, node: Node, name: str, tell: Tell, refuse: Refuse) -> None:
        # Whether it has answered, or has not for too long.
        self.over = False
        self._node = node
        self._name = name
        self._tell = tell
        self._refuse = refuse
        self._names = node.create_client(ListParameters, f'{name}/list_parameters')
        self._values = node.create_client(GetParameters, f'{name}/get_parameters')
        now = time.monotonic()
        self._ask_at = now + ASK_FIRST
        self._end_at = now + GIVE_UP

    def pursue(self) -> None:
        """Ask if the node can be asked, unless an answer may still come."""
        now = time.monotonic()
        self.over = self.over or now > self._end_at
        ready = self._names.service_is_ready() and self._values.service_is_ready()
        if ready and now >= self._ask_at and not self.over:
            self._ask_at = now + ASK_AGAIN
            answer = self._names.call_async(ListParameters.Request())
            answer.add_done_callback(self._on_names)

    def _on_names(self, answer: Future) -> None:
        names = answer.result().result.names
        values = self._values.call_async(GetParameters.Request(names=names))
        values.add_done_callback(partial(self._on_values, names))

    def _on_values(self, names: Sequence[str], answer: Future) -> None:
        self.over = True
        try:
            values = [parameter_value_to_python(value) for value in answer.result().values]
        except (ValueError, RuntimeError) as error:
            self._refuse(f'{self._name}/get_parameters', error)
        else:
            self._tell(self._name, dict(zip(names, values)))

    def destroy(self) -> None:
        """Take no more answers."""
        self._node.destroy_client(self._names)
        self._node.destroy_client(self._values)
