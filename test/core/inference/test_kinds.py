# SPDX-License-Identifier: Apache-2.0
"""Unknown rates, kinds of hazard as hypotheses, and the check of the model."""

from functools import cache
from itertools import product

import brute_force
import hazards_in_time
from kbnitp_ros.core import (
    Belief,
    Beta,
    Clustering,
    Dynamics,
    Estimator,
    Grid,
    Learning,
    Observation,
    ORDINARY,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    World,
)
from kbnitp_ros.core.inference.filter import Evidence
from kbnitp_ros.core.inference.model_check import ModelCheck
from kbnitp_ros.core.inference.particles import Filters
from laws import for_each
import numpy as np
import pytest

GRID, MODEL = Grid(3, 2), SensorModel(0.5, 0.1, 0.1, 0.9, 0.1)
PRIOR = Belief.prior(GRID, 0.3, 0.4, 0.7)
PRIORS = {'static': 1 / 2, 'used_up': 1 / 3, 'changing': 1 / 12, 'moving': 1 / 12}
LETHALITY = Unknowns(lethality=(0.0, 1.0))
UNKNOWN = {
    'changing': Dynamics('changing', vanish=(0.01, 0.3)),
    'moving': Dynamics('moving', move=(0.01, 0.3)),
}


def outcomes(seed, count=4):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        path = brute_force.random_path(rng, 3, 2, 0, int(rng.integers(1, 8)))
        if rng.random() < 0.5:
            yield Observation(path, True, rng.integers(-1, 2, len(path) - 1))
        else:
            yield Observation(path, False)


def after(observations, **kwargs):
    estimator = Estimator(PRIOR, MODEL, **kwargs)
    for observation in observations:
        estimator.assimilate(observation)
    return estimator


@for_each('seed, kind', [(seed, kind) for seed in range(20) for kind in UNKNOWN], every=10)
def test_each_rate_has_the_filter_of_that_rate(seed, kind):
    bank = Filters(PRIOR, MODEL, Unknowns(), 0, UNKNOWN[kind])
    rates = bank.numbers[:3]
    evidence = [Evidence.of(each, ORDINARY) for each in outcomes(seed)]
    # Hazards change between deployments: each cell has a row of its own.
    joints, _ = bank._refold(rates, evidence)
    for place, rate in enumerate(rates[:, 0]):
        true = {'move': rate}
        if kind == 'changing':
            density = PRIOR.hazard[PRIOR.hazard > 0.0].mean()
            true = {'appear': rate * density / (1.0 - density), 'vanish': rate}
        told = after(outcomes(seed), dynamics=Dynamics(kind, **true)).belief.joint
        np.testing.assert_allclose(joints[..., place], told, atol=1e-12)


def test_a_rate_is_log_uniform_unless_it_is_known():
    known = after([], dynamics=Dynamics('changing', vanish=(0.001, 0.1))).parameters['vanish']
    assert known.quantile(0.5) == pytest.approx(0.01, rel=0.05)
    assert Dynamics('learn').move == Beta(0.0, 1.0, 0.001, 0.1) == Dynamics('learn').vanish


@for_each('seed', range(20), every=5)
def test_kinds_are_weighed_by_the_probability_of_all_evidence(seed):
    """With known rates, the evidence is the product of the predictive probabilities."""
    dynamics = Dynamics('learn', 0.01, 0.1, 0.05)
    observations = list(outcomes(seed, 3))
    evidence, joints = {}, {}
    for hypothesis in dynamics.kinds:
        bank = Filters(PRIOR, MODEL, Unknowns(), 0, hypothesis)
        for observation in observations:
            bank.take(Evidence.of(observation, ORDINARY))
        evidence[hypothesis.kind] = PRIORS[hypothesis.kind] * np.exp(bank.log_evidence)
        joints[hypothesis.kind] = bank.joint()[0]
    total = sum(evidence.values())
    estimator = after(observations, dynamics=dynamics)
    for kind, probability in estimator.kinds.items():
        assert probability == pytest.approx(evidence[kind] / total, abs=1e-12)
    mixture = sum(evidence[kind] * joints[kind] for kind in joints) / total
    np.testing.assert_allclose(estimator.belief.joint, mixture, atol=1e-12)


