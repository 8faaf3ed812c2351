# SPDX-License-Identifier: Apache-2.0
"""The field: cells, paths, and clusters of hazards in it."""

from itertools import product
import math
from re import escape

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


@for_each('cell', [-1, 12, 1.5])
def test_only_cells_of_the_grid_have_neighbors(cell):
    with pytest.raises(ValueError, match=f'cell is {cell}.*0 to 11'):
        Grid(4, 3).neighbors(cell)


@for_each('point', [
    (-0.01, 0.5),
    (0.5, -0.01),
    (4.01, 0.5),
    (0.5, 3.01),
    (math.nan, 0.5),
    (0.5, math.inf),
    (-math.inf, 0.5),
])  # fmt: skip
def test_points_outside_are_refused(point):
    with pytest.raises(ValueError, match=escape(f'({point[0]}, {point[1]})') + '.*4 x 3'):
        Grid(4, 3).cells_at([point])


@for_each('shape', [(6,), (3, 3)])
def test_points_are_pairs(shape):
    with pytest.raises(ValueError, match='point'):
        Grid(4, 3).cells_at(np.full(shape, 0.5))


@for_each('blocked', [(), (1, 6, 11, 16)])
@for_each('max_steps', [0, 1, 2, 3, 5, 1000])
def test_cells_in_reach_are_those_of_all_paths(max_steps, blocked):
    grid = Grid(5, 4, base=0, blocked=blocked)
    ways_out = {0: {grid.base}}
    for steps in range(1, min(max_steps, grid.cells) // 2 + 1):
        ways_out[steps] = {int(c) for cell in ways_out[steps - 1] for c in grid.neighbors(cell)}
    reached = set().union(*ways_out.values())
    assert set(np.flatnonzero(grid.in_reach(max_steps)).tolist()) == reached


@for_each('arguments, message', [
    ({'width': 0}, 'width is 0.*at least 1'),
    ({'height': -2}, 'height is -2.*at least 1'),
    ({'width': 2.5}, 'width is 2.5.*whole number'),
    ({'width': math.nan}, 'width is nan.*whole number'),
    ({'base': 12}, 'base is 12.*0 to 11'),
    ({'base': 1.5}, 'base is 1.5.*0 to 11'),
    ({'base': 5, 'blocked': (4, 5)}, 'base is 5.*blocked'),
    ({'blocked': (3, 12)}, 'blocked.*12.*0 to 11'),
    ({'blocked': (2.5,)}, 'blocked.*2.5.*0 to 11'),
    ({'resolution': 0.0}, 'resolution is 0.*positive'),
    ({'resolution': math.nan}, 'resolution is nan.*positive'),
    ({'resolution': math.inf}, 'resolution is inf'),
    ({'origin': (0.0, math.nan)}, 'origin.*nan.*finite'),
    ({'origin': (0.0, 0.0, 0.0)}, 'origin.*two'),
    ({'origin': (1e16, 0.0)}, r'origin is \(1e\+16, 0.0\): cells of 1.0 m cannot'),
    (
        {'origin': (0.0, -1e308)},
        'origin.*cannot be told apart that far out; it must be within 4.5e',
    ),
    ({'connectivity': 6}, 'connectivity is 6.*4 or 8'),
])  # fmt: skip
def test_bad_grids_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Grid(**{'width': 4, 'height': 3, **arguments})


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


def test_a_point_outside_a_turned_grid_is_refused_with_the_turn():
    grid = Grid(4, 3, yaw=np.pi / 2)
    assert grid.cells_at([(-0.5, 3.5)]).tolist() == [3]
    with pytest.raises(ValueError, match='outside the grid.*turned by 1.57'):
        grid.cells_at([(0.5, 0.5)])


@for_each('path', [[5, 5], [5, 6, 5], [5, 5, 5, 5], [5, 0, 4, 8, 5], [5, 10, 11, 11, 10, 5]])
def test_legal_paths_pass(path):
    checked = Grid(4, 3, base=5).check_path(path, max_steps=5)
    assert checked.tolist() == path
    assert np.issubdtype(checked.dtype, np.integer)


@for_each('path, message', [
    ([], 'path.*at least two'),
    ([5], 'path.*at least two'),
    (5, 'path.*at least two'),
    ([[5, 5], [5, 5]], 'path'),
    ([5, 12, 5], 'path leaves the grid.*12.*0 to 11'),
    ([5, -1, 5], 'path leaves the grid.*-1.*0 to 11'),
    ([5, 7, 5], 'path jumps.*5 to 7'),
    ([5, 4, 3, 4, 5], 'path jumps.*4 to 3'),
    ([4, 5], 'path must start at the base 5.*4'),
    ([5, 4], 'path must end at the base 5.*4'),
    ([5, 9, 5], 'path enters a blocked cell.*9'),
    ([5, 5, 5, 5, 5, 5, 5], 'path has 6 steps.*5'),
    ([5.0, 6.5, 5.0], 'path.*float.*whole numbers'),
    ([5, math.nan, 5], 'path.*whole numbers'),
    ([True, True], 'path.*whole numbers'),
    (['5', '6', '5'], 'path.*whole numbers'),
])  # fmt: skip
def test_bad_paths_are_refused(path, message):
    with pytest.raises(ValueError, match=message):
        Grid(4, 3, base=5, blocked=(9,)).check_path(path, max_steps=5)


def test_the_repr_of_a_grid_is_one_line_however_much_is_blocked():
    few, many = Grid(3, 2, base=4, blocked=(2, 0)), Grid(90, 90, blocked=range(1, 6000, 2))
    assert str(few) == (
        'Grid(width=3, height=2, base=4, resolution=1.0, origin=(0.0, 0.0), yaw=0.0, '
        'connectivity=8, through_corners=True, blocked=[0, 2])'
    )
    assert str(many).endswith('blocked=[1, 3, 5, 7, 9, 11, 13, 15, ... 3000 in all])')
    assert str(Grid(4, 4)).endswith('blocked=[])')


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


@for_each('coupling', [-0.1, 1.8, float('nan'), 'strong', None])
def test_other_couplings_are_refused(coupling):
    with pytest.raises(ValueError, match=r"coupling is .*in \[0, 1.7\] or 'learn'"):
        Clustering(Grid(3, 3), coupling)


@for_each(
    'side, densities, message',
    [
        (17, 1, 'with obstacles, its shorter side may have at most 16 cells'),
        (13, 2, 'hazard_density is unknown'),
    ],
)
def test_wide_fields_with_obstacles_are_refused(side, densities, message):
    possible = np.ones(side**2, dtype=bool)
    possible[[5, 77]] = False
    with pytest.raises(ValueError, match=message):
        Clustering(Grid(side, side), 0.5).fields(possible, np.full(densities, 0.2))
