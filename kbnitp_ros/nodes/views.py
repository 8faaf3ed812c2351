# SPDX-License-Identifier: Apache-2.0
"""The published views of a belief: its maps and its progress."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from kbnitp_msgs.msg import Progress
from kbnitp_ros.core import DeploymentKey, Estimator, Ledger, World
from kbnitp_ros.messages.grids import (
    check_filter,
    filter_info,
    occupancy_grid,
    read_occupancy_grid,
)
from kbnitp_ros.messages.progress import MissionStatus, NOT_KNOWN, progress_message
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.publisher import Publisher

# Minimum seconds between two publications of the views, which cost more than a small belief.
PERIOD = 0.5


class Views:
    """The grids and progress of an estimator's last belief, published at most every `PERIOD`."""

    def __init__(self, node: FieldNode, agents: Sequence[str]) -> None:
        self._node = node
        self._truth: dict[str, NDArray[np.bool_]] = {}
        self._newest: tuple[list[DeploymentKey], Estimator] | None = None
        # The belief to publish next: its ledger, the belief before it, and its stamp. The ledger
        # has not changed when it is published, since every change is passed to `show`.
        self._pending: tuple[Ledger, tuple[list[DeploymentKey], Estimator] | None, int] | None = (
            None
        )
        self._message = Progress()
        self._status = NOT_KNOWN
        self._is_progress_pending = False
        self._maps = {
            name: node.create_publisher(OccupancyGrid, f'belief/{name}', qos.LATCHED)
            for name in ('hazard', 'target', 'kappa')
        }
        # The mask of Nav2's costmap filters, if one is announced.
        self._mask: Publisher | None = None
        self._progress = node.create_publisher(Progress, 'progress', qos.LATCHED)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self._on_timer, clock=steady, autostart=False)
        for name in ('hazard', 'target'):
            for topic in (f'truth/{name}', f'{agents[0]}/truth/{name}'):
                take = partial(self._on_truth, topic, name)
                node.subscribe(OccupancyGrid, topic, take, qos.LATCHED)

    def announce_mask(self, filter_type: int, base: float, multiplier: float) -> None:
        """Publish the hazard map as the mask of a Nav2 costmap filter as well."""
        from nav2_msgs.msg import CostmapFilterInfo

        node = self._node
        check_filter(node.grid, filter_type, base, multiplier)
        self._mask = node.create_publisher(OccupancyGrid, 'belief/hazard_mask', qos.LATCHED)
        info = node.create_publisher(CostmapFilterInfo, 'belief/costmap_filter_info', qos.LATCHED)
        topic = self._mask.topic_name
        info.publish(filter_info(filter_type, base, multiplier, topic, node.now()))

    def show_status(self, status: MissionStatus) -> None:
        """Publish how the mission stands, if that has changed."""
        # Time and texts do not matter to tools that draw curves.
        if (before := self._status) != status:
            self._status = status
            names = ('state', 'ordered', 'out', 'reason')
            changes = {name: getattr(status, name) for name in names}
            for name, value in changes.items():
                setattr(self._message, name, value)
            if all(value == getattr(before, name) for name, value in changes.items()):
                return
            # Before the first belief there is no progress to publish.
            self._is_progress_pending = self._newest is not None
            self._publish_or_wait()

    def _on_truth(self, topic: str, name: str, message: OccupancyGrid) -> None:
        try:
            truth = read_occupancy_grid(message) > 0.0
            if truth.size != self._node.grid.cells:
                raise ValueError(
                    f'data has {truth.size} values: the grid has {self._node.grid.cells} cells'
                )
        except ValueError as error:
            self._node.diagnostics.refuse(topic, error)
        else:
            self._truth[name] = truth

    def show(self, ledger: Ledger, stamp: int) -> None:
        """Publish the views of a belief, now or after a pause; its stamp is in nanoseconds."""
        self._pending = ledger, self._newest, stamp
        self._newest = [*ledger.deployments], ledger.estimator
        self._publish_or_wait()

    def _publish_or_wait(self) -> None:
        """Publish now, or after `PERIOD` if views were just published."""
        if self._timer.is_canceled():
            self.publish()
            self._timer.reset()

    def _on_timer(self) -> None:
        if self._pending or self._is_progress_pending:
            self.publish()
        else:
            self._timer.cancel()

    def publish(self) -> None:
        """Publish the pending views, if any."""
        if self._pending:
            ledger, before, stamp = self._pending
            for name, publisher in self._maps.items():
                values = getattr(ledger.belief, name)
                publisher.publish(occupancy_grid(ledger.grid, values, stamp))
            if self._mask:
                self._mask.publish(occupancy_grid(ledger.grid, ledger.belief.hazard, stamp))
            world = None
            if len(self._truth) == 2:
                world = World(self._truth['hazard'], self._truth['target'])
            self._message = progress_message(ledger, before, world, stamp, self._status)
        if self._pending or self._is_progress_pending:
            self._progress.publish(self._message)
        self._pending, self._is_progress_pending = None, False
