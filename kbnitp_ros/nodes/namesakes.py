# SPDX-License-Identifier: Apache-2.0
"""Whether another node has the name of this one, as when two robots are given one."""

from __future__ import annotations

from math import inf
import time
from uuid import uuid4

from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.diagnostics import TOPIC
from kbnitp_ros.nodes.shell import Shell

INSTANCE = 'instance'

# Seconds without diagnostics after which a node of this name is taken for dead. DDS knows of one
# that was killed for much longer, and one that lives says something every second.
SILENT = 3.0

OWN_NAME = 'each robot needs its own (parameter agent and the namespace)'

# The most bytes of diagnostics.
LARGEST = 2**20


class Namesakes:
    """
    Listens for diagnostics that tell the name of this node, and are not its own.

    Parameters
    ----------
    node : Shell
        This one.
    topic : str
        One that it publishes on, and so do its namesakes.

    """

    def __init__(self, node: Shell, topic: str) -> None:
        self._node = node
        self._topic = topic
        self._instance = uuid4().hex
        node.diagnostics.values[INSTANCE] = self._instance
        self._heard_at = -inf
        self._seen_since: float | None = None
        node.hear_newest(DiagnosticArray, TOPIC, self._on_diagnostics, qos.DIAGNOSTICS, LARGEST)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            told = {each.key: each.value for each in status.values}
            is_other = told.get(INSTANCE, self._instance) != self._instance
            if is_other and status.name == self._node.get_fully_qualified_name():
                self._heard_at = time.monotonic()

    @property
    def heard(self) -> str:
        """Return that another node of this name is alive; empty if none was heard just now."""
        if time.monotonic() > self._heard_at + SILENT:
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
        if now > max(self._seen_since, self._heard_at) + SILENT:
            return ''
        return (
            f'waiting for the other {self._node.get_fully_qualified_name()} to end: {same} nodes '
            f'have this name, and {OWN_NAME}'
        )
