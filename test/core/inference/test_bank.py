# SPDX-License-Identifier: Apache-2.0
"""A bank of filters: each equals the one-pass method, evidence by enumeration, the mixture."""

import brute_force
from extent import FULL
import hazards_in_time
from kbnitp_ros.core import (
    Belief,
    Beta,
    Dynamics,
    Estimator,
    Finding,
    Grid,
    Observation,
    ORDINARY,
    RobotType,
    run_mission,
    SearchOptions,
    SensorModel,
    Unknowns,
    World,
)
from kbnitp_ros.core.field.unknowns import joint_after_change
from kbnitp_ros.core.inference.filter import Evidence
from kbnitp_ros.core.inference.particles import COPIES, Filters
from laws import for_each
import numpy as np
import pytest

METHODS = ('kappa_bnitp', 'relaxed_itp')
KINDS = ('static', 'changing', 'used_up')
TWO = Unknowns(lethality=(0.0, 1.0), malfunction=Beta(2.0, 30.0))
SEVEN = Unknowns(
    lethality=(0.0, 1.0),
    malfunction=Beta(2.0, 30.0),
    hazard_density=Beta(1.5, 5.0),
    kappa=(0.0, 1.0),
    target_background=(0.0, 0.5),
    true_positive=(0.5, 1.0),
    false_positive=(0.0, 0.5),
)


def new_dynamics(kind):
    return Dynamics(kind, 0.02, 0.1) if kind == 'changing' else Dynamics(kind)


def drawn(seed, deployments=4):
    """Draw a prior, a sensor model and outcomes of robots, some of a type of their own."""
    rng = np.random.default_rng(seed)
    joint = brute_force.random_joint(rng, 6, 0)
    model = SensorModel(0.5, 0.1, 0.1, 0.9, 0.1)
    outcomes = []
    for _ in range(deployments):
        path = brute_force.random_path(rng, 3, 2, 0, int(rng.integers(1, 8)))
        steps = len(path) - 1
        if rng.random() < 0.5:
            observation = Observation(path, True, rng.integers(-1, 2, steps))
        else:
            heard = int(rng.integers(steps))
            fits = rng.random(steps) + 0.01 if rng.random() < 0.5 else None
            observation = Observation(path, False, None, heard, fits)
        own = RobotType(lethality=0.9, malfunction=0.2) if rng.random() < 0.3 else ORDINARY
        outcomes.append((observation, own))
    return Belief(joint), model, outcomes


def particle_sensors(numbers):
    """Return the sensor model of a particle of `TWO`."""
    return SensorModel(*numbers, 0.1, 0.9, 0.1)


def folded(bank, numbers, evidence):
    """Return the joints of all cells after evidence for some numbers, and its log likelihood."""
    for outcome in evidence:
        bank._give_rows(outcome)
    joints, log_likelihood = bank._refold(numbers, evidence)
    return joints[bank._row], log_likelihood


@for_each(
    'seed, kind, method', [(s, k, m) for s in range(300) for k in KINDS for m in METHODS], every=12
)
def test_each_filter_is_that_of_the_one_pass_method(seed, kind, method):
    belief, model, outcomes = drawn(seed)
    prior = belief if method == 'kappa_bnitp' else belief.independent()
    bank = Filters(prior, model, TWO, 0, new_dynamics(kind))
    numbers = bank.numbers[:3]
    evidence = [Evidence.of(*outcome) for outcome in outcomes]
    joints, _ = folded(bank, numbers, evidence)
    for place, own in enumerate(numbers):
        estimator = Estimator(belief, particle_sensors(own), method, dynamics=new_dynamics(kind))
        for observation, robot_type in outcomes:
            estimator.assimilate(observation, robot_type)
        np.testing.assert_allclose(joints[..., place], estimator.belief.joint, rtol=0, atol=1e-12)


@for_each('seed, kind', [(seed, kind) for seed in range(300) for kind in KINDS], every=10)
def test_an_outcome_has_the_probability_of_all_states(seed, kind):
    belief, model, outcomes = drawn(seed, 1)
    bank = Filters(belief, model, TWO, 0, new_dynamics(kind))
    (observation, robot_type), numbers = outcomes[0], bank.numbers[:3]
    evidence = [Evidence.of(observation, robot_type)]
    _, log_chance = folded(bank, numbers, evidence)
    lost_at = observation.lost_at
    if lost_at is None:
        lost_at = np.arange(observation.steps) >= observation.steps_survived
    for place, own in enumerate(numbers):
        expected = hazards_in_time.chance(
            belief.joint,
            new_dynamics(kind),
            robot_type.model(particle_sensors(own)),
            observation.path.tolist(),
            observation.readings,
            lost_at,
        )
        assert np.exp(log_chance[place]) == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
