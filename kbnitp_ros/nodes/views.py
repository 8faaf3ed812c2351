# SPDX-License-Identifier: Apache-2.0
"""What people look at: the maps of a belief as grids, and how the mission stands."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from kbnitp_msgs.msg import Progress
from kbnitp_ros.core import Ledger, World
from kbnitp_ros.messages.grids import occupancy_grid, read_occupancy_grid
from kbnitp_ros.messages.progress import Held, MissionState, NOT_KNOWN, progress_message, Standing
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.diagnostics import (
    MISSION_REASON,
    MISSION_STATE,
    TOPIC,
)
from kbnitp_ros.nodes.runtime.node import FieldNode
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

# Seconds between two views: nobody sees more of them, and they take longer than small beliefs.
PERIOD = 0.1


class Views:
    """The grids and the progress of an estimator, of its last belief at most every `PERIOD`."""

    def __init__(self, node: FieldNode, agents: Sequence[str]) -> None:
        self._node = node
        self._truth: dict[str, NDArray[np.bool_]] = {}
        self._newest: Held | None = None
        # The belief to show next: who holds it, the belief before and its stamp. All that changes
        # a ledger is shown, so it still holds that belief when it is.
        self._pending: tuple[Ledger, Held | None, int] | None = None
        self._message = Progress()
        self._standing = NOT_KNOWN
        # How many robots have departed and were not reported.
        self.out = 0
        self._is_progress_pending = False
        self._maps = {
            name: node.create_publisher(OccupancyGrid, f'belief/{name}', qos.LATCHED)
            for name in ('hazard', 'target', 'kappa')
        }
        self._progress = node.create_publisher(Progress, 'progress', qos.LATCHED)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self._on_timer, clock=steady, autostart=False)
        for name in ('hazard', 'target'):
            for topic in (f'truth/{name}', f'{agents[0]}/truth/{name}'):
                node.hear(
                    OccupancyGrid,
                    topic,
                    partial(self._on_truth, topic, name),
                    qos.LATCHED,
                )

        node.hear_newest(DiagnosticArray, TOPIC, self._on_diagnostics, qos.DIAGNOSTICS)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        """Show what the planner of this namespace says of the state of the mission."""
        own = self._node.get_namespace().rstrip('/')
        for status in array.status:
            values = {each.key: each.value for each in status.values}
            state = MissionState.__members__.get(values.get(MISSION_STATE, ''))
            if state is None or status.name.rpartition('/')[0] != own:
                continue
            standing = Standing(state, values.get(MISSION_REASON, ''))
            if standing != self._standing:
                self._standing = standing
                self._message.state, self._message.reason = standing
                # There is none before the first belief.
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
        """Show the belief of a ledger, of this stamp in nanoseconds, unless others follow soon."""
        self._pending = ledger, self._newest, stamp
        self._newest = Held.by(ledger)
        self._publish_or_wait()

    def show_out(self, ledger: Ledger) -> None:
        """Show how many robots were ordered and how many are out, if that has changed."""
        counts = len(ledger.paths), self.out
        if counts != (self._message.ordered, self._message.out):
            self._message.ordered, self._message.out = counts
            self._is_progress_pending = True
            self._publish_or_wait()

    def _publish_or_wait(self) -> None:
        """Publish now if nothing was for a while, and later otherwise."""
        if self._timer.is_canceled():
            self.publish()
            self._timer.reset()

    def _on_timer(self) -> None:
        if self._pending or self._is_progress_pending:
            self.publish()
        else:
            self._timer.cancel()

    def publish(self) -> None:
        """Publish what is pending, if anything is."""
        if self._pending:
            ledger, before, stamp = self._pending
            for name, publisher in self._maps.items():
                values = getattr(ledger.belief, name)
                publisher.publish(occupancy_grid(ledger.grid, values, stamp))
            world = World(**self._truth) if len(self._truth) == 2 else None
            self._message = progress_message(
                ledger, before, world, stamp, self.out, self._standing
            )
        if self._pending or self._is_progress_pending:
            self._progress.publish(self._message)
        self._pending, self._is_progress_pending = None, False
