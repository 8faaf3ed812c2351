# SPDX-License-Identifier: Apache-2.0
"""Whether another node has the name of this one, as when two robots are given one."""

from __future__ import annotations

import time

from kbnitp_ros.nodes.instances import INSTANCE, Instances, SILENT
from kbnitp_ros.nodes.runtime.node import MissionNode

OWN_NAME = 'each robot needs its own (parameter agent and the namespace)'


class DuplicateNames:
    """Listens for diagnostics that tell the name of this node, and are not its own."""

    def __init__(self, node: MissionNode, topic: str) -> None:
        self._node = node
        self._topic = topic
        self._seen_since: float | None = None
        own_name = node.get_fully_qualified_name()
        self._others = Instances(node, lambda name, _: name == own_name)
        node.diagnostics.values[INSTANCE] = self._others.own

    @property
    def heard(self) -> str:
        """Return that another node of this name is alive; empty if none was heard just now."""
        if not self._others.alive:
            return ''
        return f'another {self._node.get_fully_qualified_name()} is heard, and {OWN_NAME}'

    @property
    def awaited(self) -> str:
        """Return that another node of this name must end first; empty if none is alive."""
        own = self._node.get_name(), self._node.get_namespace()
        known = self._node.get_publishers_info_by_topic(self._topic)
        same = sum((each.node_name, each.node_namespace) == own for each in known)
        now = time.monotonic()
        if same <= 1:
            self._seen_since = None
            return ''
        self._seen_since = self._seen_since or now
        if now > self._seen_since + SILENT and not self._others.alive:
            return ''
        return (
            f'the other {self._node.get_fully_qualified_name()} to end: {same} nodes '
            f'have this name, and {OWN_NAME}'
        )