@for_each(
    'unknowns, dynamics',
    [
        (unknowns, dynamics)
        for unknowns in (Unknowns(), LETHALITY)
        for dynamics in (Dynamics(), Dynamics('used_up'), UNKNOWN['moving'], Dynamics('learn'))
    ],
)
def test_the_ratio_of_each_alternative_is_fair(unknowns, dynamics):
    """The belief expects each ratio to stay the same, over all outcomes of a deployment."""
    path, (first, *_) = [0, 1, 4, 1, 0], outcomes(3, 1)
    estimator = after([first], unknowns=unknowns, dynamics=dynamics)
    before, expected, total = estimator.model_check.alternatives, {}, 0.0
    possible = [Observation(path, False)]
    possible += [Observation(path, True, each) for each in product((0, 1), repeat=4)]
    for observation in possible:
        other = estimator.copy()
        other.assimilate(observation)
        chance = predicted(other)
        if dynamics == Dynamics() and not unknowns.priors:
            by_states = hazards_in_time.chance(
                estimator.belief.joint, dynamics, MODEL, path, observation.readings, np.ones(4)
            )
            assert chance == pytest.approx(by_states, abs=1e-12)
        total += chance
        for name, ratio in other.model_check.alternatives.items():
            expected[name] = expected.get(name, 0.0) + chance * ratio
    assert total == pytest.approx(1.0, abs=1e-9)
    for name, ratio in before.items():
        assert expected[name] == pytest.approx(ratio, rel=1e-9), name


def predicted(estimator):
    inference = estimator._inference
    if not hasattr(inference, 'predicted'):
        assert estimator.model_check.alternatives
        inference = estimator._checker._own
    return np.exp(inference.predicted[-1][0])


@cache
def mission(true):
    grid = Grid(9, 9)
    prior, rng = Belief.prior(grid, 0.15, 0.205, 0.8), np.random.default_rng(1)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    options = SearchOptions('relaxed')
    flown = run_mission(
        grid, prior, SensorModel(0.5), world, 70, rng, options=options, dynamics=true
    )
    return prior, [deployment.observation for deployment in flown]


def flown(believed, true):
    prior, observations = mission(true)
    estimator = Estimator(prior, SensorModel(0.5), dynamics=believed)
    for observation in observations:
        estimator.assimilate(observation)
    return estimator


@pytest.mark.slow
def test_the_evidence_identifies_kinds_and_the_check_detects_a_wrong_one():
    used_up = Dynamics('used_up')
    found = flown(Dynamics('learn'), used_up)
    assert max(found.kinds, key=found.kinds.get) == 'used_up'
    assert found.probable_dynamics == used_up
    assert not found.model_check.is_in_doubt
    check = flown(Dynamics(), used_up).model_check
    assert check.is_in_doubt
    assert 'fits hazards that are used up' in check.reason
    assert 'than static hazards' in check.reason
    assert check.alternatives['used_up'] > 20.0 > check.alternatives['malfunction']
    right = flown(Dynamics(), Dynamics()).model_check
    assert not right.is_in_doubt
    assert 'no reason for doubt' in right.reason


@pytest.mark.slow
@for_each('true, dynamics, best', [
    (SensorModel(0.9, 0.001, reach=0.4), Dynamics(), 'reach'),
    (SensorModel(0.9, 0.001), Dynamics('moving', move=0.05), 'changing_targets'),
    (SensorModel(0.9, 0.001, 0.05, 0.7, 0.3), Dynamics(), 'detector'),
])  # fmt: skip
def test_the_check_tells_reach_moving_targets_and_a_poor_detector_apart(true, dynamics, best):
    grid = Grid(9, 9)
    prior = Belief.prior(grid, 0.15, 0.205, 0.8)
    mission = run_mission(
        grid,
        prior,
        SensorModel(0.5, 0.001),
        World.random(grid, 2, 0.15, 0.8, 0.1),
        60,
        2,
        options=SearchOptions('relaxed'),
        truth=Truth(true, target_dynamics=dynamics),
        learning=Learning(Unknowns(lethality=(0.0, 1.0), hazard_density=Beta(1.5, 5.0))),
    )
    check = mission.estimator.model_check
    assert check.is_in_doubt
    assert max(check.alternatives, key=check.alternatives.get) == best
    assert 'better than' in check.reason
    assert len(check.rivals) == 2
    assert f' with {check.rivals[best]:.2f}' in check.reason


def test_a_check_does_not_depend_on_earlier_checks():
    observations = list(outcomes(5, 6))
    late, often = after(observations), Estimator(PRIOR, MODEL)
    for observation in observations:
        often.assimilate(observation)
        often = often.copy()
        assert often.model_check.alternatives
    assert often.model_check == late.model_check


