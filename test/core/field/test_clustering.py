# SPDX-License-Identifier: Apache-2.0
"""The prior of clustered hazards, against the sum over all states."""

from itertools import product

from kbnitp_ros.core import Clustering, Grid
from kbnitp_ros.core.field import clustering as partition
from kbnitp_ros.core.field.clustering import log_partition
from laws import for_each
import numpy as np
import pytest


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


def test_no_coupling_is_independence():
    field, log_z = Clustering(Grid(3, 3), 0.0).fields(np.ones(9, bool), np.array([0.2]))
    assert field[0, 0] == pytest.approx(np.log(0.2 / 0.8))
    assert log_z[0, 0] == pytest.approx(-9 * np.log(0.8))


def test_neighbors_share_a_side():
    assert Clustering(Grid(3, 2), 1.0).neighbors[1].tolist() == [0, 2, -1, 4]


@for_each('coupling', [-0.1, 1.8, float('nan'), 'strong', None])
def test_other_couplings_are_refused(coupling):
    with pytest.raises(ValueError, match=r"coupling is .*in \[0, 1.7\] or 'learn'"):
        Clustering(Grid(3, 3), coupling)


@for_each(
    'side, densities, message',
    [(17, 1, 'with obstacles, at most 16 cells across'), (13, 2, 'hazard_density is unknown')],
)
def test_wide_fields_with_obstacles_are_refused(side, densities, message):
    possible = np.ones(side**2, dtype=bool)
    possible[[5, 77]] = False
    with pytest.raises(ValueError, match=message):
        Clustering(Grid(side, side), 0.5).fields(possible, np.full(densities, 0.2))
