# SPDX-License-Identifier: Apache-2.0
"""Where a node gets its field from: its parameters, a map in a file or a map on a topic."""

from __future__ import annotations

from kbnitp_ros.core import Grid
from kbnitp_ros.maps import Map, MOST_PIXELS
from kbnitp_ros.messages.grids import read_map_message
from kbnitp_ros.messages.sizes import largest_map
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.parameters import grid_of
from kbnitp_ros.nodes.shell import Shell
from nav_msgs.msg import OccupancyGrid


class FieldNode(Shell):
    """
    A node of the mission that knows the field.

    With the parameter `map_topic` it is not made before a map has come: nothing of it can be done
    without. A map that comes later and is another one changes nothing.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._grid: Grid | None = None
        if self.values['map_topic']:
            self._await_map(self.resolve_topic_name(self.values['map_topic']))
        else:
            self._grid = grid_of(self.values)

    @property
    def grid(self) -> Grid:
        """Return the field, the same for all nodes of a mission."""
        assert self._grid is not None
        return self._grid

    def _await_map(self, topic: str) -> None:
        self._topic = topic
        self.hear(OccupancyGrid, topic, self._on_map, qos.LATCHED, largest_map(MOST_PIXELS))
        self.diagnostics.state = f'waiting for a map on {topic} (parameter map_topic)'
        self.spin_until(lambda: self._grid is not None)

    def _on_map(self, message: OccupancyGrid) -> None:
        try:
            grid = grid_of(self.values, Map(*read_map_message(message)))
            if self._grid not in (None, grid):
                raise ValueError(
                    'the map has changed: this mission goes on with the one that it began with; '
                    'begin another mission for the new one'
                )
        except ValueError as error:
            self.diagnostics.refuse(self._topic, error)
        else:
            self._grid = grid
