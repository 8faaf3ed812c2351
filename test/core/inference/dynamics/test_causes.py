# SPDX-License-Identifier: Apache-2.0
"""Sampled beliefs where hazards do not stay, against all states in full."""

from extent import FULL
import hazards_in_time
from kbnitp_ros.core import (
    Belief,
    Dynamics,
    Estimator,
    Grid,
    Observation,
    RobotType,
    SensorModel,
    Unknowns,
)
from kbnitp_ros.core.inference.sampling import cause_sampler
from laws import for_each
import numpy as np
import pytest
from test_one_pass_dynamics import drawn, is_taken_in, seen

METHOD = 'kappa_bnitp_sampled'


def divergence(exact, believed):
    """KL divergence in nats, summed over the cells."""
    held = exact > 0
    return float((exact[held] * np.log(exact[held] / believed[held])).sum())


def divergences(kind, seeds):
    """Yield that of the belief in the deployments of each case, from the exact one."""
    for seed in seeds:
        joint, dynamics, deployments = drawn(seed, kind)
        estimator = Estimator(Belief(joint), SensorModel(0.5), METHOD, dynamics=dynamics)
        done = []
        for model, path, readings, heard in deployments:
            flown = model, path, readings, np.arange(len(path) - 1) >= heard
            exact = hazards_in_time.posterior(joint, dynamics, *done, flown)
            observation = seen(path, readings, heard)
            if is_taken_in(estimator, observation, RobotType(**vars(model))):
                done.append(flown)
                assert exact is not None
            else:
                assert exact is None
        if dynamics.effect != 'static':
            yield divergence(
                hazards_in_time.posterior(joint, dynamics, *done), estimator.belief.joint
            )


@pytest.mark.slow
@pytest.mark.parametrize('seeds', [range(20), pytest.param(range(300), marks=pytest.mark.full)])
@for_each('kind', ['used_up', 'changing'])
def test_it_is_the_posterior_of_all_deployments(kind, seeds):
    found = list(divergences(kind, seeds))
    assert np.mean(found) < 0.003
    # Of hundreds of cases a few take more sweeps than the default has.
    assert np.quantile(found, 0.98) < 0.02
    assert max(found) < 0.1


@pytest.mark.slow
@for_each('kind', ['used_up', 'changing'])
def test_more_sweeps_come_closer(kind, monkeypatch):
    seeds = range(8 if FULL else 3)
    before = np.mean(list(divergences(kind, seeds)))
    monkeypatch.setattr(cause_sampler, 'SWEEPS', 256)
    monkeypatch.setattr(cause_sampler, 'MOST_SWEEPS', 256)
    after = np.mean(list(divergences(kind, seeds)))
    assert after < 0.0003
    assert after < 0.5 * before


def test_a_loss_late_on_a_long_path_is_explained():
    """All steps survived before it have a probability of less than the least number."""
    grid = Grid(500, 1)
    prior = Belief.prior(grid, 0.9, 0.5, 0.5)
    out = np.arange(grid.cells)
    lost = Observation([*out, *out[-2::-1]], False, None, 2 * grid.cells - 5)
    one_pass, sampled = (
        Estimator(prior, SensorModel(0.9), method, dynamics=Dynamics('used_up'))
        for method in ('kappa_bnitp', METHOD)
    )
    one_pass.assimilate(lost)
    sampled.assimilate(lost)
    assert divergence(one_pass.belief.joint, sampled.belief.joint) < 0.01


def test_explanations_are_exchanged_without_malfunction():
    """Both robots can only have met the two hazards; which met which is even."""
    prior = Belief.from_maps([0.0, 0.5, 0.5, 0.0], [0.5] * 4, [0.5] * 4)
    model = SensorModel(0.5, malfunction=0.0)
    estimator = Estimator(prior, model, METHOD, dynamics=Dynamics('used_up'))
    path = [0, 1, 2, 3, 0]
    for _ in range(2):
        estimator.assimilate(Observation(path, False))
    assert estimator.belief.hazard == pytest.approx([0.0] * 4, abs=0.01)
    before = estimator.belief.joint.tobytes()
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(Observation(path, False))
    assert estimator.belief.joint.tobytes() == before


def test_the_same_seed_is_the_same_belief_and_copies_go_on_by_themselves():
    joint, dynamics, deployments = drawn(3, 'used_up')
    taken = [seen(path, readings, heard) for _, path, readings, heard in deployments]
    beliefs = []
    for seed in (1, 1, 2):
        estimator = Estimator(
            Belief(joint), SensorModel(0.5), METHOD, seed=seed, dynamics=dynamics
        )
        for observation in taken[:-1]:
            estimator.assimilate(observation)
        other = estimator.copy()
        other.assimilate(taken[0])
        estimator.assimilate(taken[-1])
        beliefs.append(estimator.belief.joint.tobytes())
    assert beliefs[0] == beliefs[1]
    assert beliefs[0] != beliefs[2]


def test_numbers_are_learnt_of_static_hazards_alone():
    prior = Belief.from_maps([0.0, 0.5], [0.5, 0.5], [0.5, 0.5])
    unknowns = Unknowns(lethality=(0.0, 1.0))
    with pytest.raises(ValueError, match='lethality cannot be unknown .* used_up'):
        Estimator(prior, SensorModel(0.5), METHOD, unknowns, dynamics=Dynamics('used_up'))
