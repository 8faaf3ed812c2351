# SPDX-License-Identifier: Apache-2.0
"""Who serves a role of the mission: nodes are known by what they publish, whatever their names."""

from __future__ import annotations

from kbnitp_ros.log.evidence import BELIEF, PATH, REPORT
from rclpy.node import Node

# The type of what a node of each role publishes: AGENT/path, AGENT/report, belief, AGENT/recorded.
PUBLISHED = {
    'planner': PATH,
    'agent': REPORT,
    'estimator': BELIEF,
    'recorder': 'builtin_interfaces/msg/Time',
}


class Listeners:
    """
    Who listens to topics, by role.

    Parameters
    ----------
    node : Node
        Looks at the graph: once for each node that listens, however many topics it listens to.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._published: dict[tuple[str, str], set[str]] = {}

    def roles(self, topic: str) -> set[str]:
        """Return the names of the nodes that listen to a topic, and the roles that they serve."""
        roles = set()
        for each in self._node.get_subscriptions_info_by_topic(topic):
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
