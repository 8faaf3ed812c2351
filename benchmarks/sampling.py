# SPDX-License-Identifier: Apache-2.0
"""How long it takes to take in one deployment more by sampling, and to learn numbers with it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import time

from cases import Benchmark
from kbnitp_ros.core import Belief, Beta, Estimator, Grid, SensorModel, Unknowns, World
import numpy as np
from updates import STEPS, walk

DEPLOYMENTS = (100, 1000)
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
CASES = {
    'all told, 9x9 cells': (9, Unknowns()),
    'lethality learnt, 9x9 cells': (9, LETHALITY),
    'all seven learnt, 9x9 cells': (9, ALL),
    'all told, 50x50 cells': (50, Unknowns()),
    'lethality learnt, 50x50 cells': (50, LETHALITY),
    'all seven learnt, 50x50 cells': (50, ALL),
}


@cache
def times(case: str) -> list[float]:
    """Return the seconds of each update of a mission of random walks."""
    side, unknowns = CASES[case]
    grid, rng, model = Grid(side, side), np.random.default_rng(1), SensorModel(0.5)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    prior = Belief.prior(grid, 0.5, 0.45, 0.8)
    estimator = Estimator(prior, model, 'kappa_bnitp_sampled', unknowns)
    taken = []
    for _ in range(DEPLOYMENTS[-1]):
        observation = world.traverse(walk(grid, rng), model, rng)
        start = time.perf_counter()
        estimator.assimilate(observation)
        taken.append(time.perf_counter() - start)
    return taken


def mean_up_to(case: str, deployments: int) -> Callable[[], float]:
    """Return what gives the mean over the window that ends with a deployment."""
    return lambda: float(np.mean(times(case)[deployments - WINDOW : deployments]))


BENCHMARKS = tuple(
    Benchmark(
        f'An update of `kappa_bnitp_sampled` at deployment {number:,}',
        f'A mission of random walks of at most {STEPS} steps; means over the {WINDOW} deployments '
        'up to it. Sweeps\nare made until the belief is settled.',
        {case: mean_up_to(case, number) for case in CASES},
    )
    for number in DEPLOYMENTS
)
