# SPDX-License-Identifier: Apache-2.0
"""Which other processes are alive that have the name or the task of a node."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import time
from uuid import uuid4

from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import TOPIC
from kbnitp_ros.nodes.runtime.node import MissionNode

INSTANCE = 'instance'

# Seconds without diagnostics after which a node is taken for dead. DDS knows of one that was
# killed for much longer, and one that lives says something every second.
SILENT = 3.0

# Of how many other instances the newest are kept.
MOST_INSTANCES = 10


@dataclass(frozen=True)
class Instance:
    """Another process."""

    # The full name of its node.
    name: str
    # What its diagnostics told last.
    values: Mapping[str, str]
    # When that was, as `time.monotonic` tells it.
    heard_at: float


class Instances:
    """Listens for diagnostics that name an instance other than the one of this process."""

    def __init__(
        self, node: MissionNode, is_meant: Callable[[str, Mapping[str, str]], bool]
    ) -> None:
        # Names the instance of this process.
        self.own = uuid4().hex
        self._is_meant = is_meant
        self._heard: dict[str, Instance] = {}
        node.hear_newest(DiagnosticArray, TOPIC, self._on_diagnostics, qos.DIAGNOSTICS)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            values = {each.key: each.value for each in status.values}
            instance = values.get(INSTANCE, self.own)
            if instance == self.own or not self._is_meant(status.name, values):
                continue
            self._heard.pop(instance, None)
            self._heard[instance] = Instance(status.name, values, time.monotonic())
            if len(self._heard) > MOST_INSTANCES:
                del self._heard[next(iter(self._heard))]

    @property
    def alive(self) -> list[Instance]:
        """Return the others that were heard just now."""
        since = time.monotonic() - SILENT
        return [each for each in self._heard.values() if each.heard_at >= since]
