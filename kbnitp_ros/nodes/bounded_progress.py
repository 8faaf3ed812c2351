# SPDX-License-Identifier: Apache-2.0
"""The progress of a mission with the bound of its next plan."""

from __future__ import annotations

from math import isnan, nan

from kbnitp_msgs.msg import Progress
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode


class BoundedProgress:
    """Publishes the estimator's progress once more, with the bound that the plan came with."""

    def __init__(self, node: FieldNode) -> None:
        self._publisher = node.create_publisher(Progress, 'progress', qos.LATCHED)
        self._heard: Progress | None = None
        # The belief planned on, by its stamp, and the bound.
        self._bound = -1, nan
        node.hear(Progress, 'progress', self._on_progress, qos.LATCHED)

    def show(self, stamp: int, upper_bound: float) -> None:
        """Take note of the bound of paths, in nats, given the belief of a stamp."""
        self._bound = stamp, upper_bound
        self._publish()

    def _on_progress(self, message: Progress) -> None:
        # What this planner published itself has a bound.
        if isnan(message.upper_bound):
            self._heard = message
            self._publish()

    def _publish(self) -> None:
        stamp, upper_bound = self._bound
        if self._heard and from_stamp(self._heard.header.stamp) == stamp:
            self._heard.upper_bound = upper_bound
            self._publisher.publish(self._heard)
            self._heard.upper_bound = nan
