# SPDX-License-Identifier: Apache-2.0
"""The cause of a loss, where a person found it: by enumeration of all states, and by its laws."""

import brute_force
import fields_in_full
import hazards_in_time
from kbnitp_ros.core import (
    Belief,
    Dynamics,
    Estimator,
    Grid,
    METHODS,
    Observation,
    SensorModel,
    Unknowns,
    update,
)
from kbnitp_ros.core.inference.filter import Evidence, hazards_used_up
from kbnitp_ros.core.inference.particles import Filters
from laws import for_each
import numpy as np
import pytest

WIDTH, HEIGHT = 3, 2
GRID = Grid(WIDTH, HEIGHT)
AROUND = [
    [
        b
        for b in range(GRID.cells)
        if b != a and max(abs(a % WIDTH - b % WIDTH), abs(a // WIDTH - b // WIDTH)) == 1
    ]
    for a in range(GRID.cells)
]
KINDS = (
    {},
    {'hazards': Dynamics('changing', 0.1, 0.2)},
    {'targets': Dynamics('changing', 0.05, 0.3)},
    {'duds': 0.4},
    {'reach': 0.3},
)


def random_loss(rng):
    path = brute_force.random_path(rng, WIDTH, HEIGHT, 0, int(rng.integers(2, 8)))
    steps = len(path) - 1
    first = int(rng.integers(steps))
    kind = rng.integers(3)
    lost_at = None
    if kind == 0:
        lost_at = (np.arange(steps) == first).astype(float)
    elif kind == 1:
        lost_at = rng.random(steps) + 0.01
    by_hazard = [None, False, True][rng.integers(3)]
    return Observation(path, False, None, first, lost_at, by_hazard=by_hazard)


def case(seed):
    """Draw a prior, a sensor model, what changes, and losses with and without a cause."""
    rng = np.random.default_rng([seed, 70])
    kind = KINDS[seed % len(KINDS)]
    sensors = brute_force.random_sensors(rng)
    model = SensorModel(**sensors, reach=kind.get('reach', 0.0), duds=kind.get('duds', 0.0))
    belief = Belief(brute_force.random_joint(rng, GRID.cells, 0), GRID)
    return belief, model, kind, [random_loss(rng) for _ in range(3)]


def enumerated(belief, model, kind, outcomes):
    around = AROUND if 'reach' in kind else None
    changes = {name: kind.get(name) for name in ('targets', 'hazards')}
    duds = kind.get('duds', 0.0)
    return fields_in_full.posterior(
        belief.joint, model, outcomes, **changes, duds=duds, around=around
    )


@for_each('seed', range(400), every=10)
def test_causes_are_taken_in_exactly(seed):
    belief, model, kind, outcomes = case(seed)
    changes = {'dynamics': 'hazards', 'target_dynamics': 'targets'}
    given = {name: kind[key] for name, key in changes.items() if key in kind}
    estimator = Estimator(belief, model, **given)
    for number, outcome in enumerate(outcomes, 1):
        expected, chance = enumerated(belief, model, kind, outcomes[:number])
        if not chance > 1e-6:
            break
        estimator.assimilate(outcome)
        if 'duds' in kind:
            expected = np.stack([expected[:, 0], expected[:, 1:].sum(axis=1)], axis=1)
        np.testing.assert_allclose(estimator.belief.joint, expected, rtol=0, atol=1e-12)


@for_each('seed', range(200), every=10)
def test_a_hazard_that_is_found_to_be_the_cause_is_used_up(seed):
    rng = np.random.default_rng([seed, 71])
    joint = brute_force.random_joint(rng, GRID.cells, 0)
    model = SensorModel(**brute_force.random_sensors(rng))
    loss = random_loss(rng)
    if loss.by_hazard is False and not model.malfunction:
        return
    lost_at = Evidence.of(loss).lost_in
    flown = model, loss.path.tolist(), None, lost_at, loss.by_hazard
    used_up = Dynamics('used_up')
    expected = hazards_in_time.posterior(joint, used_up, flown)
    estimator = Estimator(Belief(joint), model, dynamics=used_up)
    if expected is None or not np.isfinite(expected).all():
        with pytest.raises(ValueError, match='impossible'):
            estimator.assimilate(loss)
        return
    estimator.assimilate(loss)
    np.testing.assert_allclose(estimator.belief.joint, expected, rtol=0, atol=1e-12)
    gone = hazards_used_up(Belief(joint), model, loss)
    assert ((gone >= 0.0) & (gone <= 1.0 + 1e-12)).all()
    if loss.by_hazard is True and loss.lost_at is not None and (loss.lost_at > 0).sum() == 1:
        struck = loss.path[1:][np.argmax(loss.lost_at)]
        assert gone[struck] == pytest.approx(1.0)


@for_each('seed', range(60), every=6)
def test_particles_are_weighed_by_causes(monkeypatch, seed):
    """A failure that a person vouches for is evidence of the malfunction."""
    monkeypatch.setattr(Filters, '_resample', lambda *_: None)
    belief, _, _, outcomes = case(5 * seed)
    unknowns = Unknowns(lethality=(0.1, 0.9), malfunction=(0.001, 0.3))
    bank = Filters(belief, SensorModel(0.5, 0.1, 0.1), unknowns, 0, Dynamics(), count=5)
    chances = []
    for lethality, malfunction in bank.numbers.tolist():
        own = SensorModel(lethality, malfunction, 0.1)
        chances.append(fields_in_full.posterior(belief.joint, own, outcomes)[1])
    if not sum(chances):
        return
    for outcome in outcomes:
        bank.take(Evidence.of(outcome))
    np.testing.assert_allclose(bank.weights, np.array(chances) / sum(chances), atol=1e-10)


@for_each('seed', range(100), every=10)
def test_a_loss_is_the_sum_over_its_causes(seed):
    """With the probabilities of the causes as weights."""
    belief, model, kind, outcomes = case(seed)
    if 'duds' in kind or not model.malfunction:
        return
    path, steps, lost_at = outcomes[0].path, outcomes[0].steps_survived, outcomes[0].lost_at
    total, mixed = 0.0, np.zeros_like(belief.joint)
    for by_hazard in (False, True):
        loss = Observation(path, False, None, steps, lost_at, by_hazard=by_hazard)
        _, chance = enumerated(belief, model, kind, [loss])
        if chance > 1e-9:
            total += chance
            mixed += chance * update(belief, model, loss).joint
    if total > 1e-6:
        unknown = Observation(path, False, None, steps, lost_at)
        np.testing.assert_allclose(
            update(belief, model, unknown).joint, mixed / total, rtol=0, atol=1e-10
        )


@pytest.mark.parametrize('method', ['kappa_bnitp_published', 'kappa_bnitp_sampled'])
def test_methods_without_causes_refuse_them(method):
    loss = Observation([0, 1, 0], False, None, by_hazard=False)
    estimator = Estimator(Belief.prior(GRID, 0.2, 0.3, 0.4), SensorModel(0.5), method)
    with pytest.raises(ValueError, match=f'by_hazard is given, and {method} does not use it'):
        estimator.assimilate(loss)
    assert method in METHODS


def test_a_return_has_no_cause():
    with pytest.raises(ValueError, match='by_hazard is given, but the robot returned'):
        Observation([0, 1, 0], True, [1, 0], by_hazard=True)