@for_each('seed, kind', [(seed, kind) for seed in range(20) for kind in KINDS], every=16)
def test_a_belief_is_the_mixture_of_its_filters(monkeypatch, seed, kind):
    """Weighed by the product of the predictive probabilities of all outcomes."""
    belief, model, outcomes = drawn(seed, 3)
    bank = Filters(belief, model, TWO, 0, new_dynamics(kind))
    monkeypatch.setattr(Filters, '_resample', lambda *_: None)
    weights, joints = [], []
    for own in bank.numbers:
        estimator = Estimator(belief, particle_sensors(own), dynamics=new_dynamics(kind))
        weight = 1.0
        for number, (observation, robot_type) in enumerate(outcomes):
            before = estimator.belief.joint
            if number and kind == 'changing':
                before = joint_after_change(before, belief.hazard > 0.0, 0.02, 0.1)
            lost_at = observation.lost_at
            if lost_at is None:
                lost_at = np.arange(observation.steps) >= observation.steps_survived
            weight *= hazards_in_time.chance(
                before,
                new_dynamics(kind),
                robot_type.model(particle_sensors(own)),
                observation.path.tolist(),
                observation.readings,
                lost_at,
            )
            estimator.assimilate(observation, robot_type)
        weights.append(weight)
        joints.append(estimator.belief.joint)
    for outcome in outcomes:
        bank.take(Evidence.of(*outcome))
    expected = np.average(joints, axis=0, weights=weights)
    np.testing.assert_allclose(bank.joint()[0], expected, rtol=0, atol=1e-9)


def fly_mission(lethality, seed, robots=40, kind='static'):
    """Return the prior and outcomes of a mission with a correct prior, and its last field."""
    grid, rng = Grid(6, 6), np.random.default_rng(seed)
    prior = Belief.prior(grid, 0.15, 0.205, 0.8)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    mission = run_mission(
        grid,
        prior,
        SensorModel(lethality),
        world,
        robots,
        rng,
        options=SearchOptions('relaxed', 12),
        dynamics=Dynamics(kind),
    )
    return prior, [deployment.observation for deployment in mission], mission[-1].world


def learnt(prior, observations, unknowns, method='kappa_bnitp', kind='static', seed=0):
    estimator = Estimator(prior, SensorModel(0.5), method, unknowns, seed, dynamics=Dynamics(kind))
    for observation in observations:
        estimator.assimilate(observation)
    return estimator


@pytest.mark.slow
@for_each('lethality', [0.5, 0.1, 0.9], every=3)
def test_numbers_are_learnt_as_by_sampling(lethality):
    prior, observations, _ = fly_mission(lethality, 1)
    bank = learnt(prior, observations, TWO).parameters
    sampled = learnt(prior, observations, TWO, 'kappa_bnitp_sampled').parameters
    for name in ('lethality', 'malfunction'):
        assert bank[name].mean == pytest.approx(sampled[name].mean, abs=0.07)
        assert bank[name].sd == pytest.approx(sampled[name].sd, abs=0.05)


@pytest.mark.slow
def test_intervals_cover_numbers_drawn_from_the_prior():
    inside, missions = 0, 20 if FULL else 10
    for seed in range(missions):
        lethality = (seed + 0.5) / missions
        prior, observations, _ = fly_mission(lethality, seed)
        known = learnt(prior, observations, TWO, seed=seed).parameters['lethality']
        inside += known.quantile(0.05) <= lethality <= known.quantile(0.95)
    assert inside >= 0.75 * missions


def test_the_seed_and_the_evidence_make_the_belief():
    prior, observations, _ = fly_mission(0.5, 3, 20)
    beliefs = [
        learnt(prior, observations, SEVEN, seed=seed).belief.joint.tobytes() for seed in (1, 1, 2)
    ]
    assert beliefs[0] == beliefs[1] != beliefs[2]


def test_draws_are_of_particles():
    prior, observations, _ = fly_mission(0.5, 3, 20)
    estimator = learnt(prior, observations, TWO)
    assert not estimator.draws_are_exact
    hazardous, independent = estimator.draws(4000, np.random.default_rng(0))
    assert independent <= 4000
    np.testing.assert_allclose(hazardous.mean(axis=0), estimator.belief.hazard, atol=0.04)
    worlds = estimator.worlds(200, np.random.default_rng(0))
    mean = np.mean([model.lethality for _, model in worlds])
    assert mean == pytest.approx(estimator.parameters['lethality'].mean, abs=0.05)
    assert len({model.lethality for _, model in worlds}) > 20


def test_where_all_particles_die_more_are_drawn():
    """A certain hazard was survived thirty times, which hardly any particle allows."""
    belief = Belief.from_maps([0.0, 1.0], [0.5, 0.5], [0.5, 0.5])
    model = SensorModel(0.5, malfunction=0.0, false_negative=0.0)
    estimator = Estimator(belief, model, unknowns=Unknowns(lethality=(0.0, 1.0)))
    for _ in range(30):
        estimator.assimilate(Observation([0, 1, 0], True, [-1, -1]))
    assert estimator.parameters['lethality'].mean < 0.1


