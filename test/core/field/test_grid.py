# SPDX-License-Identifier: Apache-2.0
"""The field: cells, paths, its name, and clusters of hazards in it."""

from dataclasses import replace
from hashlib import sha256
from itertools import product
from math import pi
from pathlib import Path
import re

import brute_force
from hypothesis import given
from hypothesis import strategies as st
from kbnitp_ros.core import Clustering, Grid
from kbnitp_ros.core.field import clustering as partition
from kbnitp_ros.core.field.clustering import log_partition
from laws import for_each
import numpy as np
import pytest


@for_each('seed', range(40))
def test_neighbors_of_every_cell(seed):
    """All around, by side, and not beside a blocked cell."""
    rng = np.random.default_rng(seed)
    width, height = rng.integers(1, 7, 2)
    blocked = rng.choice(width * height, rng.integers(0, width * height), replace=False)
    base = next(cell for cell in range(width * height) if cell not in blocked)
    grid, sides, clear = (
        Grid(width, height, base=base, blocked=blocked, **others)
        for others in ({}, {'connectivity': 4}, {'through_corners': False})
    )
    for cell, around in brute_force.adjacent(width, height, blocked).items():

        def touched(to, cell=cell):
            rows, cols = sorted([cell // width, to // width]), sorted([cell % width, to % width])
            return {r * width + c for r in rows for c in cols}

        assert grid.neighbors(cell).tolist() == around
        assert sides.neighbors(cell).tolist() == [to for to in around if len(touched(to)) < 3]
        assert clear.neighbors(cell).tolist() == [
            to for to in around if not touched(to) & set(blocked)
        ]


@for_each('blocked', [(), (1, 6, 11, 16)])
@for_each('max_steps', [0, 1, 2, 3, 5, 1000])
def test_cells_in_reach_are_those_of_all_paths(max_steps, blocked):
    grid = Grid(5, 4, base=0, blocked=blocked)
    ways_out = {0: {grid.base}}
    for steps in range(1, min(max_steps, grid.cells) // 2 + 1):
        ways_out[steps] = {int(c) for cell in ways_out[steps - 1] for c in grid.neighbors(cell)}
    reached = set().union(*ways_out.values())
    assert set(np.flatnonzero(grid.in_reach(max_steps)).tolist()) == reached


@given(
    st.floats(1e-3, 1e3),
    st.tuples(st.floats(-1e13, 1e13), st.floats(-1e13, 1e13)),
    st.integers(0, 11),
)
def test_a_center_is_in_its_cell_wherever_a_grid_may_lie(resolution, origin, cell):
    try:
        grid = Grid(4, 3, resolution=resolution, origin=origin)
    except ValueError:
        assert max(map(abs, origin)) > 1e12 * resolution
    else:
        assert grid.cells_at(grid.centers([cell])).tolist() == [cell]


@given(
    st.floats(-10.0, 10.0),
    st.floats(0.01, 100.0),
    st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)),
)
def test_cells_follow_rows_that_are_turned(yaw, resolution, origin):
    """The turn, as a product of complex numbers."""
    grid = Grid(4, 3, resolution=resolution, origin=origin, yaw=yaw)
    row, column = np.divmod(np.arange(12), 4)
    along = np.exp(1j * yaw) * resolution * (column + 0.5 + 1j * (row + 0.5))
    expected = complex(*origin) + along
    centers = grid.centers(np.arange(12))
    assert np.abs(centers @ (1, 1j) - expected).max() <= 1e-9
    assert grid.cells_at(np.stack([expected.real, expected.imag], axis=1)).tolist() == [*range(12)]
    places = np.stack([column, row], axis=1) + 0.5
    assert grid.in_cells(centers) == pytest.approx(places, abs=1e-6)
    assert grid.in_metres(grid.in_cells(centers)) == pytest.approx(centers, abs=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_without_a_turn_positions_are_the_same_to_the_bit(seed):
    rng = np.random.default_rng(seed)
    resolution, origin = float(rng.uniform(1e-3, 10)), tuple(rng.uniform(-1e4, 1e4, 2).tolist())
    grid = Grid(40, 30, resolution=resolution, origin=origin)
    row, column = np.divmod(np.arange(grid.cells), 40)
    place = np.stack([column, row], axis=-1) + 0.5
    assert grid.centers(np.arange(grid.cells)).tobytes() == (place * resolution + origin).tobytes()
    points = rng.uniform(-1e4, 1e4, (100, 2))
    assert grid.in_cells(points).tobytes() == ((points - origin) / resolution).tobytes()


def test_the_repr_of_a_grid_is_one_line_however_much_is_blocked():
    few, many = Grid(3, 2, base=4, blocked=(2, 0)), Grid(90, 90, blocked=range(1, 6000, 2))
    assert str(few) == (
        'Grid(width=3, height=2, base=4, resolution=1.0, origin=(0.0, 0.0), yaw=0.0, '
        'connectivity=8, through_corners=True, blocked=[0, 2])'
    )
    assert str(many).endswith('blocked=[1, 3, 5, 7, 9, 11, 13, 15, ... 3000 in all])')
    assert str(Grid(4, 4)).endswith('blocked=[])')


# Fields have the same name exactly if they are the same field, as docs/robots.md defines it.

PAGE = (Path(__file__).parents[3] / 'docs/robots.md').read_text()
FIELD = Grid(12, 8, resolution=0.5, origin=(-1.5, 2.0), yaw=0.3, blocked=[5, 17])


def test_the_example_of_the_page_is_right():
    (written,) = re.findall(r'^    ([0-9a-f]{60,})$', PAGE, re.MULTILINE)
    (name,) = re.findall(r'and the name `(\w{16})`', PAGE)
    assert sha256(bytes.fromhex(written)).hexdigest()[:16] == name
    assert replace(FIELD, through_corners=False).id == name


@for_each('change', [
    {'width': 13},
    {'height': 9},
    {'resolution': 0.25},
    {'origin': (-1.5, 2.0000001)},
    {'origin': (2.0, -1.5)},
    {'yaw': 0.300001},
    {'blocked': [5]},
    {'blocked': [5, 18]},
    {'connectivity': 4},
    {'through_corners': False},
])  # fmt: skip
def test_another_field_has_another_name(change):
    assert replace(FIELD, **change).id != FIELD.id


@for_each('one, other', [
    (FIELD, replace(FIELD, base=3, other_bases=[7])),
    (FIELD, FIELD.at(0)),
    (FIELD, replace(FIELD, blocked=[17, 5, 17])),
    (FIELD, replace(FIELD, yaw=0.3 + 2 * pi)),
    (Grid(3, 3, origin=(0.0, -0.0)), Grid(3, 3)),
    (Grid(3, 3, yaw=-0.0), Grid(3, 3)),
    (Grid(3, 3, yaw=pi), Grid(3, 3, yaw=-pi)),
    (Grid(3, 3, resolution=0.1), Grid(3, 3, resolution=float(np.float32(0.1)))),
    (Grid(3, 3, resolution=0.1), Grid(3, 3, resolution=0.1 + 1e-12)),
])  # fmt: skip
def test_the_same_field_has_the_same_name(one, other):
    assert one.id == other.id


# The prior of clustered hazards, against the sum over all states.


def enumerated(free, field, coupling):
    """Return ln Z and the expected number of hazards."""
    z = np.array(list(product((0, 1), repeat=free.size))).reshape(-1, *free.shape)
    z = z[~(z[:, ~free] == 1).any(axis=1)]
    pairs = (z[:, 1:] * z[:, :-1]).sum(axis=(1, 2)) + (z[..., 1:] * z[..., :-1]).sum(axis=(1, 2))
    count = z.sum(axis=(1, 2))
    weight = np.exp(field * count + coupling * pairs)
    return np.log(weight.sum()), (weight * count).sum() / weight.sum()


@for_each('seed', range(40))
def test_the_transfer_matrix_sums_over_all_states(seed):
    rng = np.random.default_rng(seed)
    free = rng.random(rng.integers(1, 5, 2)) < 0.8
    fields, coupling = rng.normal(-1.0, 2.0, 3), rng.uniform(0.0, 1.7)
    log_z, count = log_partition(free, fields, coupling)
    for value, field in enumerate(fields):
        expected = enumerated(free, field, coupling)
        assert (log_z[value], count[value]) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@for_each('coupling', [0.0, 0.4, 1.0, 1.7])
def test_the_mean_of_the_marginals_is_the_density(coupling):
    grid = Grid(4, 3, base=6, blocked=(3,))
    possible = grid.may_be_hazardous
    densities = np.array([0.02, 0.15, 0.5, 0.9])
    field, log_z = Clustering(grid, coupling).fields(possible, densities)
    free = possible.reshape(3, 4)
    for value, density in enumerate(densities):
        expected, count = enumerated(free, field[0, value], coupling)
        assert count / possible.sum() == pytest.approx(density, abs=1e-9)
        assert log_z[0, value] == pytest.approx(expected, abs=1e-9)


@for_each('row, column', [(0, 0), (5, 0), (9, 13), (19, 13), (10, 7)])
def test_strips_add_up_to_wide_fields(row, column, monkeypatch):
    free = np.ones((20, 14), dtype=bool)
    free[row, column] = False
    for coupling, error in ((0.5, 1e-7), (1.0, 1e-4)):
        field = Clustering(Grid(8, 8), coupling).fields(np.ones(64, bool), np.array([0.15]))[0][0]
        monkeypatch.setattr(partition, 'STRIP', 14)
        expected = log_partition(free, field, coupling)[0]
        monkeypatch.setattr(partition, 'STRIP', 12)
        assert log_partition(free, field, coupling)[0] == pytest.approx(expected, abs=2 * error)
