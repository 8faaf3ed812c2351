# SPDX-License-Identifier: Apache-2.0
"""Time of one update, by kind of hazards."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import time

from cases import Benchmark
from kbnitp_ros.core import Belief, Clustering, Dynamics, Estimator, Grid, SensorModel, World
import numpy as np
from updates import SIDE, STEPS, walk

# Number of timed updates up to this deployment, in each mission.
DEPLOYMENTS, WINDOW = 100, 20
MISSIONS = 10

KINDS: dict[str, dict[str, Dynamics | Clustering]] = {
    'static': {},
    'changing': {'dynamics': Dynamics('changing', appear=0.002, vanish=0.01)},
    'moving': {'dynamics': Dynamics('moving', move=0.02)},
    'used up': {'dynamics': Dynamics('used_up')},
    'clustered': {'clustering': Clustering(Grid(SIDE, SIDE), 'learn')},
}
METHODS = {
    'kappa_bnitp': ['static', 'changing', 'moving', 'used up'],
    'kappa_bnitp_sampled': ['static', 'clustered'],
}


@cache
def times(method: str) -> dict[str, list[float]]:
    """Return the processor seconds of updates, which alternate between kinds."""
    taken: dict[str, list[float]] = {kind: [] for kind in METHODS[method]}
    for mission in range(MISSIONS):
        grid, rng, model = Grid(SIDE, SIDE), np.random.default_rng(mission), SensorModel(0.5)
        world = World.random(grid, rng, 0.15, 0.8, 0.1)
        prior = Belief.prior(grid, 0.15, 0.205, 0.8)
        estimators = {kind: Estimator(prior, model, method, **KINDS[kind]) for kind in taken}
        for deployment in range(DEPLOYMENTS):
            observation = world.traverse(walk(grid, rng), model, rng)
            for kind, estimator in estimators.items():
                start = time.process_time()
                estimator.assimilate(observation)
                if deployment >= DEPLOYMENTS - WINDOW:
                    taken[kind].append(time.process_time() - start)
    return taken


def update_timer(method: str, kind: str) -> Callable[[], float]:
    """Return a function that returns the mean time of a kind's updates."""
    return lambda: float(np.mean(times(method)[kind]))


BENCHMARKS = tuple(
    Benchmark(
        f'An update of `{method}` by kinds of hazards, at deployment {DEPLOYMENTS}',
        f'{MISSIONS} missions of random walks of at most {STEPS} steps on {SIDE}x{SIDE} cells; '
        f'mean processor times\nof the {WINDOW} deployments up to this number. The kinds take '
        'turns on the same deployments.',
        {kind: update_timer(method, kind) for kind in kinds},
    )
    for method, kinds in METHODS.items()
)
