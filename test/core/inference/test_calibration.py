# SPDX-License-Identifier: Apache-2.0
"""Ranks of the truth among posterior draws are uniform, and long chains agree."""

from dataclasses import dataclass, replace
from math import erfc, exp, gamma, sqrt
from pathlib import Path

import brute_force
from extent import LONG
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
from kbnitp_ros.core.inference import sampling_kernels as gibbs_kernels
from kbnitp_ros.core.inference.chains import Chains
from laws import for_each
import numpy as np
import pytest

# Number of worlds, and of bins for the ranks.
FEW, MANY = (60, 10), (500, 20)
ROBOTS = 20
FIELD = Grid(3, 3)
# Least p-value of uniform ranks, divided by the number of ranks.
SIGNIFICANT = 0.01

UNKNOWNS = Unknowns(
    lethality=(0.1, 1.0),
    malfunction=Beta(2, 20),
    hazard_density=(0.05, 0.7),
    kappa=(0.3, 1.0),
    target_background=Beta(1.5, 4),
    true_positive=(0.6, 1.0),
    false_positive=Beta(1, 6, high=0.5),
)
CELLS = [1, 2, 4, 6, 8]
PRIOR = Belief.prior(FIELD, 0.3, 0.4, 0.7)


def ranks(number):
    """Draw parameters, a world and a mission; return the rank of the truth in each posterior."""
    rng = np.random.default_rng([17, number])
    drawn = {}
    for name, prior in UNKNOWNS.priors.items():
        bins = prior.bins()
        drawn[name] = int(rng.choice(bins.values.size, p=np.exp(bins.log_prior)))
    value = {name: UNKNOWNS.priors[name].bins().values[place] for name, place in drawn.items()}
    of_world = [value.pop(name) for name in ('hazard_density', 'kappa', 'target_background')]
    truth = SensorModel(**value)
    world = World.random(FIELD, rng, *of_world)
    estimator = Estimator(
        PRIOR, SensorModel(0.5), 'kappa_bnitp_sampled', UNKNOWNS, seed=int(rng.integers(2**32))
    )
    for _ in range(ROBOTS):
        path = brute_force.random_path(rng, 3, 3, 0, int(rng.integers(2, 8)))
        estimator.assimilate(world.traverse(path, truth, rng))
    return truth_ranks(estimator, drawn, world, rng)


def truth_ranks(estimator, places, world, rng):
    """Return the ranks of the true parameters, by their places among the values, and hazards."""
    found = {}
    for name, place in places.items():
        weights = estimator.parameters[name].weights
        found[name] = weights[:place].sum() + rng.random() * weights[place]
    for cell in CELLS:
        hazard = estimator.belief.hazard[cell]
        safe = rng.random() * (1 - hazard)
        found[f'cell {cell}'] = 1 - hazard * rng.random() if world.hazard[cell] else safe
    return found


def probability_of_more(statistic, bins):
    """Return P(chi-square > statistic) of an even number of bins."""
    y = statistic / 2
    p = erfc(sqrt(y))
    for twice in range(1, bins - 1, 2):
        p += y ** (twice / 2) * exp(-y) / gamma(twice / 2 + 1)
    return p


def worst(worlds, bins):
    """Return the least p-value of all ranks, times their number, and its name."""
    return least_p([ranks(number) for number in range(worlds)], bins)


def least_p(drawn, bins):
    """Return the least p-value of ranks, times their number, and its name."""
    found, worlds = {}, len(drawn)
    for name in drawn[0]:
        of_name = np.array([each[name] for each in drawn])
        counts, _ = np.histogram(of_name, bins, (0.0, 1.0))
        surplus = counts - worlds / bins
        found[name] = probability_of_more((surplus**2).sum() * bins / worlds, bins)
    name = min(found, key=found.get)
    print({name: round(p, 4) for name, p in found.items()})
    return len(found) * found[name], name


@pytest.mark.full
@pytest.mark.parametrize('size', [FEW, pytest.param(MANY, marks=LONG)])
def test_ranks_are_uniform(size):
    p, name = worst(*size)
    assert p > SIGNIFICANT, name


def planted(name):
    """Return a draw of parameters that inverts the evidence of one of them."""
    draw = Chains._draw

    def wrong(self, drawn, log_likelihood):
        return draw(self, drawn, log_likelihood * (-1.0 if drawn == name else 1.0))

    return wrong


# Errors that few worlds reveal; others take many worlds, and minutes each.
SEEN_SOON = {'malfunction', 'hazard_density', 'target_background'}


@pytest.mark.full
@pytest.mark.parametrize('name, size', [
    (name, FEW) if name in SEEN_SOON else pytest.param(name, MANY, marks=LONG)
    for name in UNKNOWNS.priors
])  # fmt: skip
def test_an_error_in_the_draw_of_a_number_is_found(name, size, monkeypatch):
    monkeypatch.setattr(Chains, '_draw', planted(name))
    p, _ = worst(*size)
    assert p < SIGNIFICANT


