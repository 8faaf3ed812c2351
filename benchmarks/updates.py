# SPDX-License-Identifier: Apache-2.0
"""Time of one update, early and late in a mission."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import time
from typing import Any

from cases import Benchmark
from kbnitp_ros.configuration.mission import make_estimator, with_defaults
from kbnitp_ros.core import Belief, Estimator, Grid, SensorModel, World
import numpy as np

DEPLOYMENTS = (200, 1000, 5000, 10_000)
# Number of deployments up to each of these that are averaged.
WINDOW = 100
SIDE, STEPS = 9, 18

# Parameters of estimators, by what they learn.
STILL = {'targets.dynamics': 'static'}
SHARES = ['lethality', 'hazard_density', 'kappa', 'target_background']
LEARNT: dict[str, dict[str, Any]] = {
    'nothing': {**STILL, 'learn.numbers': []},
    'lethality and malfunction': {**STILL, 'learn.numbers': ['lethality', 'malfunction']},
    "all of the field's defaults": {},
    'lethality, hazard_density, kappa and target_background': {**STILL, 'learn.numbers': SHARES},
    'the same and duds': {**STILL, 'learn.numbers': [*SHARES, 'duds']},
}
# Robots of a mission by cells a side, and missions in which the learnt numbers take turns.
ROBOTS, TURNS = {9: 60, 30: 30}, 3


def walk(grid: Grid, rng: np.random.Generator, most: int = STEPS) -> list[int]:
    """Return a closed random walk from the base, of at most so many steps."""
    path = [grid.base]
    for left in range(int(rng.integers(2, most + 1)) - 1, 0, -1):
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


def learning(side: int, learnt: dict[str, Any]) -> Estimator:
    """Return an estimator with the field's defaults and these parameters."""
    given = {'defaults': 'field', 'grid.width': side, 'grid.height': side, **learnt}
    return make_estimator(with_defaults('estimator', given), Grid(side, side))


@cache
def learning_times(side: int) -> dict[str, float]:
    """Return the least mean seconds of an update, by what is learnt."""
    grid, model = Grid(side, side), SensorModel(0.9, 0.001)
    rng = np.random.default_rng(1)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    walks = [walk(grid, rng, 2 * side) for _ in range(ROBOTS[side])]
    outcomes = [world.traverse(path, model, rng) for path in walks]
    taken: dict[str, list[float]] = {name: [] for name in LEARNT}
    for _ in range(TURNS):
        for name, learnt in LEARNT.items():
            estimator = learning(side, learnt)
            start = time.perf_counter()
            for outcome in outcomes:
                estimator.assimilate(outcome)
            taken[name].append((time.perf_counter() - start) / len(outcomes))
    return {name: min(each) for name, each in taken.items()}


def learning_time(side: int, name: str) -> Callable[[], float]:
    """Return a function that returns the time of an update that learns some numbers."""
    return lambda: learning_times(side)[name]


BENCHMARKS = (
    Benchmark(
        'An update of `kappa_bnitp` by deployments',
        f'Random walks of at most {STEPS} steps on {SIDE}x{SIDE} cells, most of them different;\n'
        f'mean times of the {WINDOW} deployments up to this number.',
        {f'deployment {number:,}': mean_up_to(number) for number in DEPLOYMENTS},
    ),
    *(
        Benchmark(
            f'An update of `kappa_bnitp` on {side}x{side} cells by what is learnt',
            f'{robots} robots on random walks of at most {2 * side} steps, which took turns '
            f'{TURNS} times; the least mean\ntime, with the particles that are drawn anew.',
            {name: learning_time(side, name) for name in LEARNT},
        )
        for side, robots in ROBOTS.items()
    ),
)
