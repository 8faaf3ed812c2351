# SPDX-License-Identifier: Apache-2.0
"""
Simulation-based calibration (Talts et al. 2018, arXiv:1804.06788).

Numbers, world and mission are drawn from the priors. Then the rank of each true number in what the
sampler makes of the mission is uniform, if every conditional that it draws from is right.
"""

from math import erfc, exp, gamma, sqrt

import brute_force
from extent import LONG
from kbnitp_ros.core import Belief, Beta, Estimator, Grid, SensorModel, Unknowns, World
from kbnitp_ros.core.inference import sampling_kernels as gibbs_kernels
from kbnitp_ros.core.inference.chains import Chains
import numpy as np
import pytest

# How many worlds, and into how many bins the ranks go.
FEW, MANY = (60, 10), (500, 20)
ROBOTS = 20
FIELD = Grid(3, 3)
# Below this a rank counts as not uniform, of as many as there are.
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
    """Draw numbers, a world and a mission, and return the rank of the truth in each posterior."""
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
    return ranks_of(estimator, drawn, world, rng)


def ranks_of(estimator, places, world, rng):
    """Return the ranks of the numbers, by their places among the values, and of the hazards."""
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
    """Return the least of the p-values of all ranks, times how many they are, and its name."""
    return least_p([ranks(number) for number in range(worlds)], bins)


def least_p(drawn, bins):
    """Return the least of the p-values of ranks, times how many they are, and its name."""
    found, worlds = {}, len(drawn)
    for name in drawn[0]:
        of_name = np.array([each[name] for each in drawn])
        counts, _ = np.histogram(of_name, bins, (0.0, 1.0))
        surplus = counts - worlds / bins
        found[name] = probability_of_more((surplus**2).sum() * bins / worlds, bins)
    name = min(found, key=found.get)
    print({name: round(p, 4) for name, p in found.items()})
    return len(found) * found[name], name


def test_the_chi_square_is_right():
    """Ten per cent quantiles of the tables."""
    assert probability_of_more(14.684, 10) == pytest.approx(0.1, abs=1e-4)
    assert probability_of_more(27.204, 20) == pytest.approx(0.1, abs=1e-4)


@pytest.mark.full
@pytest.mark.parametrize('size', [FEW, pytest.param(MANY, marks=LONG)])
def test_ranks_are_uniform(size):
    p, name = worst(*size)
    assert p > SIGNIFICANT, name


def planted(name):
    """Return a draw of numbers that takes the evidence of one of them for its opposite."""
    draw = Chains._draw

    def wrong(self, drawn, log_likelihood):
        return draw(self, drawn, log_likelihood * (-1.0 if drawn == name else 1.0))

    return wrong


# What few worlds show of an error; of the others it takes many, and minutes each.
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
