# SPDX-License-Identifier: Apache-2.0
"""The recorders of a namespace: which are alive, and which of several goes on."""
# A publisher alone may be of a killed process, and anybody can send diagnostics alone.

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import time

from kbnitp_msgs.msg import Recorded
from kbnitp_ros.nodes.instances import INSTANCE, Instance, Instances, SILENT
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import waiting_for
from kbnitp_ros.nodes.runtime.graph import full_name, PUBLISHED
from kbnitp_ros.nodes.runtime.node import MissionNode

# Every recorder publishes it from its start to its end, and no other node does.
TOPIC = 'operator/recorded'

# What the diagnostics of one tell that records: its log, and since when, in nanoseconds.
LOG = 'log'
BEGUN = 'begun'

# The most characters of these; more is nothing that a recorder tells.
LONGEST_PATH = 4096
LONGEST_TIME = 20

# In seconds: how long a recorder looks for another one before it opens its log; how long after it
# began it hears those that began as well before it compares, and until when it gives way.
LOOK = 1.0
COMPARE_FROM = 1.0
COMPARE_UNTIL = 10.0


class Recorders:
    """The recorders of a namespace, without this process."""

    def __init__(self, node: MissionNode) -> None:
        self._node = node
        self._topic = node.resolve_topic_name(TOPIC)
        self._namespace = full_name(node.get_namespace(), '')
        # Those that are heard.
        self.instances = Instances(node, self._is_recording)

    def _is_recording(self, name: str, values: Mapping[str, str]) -> bool:
        begun = values.get(BEGUN, '')
        is_time = begun.isdecimal() and len(begun) <= LONGEST_TIME
        is_here = name.rpartition('/')[0] == self._namespace.rstrip('/')
        return is_here and is_time and len(values.get(LOG, '')) <= LONGEST_PATH

    @property
    def publishers(self) -> Counter[str]:
        """Return how often each node publishes what only recorders do, this process left out."""
        own = sum(each.topic_name == self._topic for each in self._node.publishers)
        if self._node.count_publishers(self._topic) <= own:
            return Counter()
        known = self._node.authors(self._topic, PUBLISHED['recorder'])
        return Counter(known) - Counter({self._node.get_fully_qualified_name(): own})

    @property
    def alive(self) -> list[Instance]:
        """Return those that record now, no more of a name than publish."""
        alive = []
        if heard := self.instances.alive:
            publishers = self.publishers
            for each in heard:
                if publishers[each.name]:
                    publishers[each.name] -= 1
                    alive.append(each)
        return alive


class AnotherRecorderError(OSError):
    """Another recorder of the namespace records already."""


class Precedence:
    """Sees that a namespace has one recorder: the one that has recorded for longest."""

    def __init__(self, node: MissionNode) -> None:
        self._node = node
        self._others = Recorders(node)
        self._values = node.diagnostics.values
        self._values[INSTANCE] = self._others.instances.own
        # Of `operator/recorded`, by which other nodes find recorders in the graph.
        self.publisher = node.create_publisher(Recorded, TOPIC, qos.EVIDENCE)
        self._begun_at = self._checked_at = 0.0

    def wait(self) -> None:
        """Look for another recorder before the log is opened."""
        looked_since = time.monotonic()

        def is_over() -> bool:
            for other in self._others.alive:
                raise AnotherRecorderError(
                    f'another recorder is alive: node {other.name} records to '
                    f'{other.values[LOG]}. A mission has one recorder: end that one before, or '
                    'start this one in another namespace'
                )
            waited = time.monotonic() - looked_since
            if not (silent := self._others.publishers):
                return waited > LOOK
            if waited > LOOK:
                self._node.diagnostics.state = waiting_for(
                    f'word from node {", ".join(silent)}, at most {SILENT:.0f} s: it publishes '
                    f'{TOPIC} as well, and may be a recorder that was killed'
                )
            return waited > SILENT

        self._node.diagnostics.state = waiting_for('word from another recorder')
        self._node.spin_until(is_over)
        if silent := self._others.publishers:
            self._node.get_logger().warning(
                f'nothing was heard for {SILENT:.0f} s from node {", ".join(silent)}, which '
                f'publishes {TOPIC} as well: it is taken for a recorder that was killed'
            )

    def begin(self, log: object) -> None:
        """Tell that this process records from now on."""
        self._values[LOG] = str(log)
        self._values[BEGUN] = str(time.time_ns())
        self._begun_at = self._checked_at = time.monotonic()
        self._node.diagnostics.publish()

    def check(self) -> None:
        """Give way to one that has recorded for longer, soon after the beginning; warn later."""
        # Others could not know of a process that was stopped for a while: it begins again.
        now = time.monotonic()
        if now > self._checked_at + SILENT:
            self.begin(self._values[LOG])
        self._checked_at = now
        others = self._others.alive
        self._warn(f'this is not the only recorder: {records(others)}' if others else '')
        age = now - self._begun_at
        if COMPARE_FROM < age < COMPARE_UNTIL:
            own = self._rank(self._values)
            # What was heard before may be from one that has given way to this one.
            since = self._begun_at + COMPARE_FROM
            for other in others:
                if other.heard_at > since and self._rank(other.values) < own:
                    raise AnotherRecorderError(
                        f'node {other.name} has recorded for longer, to {other.values[LOG]}: '
                        f'this recorder ends, and its log {self._values[LOG]} with it. A mission '
                        f'has one recorder: go on from {other.values[LOG]}'
                    )

    def _warn(self, warning: str) -> None:
        if warning and not self._node.diagnostics.warning:
            self._node.get_logger().warning(warning)
        self._node.diagnostics.warning = warning

    def _rank(self, values: Mapping[str, str]) -> tuple[int, str]:
        return int(values[BEGUN]), values[INSTANCE]


def records(recorders: list[Instance]) -> str:
    """Return which recorder writes which log, in words."""
    return ' and '.join(f'node {each.name} records to {each.values[LOG]}' for each in recorders)
