# SPDX-License-Identifier: Apache-2.0
"""How a mission stands, on the topic progress."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from kbnitp_msgs.msg import Progress
from kbnitp_ros.core import Ledger, World
from kbnitp_ros.messages.grids import read_occupancy_grid
from kbnitp_ros.messages.progress import Held, progress_message
from kbnitp_ros.messages.sizes import largest_belief
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.field import FieldNode
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.typing import NDArray


class ProgressTeller:
    """
    Tells how a mission stands.

    It hears the truth if that is published, to score the belief; nothing else learns of it.

    Parameters
    ----------
    node : FieldNode
        The estimator.
    agents : sequence of str
        Of the mission. Each agent that is a node of its own publishes the same truth.

    """

    def __init__(self, node: FieldNode, agents: Sequence[str]) -> None:
        self._node = node
        self._truth: dict[str, NDArray[np.bool_]] = {}
        self._before: Held | None = None
        self._message = Progress()
        self._publisher = node.create_publisher(Progress, 'progress', qos.LATCHED)
        for name in ('hazard', 'target'):
            for topic in (f'truth/{name}', f'{agents[0]}/truth/{name}'):
                node.hear(
                    OccupancyGrid,
                    topic,
                    partial(self._on_truth, topic, name),
                    qos.LATCHED,
                    largest_belief(node.grid.cells),
                )

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

    def take(self, ledger: Ledger, stamp: int) -> None:
        """Tell how the mission stands with a belief of this stamp, in nanoseconds."""
        world = World(**self._truth) if len(self._truth) == 2 else None
        self._message = progress_message(ledger, self._before, world, stamp)
        self._before = Held.by(ledger)
        self._publisher.publish(self._message)

    def tell_out(self, out: int) -> None:
        """Tell how many robots have left and were not reported yet, if that has changed."""
        if out != self._message.out:
            self._message.out = out
            self._publisher.publish(self._message)
