# SPDX-License-Identifier: Apache-2.0
"""The goal of a mission that the parameters describe, and when it is over."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import isclose
from typing import Any

from kbnitp_ros.core import check_sought, Goal, GOALS, Grid, SearchOptions, Stop
from kbnitp_ros.maps import read_map
import numpy as np

# From which value on a pixel of a mask belongs to the area, out of 100.
MARKED = 50


def goal_of(values: Mapping[str, Any], grid: Grid) -> Goal | None:
    """Return the goal that these parameters describe; None to map the field."""
    make = GOALS.find(values['goal.kind'])
    confidence = values['stop.confidence'] or None
    with GOALS.blamed(values['goal.kind']):
        return make(goal_cells(values, grid), confidence)


def goal_cells(values: Mapping[str, Any], grid: Grid) -> list[int]:
    """Return the cells that the goal names, by number, by position or by a mask."""
    cells, position, mask = (values[f'goal.{name}'] for name in ('cells', 'position', 'mask'))
    if sum(map(bool, (cells, position, mask))) > 1:
        raise ValueError(
            'parameters goal.cells, goal.position and goal.mask name the same: give one of them'
        )
    if position:
        if len(position) != 2:
            raise ValueError(
                f'parameter goal.position is {list(position)}: it must be x and y, or empty'
            )
        return [int(grid.cells_at([position])[0])]
    return marked_cells(mask, grid) if mask else list(cells)


def marked_cells(mask: str, grid: Grid) -> list[int]:
    """Return the cells of the field that are marked in a map_server map, and are no obstacles."""
    marked = read_map(mask)
    rows, columns = marked.data.shape
    if (columns, rows) != (grid.width, grid.height) or not isclose(
        marked.resolution, grid.resolution, rel_tol=1e-6
    ):
        raise ValueError(
            f'parameter goal.mask: {mask} has {columns} x {rows} pixels of {marked.resolution} m, '
            f'and the field {grid.width} x {grid.height} cells of {grid.resolution} m: draw a '
            'pixel for each cell'
        )
    is_marked = (marked.data.ravel() >= MARKED) & grid.free
    return [int(cell) for cell in np.flatnonzero(is_marked)]


def stop_of(values: Mapping[str, Any]) -> Stop:
    """Return when a mission with these parameters is over before its last robot has left."""
    return Stop(values['stop.gain'], values['stop.losses'])


def check_goal(values: Mapping[str, Any], grid: Grid, options: Iterable[SearchOptions]) -> None:
    """Check that the goal can be reached and that the mission can end by its stops."""
    goal = goal_of(values, grid)
    stop_of(values).check(goal, values['robots'])
    for each in options:
        check_sought(goal, each, values['bound'])
    if goal is not None:
        goal.check(grid, values['max_steps'])
