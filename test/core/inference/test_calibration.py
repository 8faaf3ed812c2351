# SPDX-License-Identifier: Apache-2.0
"""Ranks of the truth among posterior draws are uniform, and long chains agree."""

from dataclasses import dataclass, replace
from math import erfc, exp, gamma, sqrt
from pathlib import Path

import brute_force
from kbnitp_ros.core import (
    Belief,
    Beta,
    Clustering,
    Dynamics,
    Estimator,
    Execution,
    Grid,
    Observation,
    SensorModel,
    Unknowns,
    World,
)
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, STATIC
from laws import for_each
import numpy as np
import pytest

WORLDS, BINS, ROBOTS, DRAWS = 120, 10, 20, 400
FIELD = Grid(3, 3)
CELLS = [1, 2, 4, 6, 8]
# Least p-value of uniform ranks, divided by the number of ranks.
SIGNIFICANT = 0.01

# True numbers that are not drawn, and the prior of worlds with them.
WORLD = {'hazard_density': 0.3, 'kappa': 0.7, 'target_background': 0.27}
SENSORS = {'lethality': 0.6, 'malfunction': 0.02}
PRIOR = Belief.prior(FIELD, 0.3, 0.3 * 0.7 + 0.7 * 0.27, 0.7)

LETHALITY = Unknowns(lethality=(0.1, 1.0))
NUMBERS = Unknowns(
    lethality=(0.1, 1.0),
    malfunction=Beta(2, 20),
    hazard_density=(0.05, 0.7),
    kappa=(0.3, 1.0),
    target_background=Beta(1.5, 4),
    true_positive=(0.6, 1.0),
    false_positive=Beta(1, 6, high=0.5),
)
CHANGING = Dynamics('changing', appear=0.02, vanish=0.2)


@dataclass(frozen=True)
class Kind:
    """The truth of hazards and contacts, and the belief in it."""

    method: str = 'kappa_bnitp_sampled'
    contact: float = 0.0
    dynamics: Dynamics = STATIC
    unknowns: Unknowns = ALL_KNOWN
    clustering: Clustering | None = None


KINDS = {
    'numbers': Kind(unknowns=NUMBERS),
    'heard': Kind(contact=0.9, unknowns=LETHALITY),
    'changing': Kind('kappa_bnitp', dynamics=CHANGING),
    'used_up': Kind('kappa_bnitp', contact=0.5, dynamics=Dynamics('used_up')),
    'clustered': Kind(unknowns=LETHALITY, clustering=Clustering(FIELD, 'learn')),
}


def draw_place(bins, rng):
    return int(rng.choice(bins.values.size, p=np.exp(bins.log_prior)))


def clustered(world, clustering, rng):
    place = draw_place(clustering.bins, rng)
    coupling = clustering.bins.values[place]
    states, chances = brute_force.clustered_prior(FIELD, coupling, WORLD['hazard_density'])
    hazard = states[rng.choice(len(states), p=chances)].astype(bool)
    target = rng.random(FIELD.cells) < np.where(hazard, WORLD['kappa'], WORLD['target_background'])
    return replace(world, hazard=hazard, target=target), {'coupling': place}


def ranks(number, kind):
    rng = np.random.default_rng([24, number])
    bins = {name: prior.bins() for name, prior in kind.unknowns.priors.items()}
    places = {name: draw_place(each, rng) for name, each in bins.items()}
    drawn = {name: float(bins[name].values[place]) for name, place in places.items()}
    world = World.random(FIELD, rng, *(drawn.pop(name, value) for name, value in WORLD.items()))
    if kind.clustering is not None:
        world, coupling = clustered(world, kind.clustering, rng)
        places |= coupling
    truth = SensorModel(**SENSORS | drawn)
    estimator = Estimator(
        PRIOR,
        replace(truth, **dict.fromkeys(drawn, 0.5)),
        kind.method,
        kind.unknowns,
        int(rng.integers(2**32)),
        dynamics=kind.dynamics,
        clustering=kind.clustering,
    )
    execution = Execution(contact=kind.contact)
    for robot in range(ROBOTS):
        path = brute_force.random_path(rng, 3, 3, 0, int(rng.integers(2, 8)))
        changing = FIELD.may_be_hazardous if robot else None
        made = execution.traverse(
            world, FIELD, path, truth, rng.spawn(1)[0], kind.dynamics, changing
        )
        world = made.world
        estimator.assimilate(made.observation)
    return truth_ranks(estimator, places, world, rng)


def truth_ranks(estimator, places, world, rng):
    found = {}
    if places.pop('coupling', None) is not None:
        drawn, _ = estimator.draws(DRAWS, rng)
        true, of_draws = (brute_force.pairs(FIELD, each) for each in (world.hazard, drawn))
        ties = rng.random() * (of_draws == true).mean()
        found['pairs of hazards'] = (of_draws < true).mean() + ties
    for name, place in places.items():
        weights = estimator.parameters[name].weights
        found[name] = weights[:place].sum() + rng.random() * weights[place]
    for cell in CELLS:
        hazard = estimator.belief.hazard[cell]
        safe = rng.random() * (1 - hazard)
        found[f'cell {cell}'] = 1 - hazard * rng.random() if world.hazard[cell] else safe
    return found


def probability_of_more(statistic, bins):
    y = statistic / 2
    p = erfc(sqrt(y))
    for twice in range(1, bins - 1, 2):
        p += y ** (twice / 2) * exp(-y) / gamma(twice / 2 + 1)
    return p


def worst(kind):
    """Return the least p-value of all ranks, times their number, and its name."""
    drawn = [ranks(number, kind) for number in range(WORLDS)]
    found = {}
    for name in drawn[0]:
        of_name = np.array([each[name] for each in drawn])
        counts, _ = np.histogram(of_name, BINS, (0.0, 1.0))
        surplus = counts - WORLDS / BINS
        found[name] = probability_of_more((surplus**2).sum() * BINS / WORLDS, BINS)
    name = min(found, key=found.get)
    print({name: round(p, 4) for name, p in found.items()})
    return len(found) * found[name], name


@pytest.mark.full
@for_each('kind', KINDS)
def test_ranks_are_uniform(kind):
    p, name = worst(KINDS[kind])
    assert p > SIGNIFICANT, name


REFERENCE = np.load(Path(__file__).with_name('reference.npz'))
GRID = Grid(9, 9)
LETHALITIES = (0.1, 0.3, 0.5, 0.9)
REFERENCE_WORLDS = 3
# KL divergence, nats: tolerance of sampling by default, and between the chains' halves.
CLOSE = 0.0005
APART = 1e-5


def kept(lethality, number, what):
    return REFERENCE[f'{lethality} {number} {what}']


def mission(lethality, number):
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
        for number in range(REFERENCE_WORLDS):
            assert len(mission(lethality, number)) == 100
            assert kept(lethality, number, 'apart') < APART


@pytest.mark.full
@for_each('lethality', LETHALITIES)
def test_sampling_is_close(lethality):
    assert np.mean([away(lethality, number) for number in range(REFERENCE_WORLDS)]) < CLOSE
