# SPDX-License-Identifier: Apache-2.0
"""The grid and the geographic datum that the parameters describe, and hidden worlds in files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import ceil, isfinite, radians, tau
from pathlib import Path
from typing import Any

from kbnitp_ros.configuration.agents import cell_at, check_position, own_base
from kbnitp_ros.configuration.parameter import own_name
from kbnitp_ros.configuration.table import MAX_SIDE
from kbnitp_ros.core import Grid, World
from kbnitp_ros.files import read_yaml
from kbnitp_ros.maps import Datum, Map, read_map
from kbnitp_ros.messages.grids import rounded_resolution, rounded_yaw
import numpy as np
from numpy.typing import NDArray

# Default side of a cell in metres; a coarser map has cells of its own resolution.
CELL = 1.0


def make_grid(values: Mapping[str, Any], received: Map | None = None) -> Grid:
    """Return the grid that these parameters describe."""
    position = values['grid.base_position']
    check_position('grid.base_position', position)
    if position and values['grid.base']:
        raise ValueError(
            f'parameters grid.base, {values["grid.base"]}, and grid.base_position both name the '
            'base: give one of them'
        )
    if values['map'] and values['map_topic']:
        raise ValueError('parameters map and map_topic are both given: give one of them')
    if received is None and values['map_topic']:
        raise ValueError('parameter map_topic is given, but no map was received on it')
    field = read_map(values['map']) if values['map'] else received
    side = rounded_resolution(values['grid.resolution'])
    corners = values['grid.corners']
    steps = {
        'connectivity': values['grid.connectivity'],
        'through_corners': corners == 'cut' or (corners == 'auto' and field is None),
    }
    if field is not None:
        check_angle(
            f'the yaw of the origin of map {values["map"] or values["map_topic"]}', field.yaw
        )
        # Rounded as in messages, so that all nodes have the same grid.
        field = replace(
            field, resolution=rounded_resolution(field.resolution), yaw=rounded_yaw(field.yaw)
        )
        grid = field.grid(
            side or max(CELL, field.resolution),
            position or None,
            unknown_blocks=values['unknown_blocks'],
            base=values['grid.base'],
            occupied_thresh=values['occupied_thresh'],
            robot_radius=values['robot_radius'],
            **steps,
        )
        if max(grid.width, grid.height) > MAX_SIDE:
            raise ValueError(
                f'the map makes a grid of {grid.width} x {grid.height} cells: at most '
                f'{MAX_SIDE} per side are possible; set a coarser grid.resolution'
            )
        return with_bases(grid, values)
    if values['robot_radius']:
        raise ValueError(
            f'parameter robot_radius is {values["robot_radius"]}, and there is no map whose '
            'obstacles it widens: give map or map_topic, or leave it at 0'
        )
    origin = values['grid.origin']
    if len(origin) not in (2, 3) or not all(map(isfinite, origin)):
        raise ValueError(
            f'parameter grid.origin is {list(origin)}: it must be [x, y] or [x, y, yaw], finite'
        )
    check_angle('the third number of parameter grid.origin', *origin[2:] or (0.0,))
    grid = Grid(
        width=values['grid.width'],
        height=values['grid.height'],
        resolution=side or CELL,
        origin=origin[:2],
        yaw=rounded_yaw(*origin[2:] or (0.0,)),
    )
    at = cell_at(values, 'grid.base_position', grid)
    base = values['grid.base'] if at is None else at
    return with_bases(replace(grid, base=base, blocked=values['grid.blocked'], **steps), values)


def graded_note(values: Mapping[str, Any], received: Map | None = None) -> str:
    """Describe the pixels of a map that are neither free nor obstacles; '' if there are none."""
    field = read_map(values['map']) if values['map'] else received
    if field is None or not (graded := field.graded(values['occupied_thresh'])):
        return ''
    return (
        f'{graded} of {field.data.size} pixels of the map have values above 0 and below '
        f'{ceil(100 * values["occupied_thresh"])}, and count as free: lower occupied_thresh if '
        'they are obstacles'
    )


def check_angle(name: str, angle: float) -> None:
    """Check that an angle is not in degrees."""
    if abs(angle) > tau:
        raise ValueError(
            f'{name} is {angle}: it must be in rad, from {-tau:.4g} to {tau:.4g}; '
            f'{angle} degrees are {radians(angle):.6g} rad'
        )


def with_bases(grid: Grid, values: Mapping[str, Any]) -> Grid:
    """Return the grid with the bases of all agents."""
    for agent in dict.fromkeys(own[0] for name in values if (own := own_name(name))):
        base = own_base(values, agent, grid)
        if base is None:
            continue
        try:
            grid = replace(grid, other_bases=(*grid.other_bases, base))
        except ValueError as error:
            raise ValueError(
                f'parameter team.{agent}.base: {error}; choose a free cell of the map'
            ) from error
        if grid.steps_to_base[base] == grid.cells:
            raise ValueError(
                f'parameter team.{agent}.base: base is {base}, which obstacles cut off from the '
                f'base {grid.base} of the mission: choose a cell connected to it'
            )
    return grid


def parking_place(values: Mapping[str, Any], agent: str, grid: Grid) -> tuple[float, ...]:
    """Return the home of an agent's robot: x and y in metres and, if it is given, yaw in rad."""
    field = grid.at(own_base(values, agent, grid))
    name = f'team.{agent}.parking' if f'team.{agent}.parking' in values else 'parking'
    place, what = tuple(values[name]), f'parameter {name} is {list(values[name])}'
    if not place:
        ((x, y),) = field.centers([field.base]).tolist()
        return x, y
    if len(place) not in (2, 3) or not all(map(isfinite, place)):
        raise ValueError(f'{what}: it must be [x, y] or [x, y, yaw], finite, or empty')
    check_angle(f'the third number of parameter {name}', *place[2:] or (0.0,))
    try:
        cell = int(field.cells_at([place[:2]])[0])
    except ValueError as error:
        raise ValueError(f'parameter {name}: {error}') from error
    if cell in field.blocked:
        raise ValueError(f'{what}, in cell {cell}, which is blocked: park in cell {field.base}')
    if cell != field.base:
        raise ValueError(
            f'{what}, in cell {cell}, and the base is cell {field.base}: park there, or set '
            f'team.{agent}.base to {cell}'
        )
    return place


