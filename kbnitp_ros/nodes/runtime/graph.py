# SPDX-License-Identifier: Apache-2.0
"""The graph as it can be read, whatever names are in it, and who serves a role of the mission."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from kbnitp_ros.log.evidence import BELIEF, PATH, REPORT
from kbnitp_ros.messages.headers import SHOWN, shown
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.validate_full_topic_name import validate_full_topic_name

Topics = list[tuple[str, list[str]]]


def full_name(namespace: str, name: str) -> str:
    """Return what a node in a namespace is called."""
    return f'{namespace.rstrip("/")}/{name}'


class GraphNode(Node):
    """
    A node whose looks at the graph leave out what rclpy cannot read.

    DDS takes any bytes for the name of a topic or of a type. rclpy raises UnicodeDecodeError for
    the whole graph if one of them is not UTF-8: then this node asks about each ROS node by itself,
    and what belongs to none, or to one that has such a name, is left out.
    """

    def get_topic_names_and_types(self, no_demangle: bool = False) -> Topics:
        """Return the topics that have valid names, and their types."""
        try:
            topics: Topics = super().get_topic_names_and_types(no_demangle)
        except UnicodeDecodeError as error:
            self._refuse_bytes('the graph', error)
            types: dict[str, set[str]] = {}
            for _, name, kinds in self._by_node(self.get_publisher_names_and_types_by_node):
                types.setdefault(name, set()).update(kinds)
            topics = [(name, sorted(kinds)) for name, kinds in types.items()]
        return [each for each in topics if self._is_valid(each[0])]

    def get_publishers_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[Any]:
        """Return the publishers of a topic; of unknown QoS where rclpy cannot read one of them."""
        try:
            return list(super().get_publishers_info_by_topic(topic_name, no_mangle))
        except UnicodeDecodeError as error:
            self._refuse_bytes(topic_name, error)
            return self._endpoints(topic_name, self.get_publisher_names_and_types_by_node)

    def get_subscriptions_info_by_topic(
        self, topic_name: str, no_mangle: bool = False
    ) -> list[Any]:
        """Return the subscriptions to a topic, as `get_publishers_info_by_topic` does."""
        try:
            return list(super().get_subscriptions_info_by_topic(topic_name, no_mangle))
        except UnicodeDecodeError as error:
            self._refuse_bytes(topic_name, error)
            return self._endpoints(topic_name, self.get_subscriber_names_and_types_by_node)

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """Return the names of all nodes; none while rclpy cannot read one of them."""
        try:
            return list(super().get_node_names_and_namespaces())
        except UnicodeDecodeError as error:
            self._refuse_bytes('the graph', error)
            return []

    def authors(self, topic: str, type_name: str) -> list[str]:
        """Return which nodes publish messages of a type on a topic, sorted by their full names."""
        return sorted(
            full_name(each.node_namespace, each.node_name)
            for each in self.get_publishers_info_by_topic(topic)
            if each.topic_type == type_name
        )

    def refuse_once(self, what: str, why: object) -> None:
        """Say once that there is a name that cannot be read."""
        raise NotImplementedError

    def _refuse_bytes(self, what: str, error: UnicodeDecodeError) -> None:
        self.refuse_once(what, f'the name {error.object[:SHOWN]!r} is not UTF-8')

    def _is_valid(self, topic: str) -> bool:
        try:
            validate_full_topic_name(topic)
        except InvalidTopicNameException:
            self.refuse_once('the graph', f'{shown(topic)} is not a valid topic name')
            return False
        return True

    def _endpoints(
        self, topic_name: str, look: Callable[[str, str], Topics]
    ) -> list[TopicEndpointInfo]:
        topic = self.resolve_topic_name(topic_name)
        return [
            TopicEndpointInfo(node_name=name, node_namespace=namespace, topic_type=kind)
            for (name, namespace), found, kinds in self._by_node(look)
            for kind in kinds
            if found == topic
        ]

    def _by_node(
        self, look: Callable[[str, str], Topics]
    ) -> list[tuple[tuple[str, str], str, list[str]]]:
        """Return the node, the name and the types of all topics that a look at nodes finds."""
        found = []
        for node in self.get_node_names_and_namespaces():
            try:
                found += [(node, topic, kinds) for topic, kinds in look(*node)]
            except (RuntimeError, UnicodeDecodeError):
                # It has ended, its name is not known yet, or it is none.
                continue
        return found


# The type of what a node of each role publishes: AGENT/path, AGENT/report, belief, AGENT/recorded.
PUBLISHED = {
    'planner': PATH,
    'agent': REPORT,
    'estimator': BELIEF,
    'recorder': 'kbnitp_msgs/msg/Recorded',
}


class Listeners:
    """
    Who listens to topics, by role.

    The graph is looked at once for each node that listens, however many topics it listens to.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._own = node.get_name(), node.get_namespace()
        self._published: dict[tuple[str, str], set[str]] = {}

    def roles(self, topic: str) -> set[str]:
        """Return the names of others that listen to a topic, and the roles that they serve."""
        roles = set()
        for each in self._node.get_subscriptions_info_by_topic(topic):
            if (each.node_name, each.node_namespace) == self._own:
                continue
            types = self._types_published(each.node_name, each.node_namespace)
            roles |= {role for role, published in PUBLISHED.items() if published in types}
            roles.add(each.node_name)
        return roles

    def _types_published(self, name: str, namespace: str) -> set[str]:
        """Return the types of all that a node publishes."""
        if (name, namespace) not in self._published:
            try:
                topics = self._node.get_publisher_names_and_types_by_node(name, namespace)
            except RuntimeError:
                # It has ended, its name is not known yet, or it is none.
                topics = []
            self._published[name, namespace] = {kind for _, kinds in topics for kind in kinds}
        return self._published[name, namespace]
