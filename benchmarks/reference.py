# SPDX-License-Identifier: Apache-2.0
"""
Make the reference of sampling: the posterior of missions by long chains.

``python3 benchmarks/reference.py`` writes test/core/inference/reference.npz. Each posterior is
the mean of two halves of half a million sweeps, by chains that have nothing in common; how far the
halves are apart is kept with it.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

from kbnitp_ros.core import (
    Belief,
    Estimator,
    Grid,
    Observation,
    run_mission,
    SearchOptions,
    SensorModel,
    World,
)
from kbnitp_ros.core.inference.chains import CHAINS, Chains
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

FILE = Path(__file__).parents[1] / 'test' / 'core' / 'inference' / 'reference.npz'
GRID = Grid(9, 9)
PRIOR = Belief.prior(GRID, 0.15, 0.205, 0.8)
LETHALITIES = (0.1, 0.3, 0.5, 0.9)
WORLDS = 3
ROBOTS = 100
SWEEPS = 500_000
HALVES = (1_000_001, 1_000_002)


def mission(lethality: float, number: int) -> list[Observation]:
    """Return the deployments of a mission."""
    rng = np.random.default_rng([11, number])
    world = World.random(GRID, rng, 0.15, 0.8, 0.1)
    model = SensorModel(lethality)
    deployments = run_mission(
        GRID, PRIOR, model, world, ROBOTS, rng, options=SearchOptions('relaxed')
    )
    return [deployment.observation for deployment in deployments]


def posterior(lethality: float, observations: list[Observation], seed: int) -> NDArray[np.float64]:
    """Return the cells' joints by chains that start from a sampler's end."""
    sampler = Estimator(PRIOR, SensorModel(lethality), 'kappa_bnitp_sampled', seed=seed)
    for observation in observations:
        sampler.assimilate(observation)
    own = sampler._inference
    rng = np.random.default_rng(seed)
    moving = Chains(own._hypotheses, own._evidence, own._state, rng)
    for _ in range(SWEEPS // CHAINS):
        moving.sweep()
    return moving.joint()[0]


def divergence(exact: NDArray[np.float64], belief: NDArray[np.float64]) -> float:
    """Return the KL divergence of a belief from the exact one, nats, summed over the cells."""
    possible = exact > 0.0
    return float((exact[possible] * np.log(exact[possible] / belief[possible])).sum())


def main() -> None:
    """Write the file."""
    kept: dict[str, NDArray[np.float64] | NDArray[np.bool_] | NDArray[np.intp]] = {}
    for lethality, number in tqdm(list(product(LETHALITIES, range(WORLDS)))):
        observations = mission(lethality, number)
        halves = [posterior(lethality, observations, seed) for seed in HALVES]
        name = f'{lethality} {number}'
        kept[f'{name} joint'] = np.mean(halves, axis=0)
        kept[f'{name} apart'] = np.array(divergence(*halves))
        kept[f'{name} survived'] = np.array([observation.survived for observation in observations])
        kept[f'{name} length'] = np.array([each.path.size for each in observations])
        kept[f'{name} path'] = np.concatenate([each.path for each in observations])
        readings = [each.readings for each in observations if each.readings is not None]
        kept[f'{name} readings'] = np.concatenate(readings)
        print(name, kept[f'{name} apart'])
    np.savez_compressed(FILE, **kept)


if __name__ == '__main__':
    main()