def make_datum(values: Mapping[str, Any]) -> Datum | None:
    """Return the geographic datum of these parameters, or None; raise ValueError if invalid."""
    datum = Datum.of(values['datum'])
    if datum is not None:
        check_angle('the third number of parameter datum', datum.heading)
    return datum


PRESENT = {'.': False, 'x': True}


def read_world(path: str | Path, grid: Grid) -> World:
    """Read a hidden world from a file."""
    try:
        content = read_yaml(path)
        if not isinstance(content, dict) or set(content) != {'hazard', 'target'}:
            raise ValueError('it must have hazard and target and nothing else')
        hazard, target = (_cells(name, content[name], grid) for name in ('hazard', 'target'))
        world = World(hazard, target, grid)
        world.check(grid)
    except ValueError as error:
        raise ValueError(f'world file {path}: {error}') from error
    return world


def _cells(name: str, picture: Any, grid: Grid) -> NDArray[np.bool_]:
    if not isinstance(picture, list) or not all(isinstance(row, str) for row in picture):
        raise ValueError(f'{name} is {picture!r}: it must be a list of texts, one for each row')
    if len(picture) != grid.height:
        raise ValueError(f'{name} has {len(picture)} rows: the grid has {grid.height}')
    for number, row in enumerate(picture, start=1):
        if len(row) != grid.width:
            raise ValueError(
                f'{name} has {len(row)} cells in row {number} from the top: '
                f'the grid has {grid.width} columns'
            )
        if not set(row) <= set(PRESENT):
            raise ValueError(
                f'{name} has {row!r} in row {number} from the top: '
                "cells are '.' (empty) or 'x' (present)"
            )
    return np.array([PRESENT[cell] for row in reversed(picture) for cell in row])
