# SPDX-License-Identifier: Apache-2.0
"""What parameters the nodes of a mission have, asked from each of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
import time
from typing import Any

from kbnitp_ros.messages.headers import shown
from kbnitp_ros.nodes.runtime.graph import full_name
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future
from rclpy.validate_full_topic_name import validate_full_topic_name

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
            if name.startswith(self._namespace):
                self._ask(name)
        for name, inquiry in list(self._inquiries.items()):
            inquiry.pursue()
            if inquiry.over:
                self._inquiries.pop(name).destroy()
                self._over.add(name)

    def _ask(self, name: str) -> None:
        try:
            self._inquiries[name] = Inquiry(self._node, name, self._tell, self._refuse)
        except NameValidationException as error:
            self._over.add(name)
            self._refuse('the name of a node', error)

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