@for_each('unknowns, fewest', [(TWO, 40), (SEVEN, 128)])
def test_large_fields_have_fewer_particles_and_larger_ones_are_refused(
    monkeypatch, unknowns, fewest
):
    belief = Belief.prior(Grid(9, 9), 0.3, 0.3, 0.8)

    def particles(most):
        monkeypatch.setattr('kbnitp_ros.core.inference.particles.MAX_MEMORY', most)
        return len(Filters(belief, SensorModel(0.5), unknowns, 1, Dynamics()).numbers)

    of_each = 32 * belief.cells * COPIES
    assert particles(1 << 40) > particles(of_each * (fewest + 7)) == fewest + 7
    assert particles(of_each * fewest) == fewest
    with pytest.raises(ValueError, match='learning numbers on 81 cells takes about .* GB'):
        particles(of_each * fewest - 1)


@pytest.mark.parametrize('prior', [Beta(2000, 2000), Beta(2, 30), Beta(1, 1), Beta(40_000, 10)])
def test_first_particles_follow_the_density_of_the_prior(prior):
    """P(p <= x) of whole exponents is that of at least a successes in a + b - 1 trials."""
    unknowns = Unknowns(lethality=prior)
    bank = Filters(Belief([[[0.5, 0.2], [0.2, 0.1]]]), SensorModel(0.5), unknowns, 1, Dynamics())
    drawn, trials = np.sort(bank.numbers[:, 0]), int(prior.a + prior.b) - 1
    logs = np.concatenate([[0.0], np.log(np.arange(1, trials + 1)).cumsum()])
    k = np.arange(int(prior.a), trials + 1)
    ways = logs[trials] - logs[k] - logs[trials - k]
    below = [np.exp(ways + k * np.log(p) + (trials - k) * np.log1p(-p)).sum() for p in drawn]
    strata = (np.arange(drawn.size) + 0.5) / drawn.size
    np.testing.assert_allclose(below, strata, atol=0.51 / drawn.size)


def test_the_impossible_is_refused_and_changes_nothing():
    belief = Belief.from_maps([0.0, 0.0], [0.5, 0.5], [0.5, 0.5])
    model = SensorModel(0.5, malfunction=0.0)
    estimator = Estimator(belief, model, unknowns=Unknowns(lethality=(0.0, 1.0)))
    before = estimator.belief.joint.tobytes()
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(Observation([0, 1, 0], False))
    assert estimator.belief.joint.tobytes() == before


@for_each('seed, beyond', [(s, b) for s in range(12) for b in ('reach', 'duds')], every=4)
def test_cells_of_equal_priors_share_a_row(monkeypatch, seed, beyond):
    """They are filtered as if each had a row of its own from the start."""
    rng = np.random.default_rng([seed, 9])
    grid = Grid(5, 4)
    hazard = np.where(np.arange(20) % 3, 0.2, 0.1)
    prior = Belief.prior(grid, hazard if seed % 2 else 0.2, 0.3, 0.8)
    unknowns = Unknowns((0.0, 1.0), hazard_density=Beta(2, 6), **{beyond: Beta(low=0.0, high=0.6)})
    targets = Dynamics('learn') if beyond == 'reach' else Dynamics()
    arguments = prior, SensorModel(0.6, 0.01), unknowns, seed, Dynamics()
    shared = Filters(*arguments, count=64, targets=targets)
    classes = Filters._classes
    monkeypatch.setattr(Filters, '_classes', staticmethod(lambda field, _: classes(field, True)))
    apart = Filters(*arguments, count=64, targets=targets)
    assert len(shared._joints) < len(apart._joints) == grid.cells
    for _ in range(8):
        path = brute_force.random_path(rng, 5, 4, 0, 6)
        is_back = rng.random() < 0.7
        outcome = Observation(path, is_back, rng.integers(-1, 2, 6) if is_back else None)
        finding = Finding(rng.choice(np.arange(1, 20), 2, replace=False), hazard=False)
        for evidence in (Evidence.of(outcome), finding):
            predicted = shared.take(evidence), apart.take(evidence)
            np.testing.assert_allclose(*predicted, rtol=0, atol=1e-9)
        for name in ('numbers', 'weights'):
            np.testing.assert_allclose(getattr(shared, name), getattr(apart, name), atol=1e-9)
        for ours, theirs in zip(shared.joint(), apart.joint()):
            if ours is not None:
                np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
        np.testing.assert_allclose(shared.hazard(), apart.hazard(), rtol=0, atol=1e-9)
        assert shared.sampling_error() == pytest.approx(apart.sampling_error(), abs=1e-9)
