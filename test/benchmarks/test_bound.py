# SPDX-License-Identifier: Apache-2.0
"""The bound on a plan's value, against all paths and along missions."""

from functools import cache

from bound import parabola, upper_bound
import brute_force
from kbnitp_ros.core import Belief, Grid, path_information, plan, SearchOptions, SensorModel
from laws import for_each
import numpy as np
import pytest

PER_CHUNK = 20
CHUNKS = 250


@cache
def every_path(grid, most_steps, max_visits):
    ends, closed = {(grid.base, (0,) * grid.cells)}, set()
    for _ in range(most_steps):
        ends = {
            (int(cell), tuple(n + (each == cell) for each, n in enumerate(visits)))
            for end, visits in ends
            for cell in grid.neighbors(end)
            if visits[cell] < max_visits
        }
        closed |= {visits for end, visits in ends if end == grid.base}
    return np.array(sorted(closed))


GRIDS = [
    (Grid(3, 3, base=0), 6, 2),
    (Grid(3, 3, base=4), 5, 1),
    (Grid(3, 3, base=5, blocked=(4,)), 7, 2),
    (Grid(3, 3, base=8, connectivity=4), 7, 3),
    (Grid(3, 3, base=1, blocked=(3, 7)), 6, 3),
    (Grid(4, 3, base=0, blocked=(5,)), 6, 2),
    (Grid(4, 3, base=6, connectivity=4), 6, 2),
    (Grid(4, 3, base=11, connectivity=4, blocked=(6,)), 8, 1),
    (Grid(4, 3, base=7), 4, 3),
    (Grid(4, 3, base=2, blocked=(1, 3, 5, 6, 7)), 3, 3),
]


def random_problem(seed):
    rng = np.random.default_rng(seed)
    grid, most_steps, max_visits = GRIDS[seed % len(GRIDS)]
    joint = brute_force.random_joint(rng, grid.cells, grid.base)
    for z in range(2):
        certain = rng.random(grid.cells) < rng.choice([0.0, 0.3])
        certain[grid.base] = False
        joint[certain, z] += joint[certain, 1 - z]
        joint[certain, 1 - z] = 0.0
    low = 10 ** rng.uniform(-3, 0)
    model = SensorModel(
        lethality=float(rng.choice([0.0, 1.0, low, rng.random()])),
        malfunction=float(rng.choice([0.0, 1.0, 0.05, 0.05, rng.random(), low])),
        false_negative=float(rng.choice([0.0, 0.05, rng.random()])),
        true_positive=float(rng.choice([1.0, 0.95, rng.uniform(0.5, 1)])),
        false_positive=float(rng.choice([0.0, 0.05, rng.uniform(0, 0.5)])),
    )
    loss_cost = float(rng.choice([0.0, 0.0, rng.random(), 10 * rng.random(), 1e6]))
    return grid, most_steps, max_visits, Belief(joint), model, loss_cost


def values(belief, model, visits, loss_cost):
    returns = brute_force.survival_of_visits(belief.joint, model, visits)
    with np.errstate(invalid='ignore'):
        information = brute_force.information_of_visits(belief.joint, model, visits)
    # A path that no robot survives has no information.
    return np.where(returns > 0.0, information, 0.0) - loss_cost * (1.0 - returns)


@pytest.mark.slow
@for_each('chunk', range(CHUNKS), every=50)
def test_no_path_has_a_higher_value_than_the_bound(chunk):
    for seed in range(chunk * PER_CHUNK, (chunk + 1) * PER_CHUNK):
        grid, most_steps, max_visits, belief, model, loss_cost = random_problem(seed)
        best = values(belief, model, every_path(grid, most_steps, max_visits), loss_cost).max()
        options = {'max_visits': max_visits, 'loss_cost': loss_cost}
        planner = 'relaxed' if seed % 3 else 'beam'
        found = plan(grid, belief, model, SearchOptions(planner, most_steps, **options))
        search = SearchOptions(max_steps=most_steps, **options)
        above = upper_bound(grid, belief, model, search, found.path)
        assert above >= best - 1e-12 * loss_cost, seed


@pytest.mark.slow
def test_the_parabola_touches_from_above():
    rng = np.random.default_rng(0)
    for _ in range(1000):
        q = float(rng.choice([1.0, rng.random(), 10 ** rng.uniform(-12, -2)]))
        p0 = 0.0 if q < 0.01 else float(rng.choice([0.0, rng.uniform(0.0, 0.98)])) * q
        p = np.append(np.linspace(0.0, q, 200), p0)
        f = (1.0 - p) * np.log1p(-p, where=p < 1.0, out=np.zeros_like(p))
        above = np.polynomial.polynomial.polyval(p, parabola(q, p0)) - f
        assert above.min() >= -1e-14
        assert above[-1] == pytest.approx(0.0, abs=1e-14)
        # For small q a series replaces the curvature.
        assert above[-2] == pytest.approx(0.0, abs=1e-14)


@pytest.mark.slow
@for_each('malfunction', [0.05, 0.5, 1.0])
def test_where_only_one_path_has_a_step_the_bound_is_its_value(malfunction):
    grid = Grid(2, 2, blocked=(1, 2, 3))
    belief = Belief.from_maps([0.0, 0.5, 0.5, 0.5], [0.5] * 4, [0.5] * 4)
    model = SensorModel(0.5, malfunction)
    above = upper_bound(grid, belief, model, SearchOptions(max_steps=1), [0, 0])
    assert above == pytest.approx(path_information(belief, model, [0, 0]), abs=3e-4)


def test_other_objectives_have_no_bound():
    grid, options = Grid(3, 3), SearchOptions(objective='information_per_loss')
    with pytest.raises(ValueError, match='only information has a'):
        upper_bound(grid, Belief.prior(grid, 0.3, 0.4, 0.8), SensorModel(0.5), options, [0, 0])
