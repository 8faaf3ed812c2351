# SPDX-License-Identifier: Apache-2.0
"""Simulation-based calibration where losses are heard and hazards change, go or cluster."""

from dataclasses import dataclass, replace

import brute_force
from kbnitp_ros.core import (
    Belief,
    Clustering,
    Dynamics,
    Estimator,
    Execution,
    Grid,
    SensorModel,
    Unknowns,
    World,
)
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, STATIC
from laws import for_each
import numpy as np
import pytest
from test_calibration import least_p, ranks_of, SIGNIFICANT

pytestmark = pytest.mark.full

WORLDS, BINS, ROBOTS, DRAWS = 120, 10, 20, 400
FIELD = Grid(3, 3)
DENSITY, KAPPA, BACKGROUND = 0.3, 0.7, 0.27
PRIOR = Belief.prior(FIELD, DENSITY, DENSITY * KAPPA + (1 - DENSITY) * BACKGROUND, KAPPA)
LETHALITY = Unknowns(lethality=(0.1, 1.0))
CHANGING = Dynamics('changing', appear=0.02, vanish=0.2)


@dataclass(frozen=True)
class Kind:
    """What is true of hazards and of what is heard, and is believed unless an error is planted."""

    method: str = 'kappa_bnitp_sampled'
    contact: float = 0.0
    dynamics: Dynamics = STATIC
    unknowns: Unknowns = ALL_KNOWN
    clustering: Clustering | None = None


KINDS = {
    'heard': Kind(contact=0.9, unknowns=LETHALITY),
    'changing': Kind('kappa_bnitp', dynamics=CHANGING),
    'used_up': Kind('kappa_bnitp', contact=0.5, dynamics=Dynamics('used_up')),
    'clustered': Kind(unknowns=LETHALITY, clustering=Clustering(FIELD, 'learn')),
}


def clustered(world, clustering, rng):
    """Draw a coupling and a world of that prior; return them, the coupling by its place."""
    bins = clustering.bins
    place = int(rng.choice(bins.values.size, p=np.exp(bins.log_prior)))
    states, chances = brute_force.clustered_prior(FIELD, bins.values[place], DENSITY)
    hazard = states[rng.choice(len(states), p=chances)].astype(bool)
    target = rng.random(FIELD.cells) < np.where(hazard, KAPPA, BACKGROUND)
    return replace(world, hazard=hazard, target=target), {'coupling': place}


def ranks(number, kind, believed, as_told):
    """Draw a world and a mission, and return the rank of the truth in each posterior."""
    rng = np.random.default_rng([24, number])
    world, places = World.random(FIELD, rng, DENSITY, KAPPA, BACKGROUND), {}
    if kind.clustering is not None:
        world, places = clustered(world, kind.clustering, rng)
    lethality = 0.6
    for name, prior in kind.unknowns.priors.items():
        bins = prior.bins()
        places[name] = int(rng.choice(bins.values.size, p=np.exp(bins.log_prior)))
        lethality = float(bins.values[places[name]])
    truth = SensorModel(lethality, malfunction=0.02)
    estimator = Estimator(
        PRIOR,
        truth if not kind.unknowns.priors else replace(truth, lethality=0.5),
        believed.method,
        believed.unknowns,
        int(rng.integers(2**32)),
        dynamics=believed.dynamics,
        clustering=believed.clustering,
    )
    execution = Execution(contact=kind.contact)
    for robot in range(ROBOTS):
        path = brute_force.random_path(rng, 3, 3, 0, int(rng.integers(2, 8)))
        changing = FIELD.may_be_hazardous if robot else None
        made = execution.traverse(
            world, FIELD, path, truth, rng.spawn(1)[0], kind.dynamics, changing
        )
        world = made.world
        estimator.assimilate(as_told(made.observation))
    coupling = places.pop('coupling', None)
    found = ranks_of(estimator, places, world, rng)
    if coupling is not None:
        drawn, _ = estimator.draws(DRAWS, rng)
        true, of_draws = (brute_force.pairs(FIELD, each) for each in (world.hazard, drawn))
        ties = rng.random() * (of_draws == true).mean()
        found['pairs of hazards'] = (of_draws < true).mean() + ties
    return found


def worst(kind, believed=None, as_told=lambda observation: observation):
    """Return the least of the p-values of all ranks, times how many they are, and its name."""
    drawn = [ranks(number, kind, believed or kind, as_told) for number in range(WORLDS)]
    return least_p(drawn, BINS)


@for_each('kind', KINDS)
def test_ranks_are_uniform(kind):
    p, name = worst(KINDS[kind])
    assert p > SIGNIFICANT, name


def test_losses_told_a_step_late_are_found():
    def late(observation):
        if observation.lost_at is None:
            return observation
        return replace(observation, steps_survived=0, lost_at=np.roll(observation.lost_at, 1))

    p, _ = worst(KINDS['heard'], as_told=late)
    assert p < SIGNIFICANT


@for_each(
    'kind, dynamics',
    [('changing', Dynamics('changing', appear=0.2, vanish=0.02)), ('used_up', STATIC)],
)
def test_dynamics_of_another_kind_are_found(kind, dynamics):
    p, _ = worst(KINDS[kind], replace(KINDS[kind], dynamics=dynamics))
    assert p < SIGNIFICANT


def test_independence_of_clustered_hazards_is_found():
    kind = replace(KINDS['clustered'], clustering=Clustering(FIELD, 1.7))
    p, _ = worst(kind, replace(kind, clustering=None))
    assert p < SIGNIFICANT
