# SPDX-License-Identifier: Apache-2.0
"""Write probabilities as files of map_server."""

from __future__ import annotations

from itertools import product
from pathlib import Path

from kbnitp_ros.core import Belief, Grid
import numpy as np
from numpy.typing import NDArray
from PIL import Image
import yaml

WHITE = 255


def write_probabilities(yaml_path: Path, grid: Grid, levels: NDArray[np.uint8]) -> None:
    """Write 255 times the probability of each cell as a map in mode scale, black for 255."""
    image = yaml_path.with_suffix('.pgm')
    rows = (WHITE - levels).reshape(grid.height, grid.width)[::-1]
    Image.fromarray(np.ascontiguousarray(rows)).save(image)
    said = {
        'image': image.name,
        'mode': 'scale',
        'resolution': grid.resolution,
        'origin': [*grid.origin, grid.yaw],
        'negate': 0,
        'occupied_thresh': 1.0,
        'free_thresh': 0.0,
    }
    yaml_path.write_text(yaml.safe_dump(said, sort_keys=False))


def levels_of(belief: Belief) -> dict[str, NDArray[np.uint8]]:
    """
    Return the maps of a belief in steps of 1/255, such that they are those of a belief again.

    Each value is the one below or above that of the belief, of all that have a joint distribution
    (kappa h <= t <= kappa h + 1 - h) those next to it.

    """
    exact = np.stack([belief.hazard, belief.target, belief.kappa]) * WHITE
    best = np.rint(exact)
    distance = np.full(belief.cells, np.inf)
    for rounding in product((np.floor, np.ceil), repeat=3):
        tried = np.stack([each(values) for each, values in zip(rounding, exact)])
        off = np.where(is_belief(tried), np.abs(tried - exact).max(axis=0), np.inf)
        best = np.where(off < distance, tried, best)
        distance = np.minimum(off, distance)
    return dict(zip(('hazard', 'target', 'kappa'), best.astype(np.uint8)))


def is_belief(levels: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return where hazard, target and kappa, in whole steps, have a joint distribution."""
    hazard, target, kappa = levels
    both = kappa * hazard
    result: NDArray[np.bool_] = (both <= WHITE * target) & (
        WHITE * target <= both + WHITE * (WHITE - hazard)
    )
    return result
