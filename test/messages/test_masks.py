# SPDX-License-Identifier: Apache-2.0
"""Masks of Nav2's costmap filters: at every point at least the percentage of its cell."""

from math import pi

from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.grids import mask_grid, occupancy_grid
from laws import for_each
import numpy as np
import pytest

# Points along the side of a cell, and the width beside a cell in which slivers lie.
POINTS = 40
BESIDE = 0.05

YAWS = [0.3, -0.3, pi / 4, pi / 2, pi, -2.0, 1e-9]


def largest_around(grid, percent, mask, beside):
    """Return the largest percentage of the field in each cell of a mask, by points."""
    side = np.linspace(-beside, 1 + beside, POINTS)
    row, col = np.divmod(np.arange(mask.info.width * mask.info.height), mask.info.width)
    places = np.stack([col, row], axis=-1)[:, None] + np.stack(
        np.meshgrid(side, side), axis=-1
    ).reshape(-1, 2)
    # Nav2 reads the position of the origin, and not its orientation.
    origin = mask.info.origin.position
    at = np.floor(grid.in_cells((origin.x, origin.y) + places * mask.info.resolution))
    is_inside = ((at >= 0) & (at < (grid.width, grid.height))).all(axis=-1)
    cells = np.where(is_inside, at @ (1, grid.width), 0).astype(int)
    return np.where(is_inside, percent[cells], -1).max(axis=1)


def check_mask(grid, hazard):
    percent = np.array(occupancy_grid(grid, hazard, 1).data)
    mask = mask_grid(grid, hazard, 1)
    turn = mask.info.origin.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)
    assert mask.info.resolution == np.float32(grid.resolution)
    data = np.array(mask.data)
    assert (data >= largest_around(grid, percent, mask, -1e-3)).all()
    assert (data <= largest_around(grid, percent, mask, BESIDE)).all()
    # The whole field lies in the mask.
    origin = mask.info.origin.position
    at = (grid.centers(np.arange(grid.cells)) - (origin.x, origin.y)) / mask.info.resolution
    assert (at > 0).all()
    assert (at < (mask.info.width, mask.info.height)).all()
    assert (data[(np.floor(at) @ (1, mask.info.width)).astype(int)] >= percent).all()
    return mask


@for_each('yaw', YAWS)
def test_a_mask_has_the_worst_of_the_cells_it_overlaps(yaw):
    grid = Grid(7, 5, yaw=yaw, resolution=0.5, origin=(-20.0, 3.0), blocked=[3, 12])
    hazard = np.random.default_rng(1).random(35).round(2)
    mask = check_mask(grid, hazard)
    if abs(yaw) in (pi / 2, pi):
        # Turned by a quarter, cells fit cells.
        assert len(mask.data) == 35
        assert sorted(mask.data) == sorted(occupancy_grid(grid, hazard, 1).data)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_masks_of_random_fields(seed):
    rng = np.random.default_rng(seed)
    width, height = rng.integers(1, 9, 2).tolist()
    blocked = np.flatnonzero(rng.random(width * height) < 0.2)
    grid = Grid(
        width, height, yaw=rng.uniform(-pi, pi), resolution=rng.uniform(0.1, 3.0),
        origin=(rng.uniform(-99, 99), rng.uniform(-99, 99)), blocked=blocked[blocked > 0].tolist(),
    )  # fmt: skip
    check_mask(grid, rng.random(width * height))


def test_the_mask_of_an_unturned_field_is_its_map():
    grid, hazard = Grid(4, 3, blocked=[7]), np.linspace(0, 1, 12)
    assert mask_grid(grid, hazard, 5) == occupancy_grid(grid, hazard, 5)