@pytest.mark.full
def test_an_error_in_the_draw_of_hazards_is_found(monkeypatch):
    """All hazards are drawn at twice their odds."""
    draw = gibbs_kernels.draw_hazards

    def wrong(chains, chances, *others):
        draw(chains, chances._replace(odds=chances.odds * 2.0), *others)

    monkeypatch.setattr(gibbs_kernels, 'draw_hazards', wrong)
    p, _ = worst(*FEW)
    assert p < SIGNIFICANT


# Simulation-based calibration with last contacts and with hazards that change or cluster.


WORLDS, BINS, SENT, DRAWS = 120, 10, 20, 400
DENSITY, KAPPA, BACKGROUND = 0.3, 0.7, 0.27
PRIOR_OF_KINDS = Belief.prior(FIELD, DENSITY, DENSITY * KAPPA + (1 - DENSITY) * BACKGROUND, KAPPA)
LETHALITY = Unknowns(lethality=(0.1, 1.0))
CHANGING = Dynamics('changing', appear=0.02, vanish=0.2)


@dataclass(frozen=True)
class Kind:
    """The truth of hazards and contacts, and the belief in it unless an error is planted."""

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
    """Draw a coupling and a world of that prior; return both, the coupling by its place."""
    bins = clustering.bins
    place = int(rng.choice(bins.values.size, p=np.exp(bins.log_prior)))
    states, chances = brute_force.clustered_prior(FIELD, bins.values[place], DENSITY)
    hazard = states[rng.choice(len(states), p=chances)].astype(bool)
    target = rng.random(FIELD.cells) < np.where(hazard, KAPPA, BACKGROUND)
    return replace(world, hazard=hazard, target=target), {'coupling': place}


def kind_ranks(number, kind, believed, as_told):
    """Draw a world and a mission; return the rank of the truth in each posterior."""
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
        PRIOR_OF_KINDS,
        truth if not kind.unknowns.priors else replace(truth, lethality=0.5),
        believed.method,
        believed.unknowns,
        int(rng.integers(2**32)),
        dynamics=believed.dynamics,
        clustering=believed.clustering,
    )
    execution = Execution(contact=kind.contact)
    for robot in range(SENT):
        path = brute_force.random_path(rng, 3, 3, 0, int(rng.integers(2, 8)))
        changing = FIELD.may_be_hazardous if robot else None
        made = execution.traverse(
            world, FIELD, path, truth, rng.spawn(1)[0], kind.dynamics, changing
        )
        world = made.world
        estimator.assimilate(as_told(made.observation))
    coupling = places.pop('coupling', None)
    found = truth_ranks(estimator, places, world, rng)
    if coupling is not None:
        drawn, _ = estimator.draws(DRAWS, rng)
        true, of_draws = (brute_force.pairs(FIELD, each) for each in (world.hazard, drawn))
        ties = rng.random() * (of_draws == true).mean()
        found['pairs of hazards'] = (of_draws < true).mean() + ties
    return found


def worst_of_kind(kind, believed, as_told=replace):
    """Return the least p-value of all ranks, times their number, and its name."""
    drawn = [kind_ranks(number, kind, believed, as_told) for number in range(WORLDS)]
    return least_p(drawn, BINS)


@pytest.mark.full
@for_each('kind', KINDS)
def test_ranks_are_uniform_of_kinds(kind):
    p, name = worst_of_kind(KINDS[kind], KINDS[kind])
    assert p > SIGNIFICANT, name


def late(observation):
    """Report a loss a step late."""
    if observation.lost_at is None:
        return observation
    return replace(observation, steps_survived=0, lost_at=np.roll(observation.lost_at, 1))


CLUSTERED = replace(KINDS['clustered'], clustering=Clustering(FIELD, 1.7))
FASTER = Dynamics('changing', appear=0.2, vanish=0.02)


@pytest.mark.full
@for_each('kind, wrong, told', [
    (KINDS['heard'], {}, late),
    (KINDS['changing'], {'dynamics': FASTER}, replace),
    (KINDS['used_up'], {'dynamics': STATIC}, replace),
    (CLUSTERED, {'clustering': None}, replace),
])  # fmt: skip
def test_late_reports_and_wrong_beliefs_are_found(kind, wrong, told):
    p, _ = worst_of_kind(kind, replace(kind, **wrong), told)
    assert p < SIGNIFICANT


# Sampling against long chains, written by `benchmarks/reference.py`.


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
        for number in range(REFERENCE_WORLDS):
            assert len(mission(lethality, number)) == 100
            assert kept(lethality, number, 'apart') < APART


@pytest.mark.slow
@for_each('lethality', LETHALITIES[::-1], every=4)
def test_sampling_is_close(lethality):
    assert np.mean([away(lethality, number) for number in range(REFERENCE_WORLDS)]) < CLOSE
