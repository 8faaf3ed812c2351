# SPDX-License-Identifier: Apache-2.0
"""The methods without kappa."""

import brute_force
from kbnitp_ros.core import Belief, Estimator, Observation, SensorModel, update
from laws import for_each
import numpy as np


@for_each('seed', range(300))
def test_averaging_universes_gives_the_exact_marginals(seed):
    """On long paths over many cells, with stays and repeats."""
    rng = np.random.default_rng(seed)
    width, height = (int(size) for size in rng.integers(2, 10, 2))
    belief = Belief(brute_force.random_joint(rng, width * height, 0)).independent()
    path = brute_force.random_path(rng, width, height, 0, int(rng.integers(2, 31)))
    model = SensorModel(**{**brute_force.random_sensors(rng), 'malfunction': 0.05})
    averaged, exact = (
        update(belief, model, Observation(path, False), method)
        for method in ('relaxed_itp', 'kappa_bnitp')
    )
    np.testing.assert_allclose(averaged.joint, exact.joint, rtol=0, atol=1e-12)


@for_each('method', ['relaxed_itp', 'relaxed_bnitp'])
@for_each('seed', range(20))
def test_hazard_and_target_stay_independent(seed, method):
    rng = np.random.default_rng(seed)
    joint, model = brute_force.random_joint(rng, 16, 0), SensorModel(0.5)
    estimator = Estimator(Belief(joint), model, method)
    for _ in range(30):
        path = brute_force.random_path(rng, 4, 4, 0, int(rng.integers(2, 11)))
        readings = rng.random(len(path) - 1) < 0.5 if rng.random() < 0.5 else None
        estimator.assimilate(Observation(path, readings is not None, readings))
        belief = estimator.belief
        z = np.stack([1 - belief.hazard, belief.hazard], axis=-1)
        x = np.stack([1 - belief.target, belief.target], axis=-1)
        np.testing.assert_allclose(belief.joint, z[:, :, None] * x[:, None, :], rtol=0, atol=1e-15)
