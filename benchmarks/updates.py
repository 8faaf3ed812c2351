# SPDX-License-Identifier: Apache-2.0
"""Time of one update, early and late in a mission."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import time

from cases import Benchmark
from kbnitp_ros.core import Belief, Estimator, Grid, SensorModel, World
import numpy as np

DEPLOYMENTS = (200, 1000, 5000, 10_000)
# Number of deployments up to each of these that are averaged.
WINDOW = 100
SIDE, STEPS = 9, 18


def walk(grid: Grid, rng: np.random.Generator) -> list[int]:
    """Return a closed random walk from the base."""
    path = [grid.base]
    for left in range(int(rng.integers(2, STEPS + 1)) - 1, 0, -1):
        near = [cell for cell in grid.neighbors(path[-1]) if max(divmod(cell, grid.width)) <= left]
        path.append(int(rng.choice(near)))
    return [*path, grid.base]


@cache
def times() -> list[float]:
    """Return the seconds of each update of a mission of random walks."""
    grid, rng, model = Grid(SIDE, SIDE), np.random.default_rng(1), SensorModel(0.5)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    estimator = Estimator(Belief.prior(grid, 0.5, 0.45, 0.8), model)
    taken = []
    for _ in range(DEPLOYMENTS[-1]):
        observation = world.traverse(walk(grid, rng), model, rng)
        start = time.perf_counter()
        estimator.assimilate(observation)
        taken.append(time.perf_counter() - start)
    return taken


def mean_up_to(deployments: int) -> Callable[[], float]:
    """Return a function that returns the mean over the window up to a deployment."""
    return lambda: float(np.mean(times()[deployments - WINDOW : deployments]))


BENCHMARKS = (
    Benchmark(
        'An update of `kappa_bnitp` by deployments',
        f'Random walks of at most {STEPS} steps on {SIDE}x{SIDE} cells, most of them different;\n'
        f'mean times of the {WINDOW} deployments up to this number.',
        {f'deployment {number:,}': mean_up_to(number) for number in DEPLOYMENTS},
    ),
)
