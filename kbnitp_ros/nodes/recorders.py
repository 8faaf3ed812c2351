# SPDX-License-Identifier: Apache-2.0
"""The recorders of a namespace: which are alive, and whose word counts."""
# A publisher alone may be of a killed process, and anybody can send diagnostics alone.

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import time

from kbnitp_ros.nodes.instances import INSTANCE, Instance, Instances
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

# How long a recorder listens for others before its word counts, in seconds.
LOOK = 1.5


class Recorders:
    """The other recorders of a namespace."""

    def __init__(self, node: MissionNode) -> None:
        self._node = node
        self._topic = node.resolve_topic_name(TOPIC)
        self._namespace = full_name(node.get_namespace(), '')
        self._looks_until = 0.0
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

    def begin(self, log: object) -> None:
        """Tell that this process records from now on."""
        begun = {INSTANCE: self.instances.own, LOG: str(log), BEGUN: str(time.time_ns())}
        self._node.diagnostics.values |= begun
        self._looks_until = time.monotonic() + LOOK

    @property
    def why_silent(self) -> str:
        """Return why the word of this recorder does not count: that of the first one does."""
        if time.monotonic() < self._looks_until:
            return 'word from another recorder'
        own = rank(self._node.diagnostics.values)
        if earlier := [each for each in self.alive if rank(each.values) < own]:
            return f'the end of an earlier recorder, whose word counts: {records(earlier)}'
        return ''


def rank(values: Mapping[str, str]) -> tuple[int, str]:
    """Return when a recorder began, and what tells it from others that did."""
    return int(values[BEGUN]), values[INSTANCE]


def records(recorders: list[Instance]) -> str:
    """Return which recorder writes which log, in words."""
    return ' and '.join(f'node {each.name} records to {each.values[LOG]}' for each in recorders)
