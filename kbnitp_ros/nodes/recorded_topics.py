# SPDX-License-Identifier: Apache-2.0
"""The recorder's subscriptions, and the parameters of the nodes of a mission."""

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
from kbnitp_ros.nodes.runtime.graph import full_name, NAMELESS
from kbnitp_ros.nodes.runtime.node import MissionNode
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.exceptions import NameValidationException
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.validate_full_topic_name import validate_full_topic_name

# Number of messages remembered of a topic with one subscription: a second subscription may deliver
# these messages again. With several subscriptions, `qos.DEPTH` messages are remembered.
RECENT = 1000

# A topic, a serialized message on it, and its info from rclpy.
Message = tuple['RecordedTopic', bytes, dict[str, Any]]


@dataclass
class RecordedTopic:
    """A topic with its subscriptions, and its last messages on record."""

    # Full name of the topic, and its only type.
    name: str
    type_name: str
    # Role of the topic in the mission; None if it has none.
    role: Role | None = None
    # One subscription for each reliability and durability offered. A publisher that returns with
    # another profile gets a further subscription, so that no message is lost during a change and
    # no history arrives twice.
    subscriptions: dict[tuple[Any, Any], Subscription] = field(default_factory=dict)
    # The last messages: source time and hash of the bytes.
    recent: dict[tuple[int, int], None] = field(default_factory=dict)

    def is_new(self, sent: int, data: bytes) -> bool:
        """Return whether no other subscription has delivered this message; remember it."""
        message = sent, hash(data)
        if message in self.recent:
            return False
        self.recent[message] = None
        while len(self.recent) > (qos.DEPTH if len(self.subscriptions) > 1 else RECENT):
            del self.recent[next(iter(self.recent))]
        return True

    def arrived(self) -> list[Iterator[Message]]:
        """Return the unread messages of each subscription, up to now."""
        now = time.time_ns()
        return [self._taken(each, now) for each in self.subscriptions.values()]

    def _taken(self, subscription: Subscription, end: int) -> Iterator[Message]:
        """Yield the unread messages of a subscription up to a time, in nanoseconds."""
        handle, kind = subscription.handle, subscription.msg_type
        received = 0
        with handle:
            while received < end and (taken := handle.take_message(kind, True)):
                message = self, *taken
                received = time_received(message)
                yield message


def time_received(message: Message) -> int:
    """Return when a message was received, in nanoseconds."""
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


# Seconds until the first request to a node, which must have discovered this node by then; until
# the next request if no answer arrives; until the node is given up; and until it is asked anew.
ASK_FIRST = 0.5
ASK_AGAIN = 1.0
GIVE_UP = 5.0
REST = 10.0

# Callbacks: for the full name and parameters of a node; for the subject and reason of a refusal.
Take = Callable[[str, dict[str, Any]], None]
Refuse = Callable[[str, object], None]


class ParameterWatch:
    """Requests for the parameters of all nodes of a namespace, without blocking."""

    def __init__(self, node: MissionNode, namespace: str, take: Take, refuse: Refuse) -> None:
        self._node = node
        self._namespace = namespace
        self._take = take
        self._refuse = refuse
        # Full names of the nodes in the graph at the last scan.
        self.present: Counter[str] = Counter()
        self._due: set[str] = set()
        self._inquiries: dict[str, Inquiry] = {}
        self._over: set[str] = set()
        # Nodes that were given up, each with the time from which it is asked anew.
        self._resting: dict[str, float] = {}
        self._nameless_since = 0.0
        node.create_subscription(
            ParameterEvent, '/parameter_events', self._on_event, qos_profile_parameter_events
        )

    def look(self) -> None:
        """Send the requests that are due; to be called repeatedly."""
        present = Counter(
            full_name(namespace, name)
            for name, namespace in self._node.get_node_names_and_namespaces()
        )
        self._due |= (present - self.present).keys()
        self.present = present
        now = time.monotonic()
        for name in [name for name, until in self._resting.items() if now > until]:
            del self._resting[name]
            if name in present:
                self._due.add(name)
        # A node with an open request stays due until the request is over.
        for name in self._due - self._inquiries.keys():
            self._due.remove(name)
            if not name.startswith(self._namespace):
                continue
            try:
                self._inquiries[name] = Inquiry(self._node, name, self._take, self._refuse)
            except NameValidationException as error:
                self._over.add(name)
                self._refuse('the name of a node', error)
        for name, inquiry in list(self._inquiries.items()):
            inquiry.pursue()
            if inquiry.over:
                self._inquiries.pop(name).destroy()
                self._over.add(name)
                if not inquiry.is_answered:
                    # On a busy machine nodes may discover each other late.
                    self._resting[name] = now + REST

    def is_over(self, name: str) -> bool:
        """Return whether a node has answered, was given up, or is foreign: no more requests."""
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
            changed = {
                each.name: parameter_value_to_python(each.value)
                for each in event.changed_parameters
            }
        except NameValidationException:
            self._refuse('/parameter_events', f'{shown(event.node)} is not a valid node name')
            return
        except (ValueError, RuntimeError) as error:
            self._refuse('/parameter_events', error)
            return
        # An event of a node that is not in the graph may be forged.
        if event.node in self.present:
            self._due.add(event.node)
            if event.node.startswith(self._namespace):
                # The values may change again before the node answers.
                self._take(event.node, changed)


class Inquiry:
    """A request for all parameters of one node."""

    def __init__(self, node: MissionNode, name: str, take: Take, refuse: Refuse) -> None:
        # Whether the request has an answer, or has been given up.
        self.over = self.is_answered = False
        self._node = node
        self._name = name
        self._take = take
        self._refuse = refuse
        self._names = node.create_client(ListParameters, f'{name}/list_parameters')
        self._values = node.create_client(GetParameters, f'{name}/get_parameters')
        now = time.monotonic()
        self._ask_at = now + ASK_FIRST
        self._end_at = now + GIVE_UP

    def pursue(self) -> None:
        """Send the request if the node is ready and the last request was not answered in time."""
        now = time.monotonic()
        self.over = self.over or now > self._end_at
        ready = self._names.service_is_ready() and self._values.service_is_ready()
        if ready and now >= self._ask_at and not self.over:
            self._ask_at = now + ASK_AGAIN
            answer = self._names.call_async(ListParameters.Request())
            answer.add_done_callback(self._node.guarded(self._on_names))

    # The executor may call back once more after the clients were destroyed.

    def _on_names(self, answer: Future) -> None:
        if self.over:
            return
        names = answer.result().result.names
        values = self._values.call_async(GetParameters.Request(names=names))
        values.add_done_callback(self._node.guarded(partial(self._on_values, names)))

    def _on_values(self, names: Sequence[str], answer: Future) -> None:
        if self.over:
            return
        self.over = self.is_answered = True
        try:
            values = [parameter_value_to_python(value) for value in answer.result().values]
        except (ValueError, RuntimeError) as error:
            self._refuse(f'{self._name}/get_parameters', error)
        else:
            self._take(self._name, dict(zip(names, values)))

    def destroy(self) -> None:
        """Destroy the clients, so that later answers are ignored."""
        self._node.destroy_client(self._names)
        self._node.destroy_client(self._values)
