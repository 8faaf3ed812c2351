# SPDX-License-Identifier: Apache-2.0
"""Read a hidden world from a YAML file that shows it as two pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kbnitp_ros.core import Grid, World
from kbnitp_ros.files import read_yaml
import numpy as np
from numpy.typing import NDArray

PRESENT = {'.': False, 'x': True}


def read_world(path: str | Path, grid: Grid) -> World:
    """Return the world in a file."""
    try:
        content = read_yaml(path)
        if not isinstance(content, dict) or set(content) != {'hazard', 'target'}:
            raise ValueError('it must have hazard and target and nothing else')
        world = World(*(_cells(name, content[name], grid) for name in ('hazard', 'target')))
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
