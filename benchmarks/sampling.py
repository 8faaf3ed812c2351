# SPDX-License-Identifier: Apache-2.0
"""Time of one update by sampling, with and without learning numbers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import time

from cases import Benchmark
from kbnitp_ros.core import Belief, Beta, Estimator, Grid, SensorModel, Unknowns, World
import numpy as np
from updates import STEPS, walk

WINDOW = 50

LETHALITY = Unknowns(lethality=(0.0, 1.0))
ALL = Unknowns(
    lethality=(0.0, 1.0),
    malfunction=Beta(2, 30),
    hazard_density=Beta(1.5, 5),
    kappa=Beta(4, 1.5),
    target_background=Beta(1.5, 8),
    true_positive=Beta(9, 1),
    false_positive=Beta(1, 9),
)
UNKNOWNS = {'all given': Unknowns(), 'lethality learnt': LETHALITY, 'all seven learnt': ALL}
# Cells a side, and deployments at which updates are timed.
LENGTHS = {9: (100, 1000), 50: (100,)}


@cache
def times(side: int, told: str) -> list[float]:
    """Return the seconds of each update of a mission of random walks."""
    grid, rng, model = Grid(side, side), np.random.default_rng(1), SensorModel(0.5)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    prior = Belief.prior(grid, 0.5, 0.45, 0.8)
    estimator = Estimator(prior, model, 'kappa_bnitp_sampled', UNKNOWNS[told])
    taken = []
    for _ in range(LENGTHS[side][-1]):
        observation = world.traverse(walk(grid, rng), model, rng)
        start = time.perf_counter()
        estimator.assimilate(observation)
        taken.append(time.perf_counter() - start)
    return taken


def mean_up_to(side: int, told: str, deployments: int) -> Callable[[], float]:
    """Return a function that returns the mean over the window up to a deployment."""
    return lambda: float(np.mean(times(side, told)[deployments - WINDOW : deployments]))


BENCHMARKS = tuple(
    Benchmark(
        f'An update of `kappa_bnitp_sampled` on {side}x{side} cells, at deployment {number:,}',
        f'Random walks of at most {STEPS} steps; mean times of the {WINDOW} deployments up to '
        'this number.\nSweeps are made until the belief converges.',
        {told: mean_up_to(side, told, number) for told in UNKNOWNS},
    )
    for side, lengths in LENGTHS.items()
    for number in lengths
)
