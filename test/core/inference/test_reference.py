# SPDX-License-Identifier: Apache-2.0
"""Sampling, against long chains: `benchmarks/reference.py` wrote them."""

from pathlib import Path

from kbnitp_ros.core import Belief, Estimator, Grid, Observation, SensorModel
from laws import for_each
import numpy as np
import pytest

REFERENCE = np.load(Path(__file__).with_name('reference.npz'))
GRID = Grid(9, 9)
LETHALITIES = (0.1, 0.3, 0.5, 0.9)
WORLDS = 3
# KL divergence, nats: what sampling may be away by default, and the two halves of the chains.
CLOSE = 0.0005
APART = 1e-5


def kept(lethality, number, what):
    return REFERENCE[f'{lethality} {number} {what}']


def mission(lethality, number):
    """Return the deployments of a mission."""
    lengths, survived = (kept(lethality, number, what) for what in ('length', 'survived'))
    paths = np.split(kept(lethality, number, 'path'), np.cumsum(lengths)[:-1])
    steps = (lengths - 1)[survived]
    readings = iter(np.split(kept(lethality, number, 'readings'), np.cumsum(steps)[:-1]))
    return [
        Observation(path, bool(returned), next(readings) if returned else None)
        for path, returned in zip(paths, survived)
    ]


def away(lethality, number):
    """Return the KL divergence of a belief from the long chains', summed over the cells."""
    prior = Belief.prior(GRID, 0.15, 0.205, 0.8)
    model = SensorModel(lethality)
    estimator = Estimator(prior, model, 'kappa_bnitp_sampled', seed=number)
    for observation in mission(lethality, number):
        estimator.assimilate(observation)
    exact = kept(lethality, number, 'joint')
    possible = exact > 0.0
    belief = estimator.belief.joint
    return (exact[possible] * np.log(exact[possible] / belief[possible])).sum()


def test_the_long_chains_agree():
    for lethality in LETHALITIES:
        for number in range(WORLDS):
            assert len(mission(lethality, number)) == 100
            assert kept(lethality, number, 'apart') < APART


@pytest.mark.slow
@for_each('lethality', LETHALITIES[::-1], every=4)
def test_sampling_is_close(lethality):
    assert np.mean([away(lethality, number) for number in range(WORLDS)]) < CLOSE