def test_the_sampled_method_is_checked_by_the_predictions_of_independent_cells():
    observations, sampled = list(outcomes(5, 4)), {'method': 'kappa_bnitp_sampled'}
    expected = after(observations).model_check
    assert after(observations, **sampled).model_check == expected
    # A learnt lethality is no alternative to itself.
    learning = after(observations, **sampled, unknowns=LETHALITY).model_check
    assert expected.alternatives.keys() - learning.alternatives.keys() == {'lethality'}
    assert 'can miss duds (found in 18 % of missions) and a wrong lethality' in expected.reason
    assert learning.reason.endswith('can miss duds (found in 18 % of missions)')
    clustered = after(observations, **sampled, clustering=Clustering(GRID, 0.5)).model_check
    assert (clustered.is_in_doubt, dict(clustered.alternatives)) == (False, {})
    assert 'with clustered hazards has no model check' in clustered.reason


@for_each('ratios, rivals', [
    ({'used_up': 6.0, 'reach': 5.0, 'malfunction': 1.0}, {'used_up': 1.0}),
    ({'used_up': 2.0, 'reach': 6.0, 'malfunction': 2.0}, {'reach': 0.75, 'malfunction': 0.25}),
    ({'reach': np.inf, 'malfunction': 2.0}, {'reach': 1.0, 'malfunction': 0.0}),
    ({'detector': 3.0, 'changing_targets': 1.0}, {'detector': 0.75, 'changing_targets': 0.25}),
    ({'duds': 1.0, 'target_background': 4.0}, {'duds': 0.2, 'target_background': 0.8}),
    ({'malfunction': 1.0}, {'malfunction': 1.0}),
    ({}, {}),
])  # fmt: skip
def test_what_looks_like_the_best_alternative_is_weighed_against_it(ratios, rivals):
    assert ModelCheck(False, ratios, '').rivals == rivals


@for_each('unknowns, targets, without', [
    (Unknowns(), Dynamics(), set()),
    (Unknowns(duds=(0.0, 1.0)), Dynamics(), {'duds'}),
    (Unknowns(kappa=(0.1, 0.9), target_background=(0.1, 0.9)), Dynamics(), {'target_background'}),
    (Unknowns(), Dynamics('changing', 0.1, 0.1), {'duds', 'changing_targets'}),
])  # fmt: skip
def test_what_is_believed_is_no_alternative(unknowns, targets, without):
    asked = {'duds', 'target_background', 'reach', 'malfunction', 'detector', 'changing_targets'}
    estimator = after([], unknowns=unknowns, target_dynamics=targets)
    assert asked - estimator.model_check.alternatives.keys() == without
    # Without kappa, nothing tells duds.
    others = after([], method='relaxed_itp').model_check.alternatives
    assert asked - others.keys() == {'duds', 'target_background'}


def test_a_kind_that_the_evidence_rules_out_has_no_weight():
    """A robot without malfunctions was lost three times on a path with at most one hazard."""
    belief = Belief.from_maps([0.0, 0.5], [0.5, 0.5], [0.5, 0.5]).on(Grid(2, 1))
    model = SensorModel(0.9, malfunction=0.0)
    estimator = Estimator(belief, model, dynamics=Dynamics('learn'))
    for _ in range(3):
        estimator.assimilate(Observation([0, 1, 0], False))
    assert estimator.kinds['used_up'] == 0.0
    assert estimator.belief.hazard[1] > 0.9
    assert set(estimator.parameters) == {'vanish', 'move'}
    before = estimator.belief.joint.tobytes()
    with pytest.raises(ValueError, match='impossible'):
        estimator.assimilate(Observation([0, 0], False))
    assert estimator.belief.joint.tobytes() == before


@pytest.mark.filterwarnings('error')
@pytest.mark.slow
def test_hundreds_of_robots_rule_a_kind_out_without_a_warning():
    """The weight of hazards that are used up underflows to 0."""
    estimator = Estimator(PRIOR, SensorModel(0.9, malfunction=0.001), dynamics=Dynamics('learn'))
    for number in range(700):
        path = [0, 1, 0]
        back = Observation(path, True, [False, False])
        estimator.assimilate(back if number % 2 else Observation(path, False))
    assert estimator.kinds['used_up'] == 0.0
    assert sum(estimator.kinds.values()) == pytest.approx(1.0)
    assert estimator.model_check.reason
    assert estimator.draws(10, np.random.default_rng(0))[0].shape == (10, 6)
