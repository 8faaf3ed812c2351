# SPDX-License-Identifier: Apache-2.0
"""Every method, planner and allocation keeps its laws on any belief."""

from math import log

import brute_force
from extent import FULL
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import (
    ALLOCATIONS,
    Belief,
    Estimator,
    METHODS,
    Observation,
    path_information,
    PLANNERS,
    SensorModel,
    update,
)
from kbnitp_ros.testing import check_allocation, check_method, check_planner
from laws import for_each
import numpy as np
import pytest


@pytest.mark.slow
@for_each('method', METHODS)
def test_methods_keep_their_laws(method):
    check_method(method, cases=40 if FULL else 2)


@pytest.mark.slow
@for_each('planner', [*PLANNERS])
def test_planners_keep_their_laws(planner):
    check_planner(planner, cases=500 if FULL else 15)


@pytest.mark.slow
@for_each('allocation', ALLOCATIONS)
def test_allocations_keep_their_laws(allocation):
    check_allocation(allocation, cases=250 if FULL else 10)


# Laws of every belief, model and path.


CELLS = 6
thorough = settings(max_examples=100 if FULL else 30, deadline=None, derandomize=True)

probability = st.one_of(st.sampled_from([0.0, 1.0, 0.5]), st.floats(1e-6, 1 - 1e-6))
per_cell = st.lists(probability, min_size=CELLS, max_size=CELLS)


@st.composite
def beliefs(draw):
    """Draw any joint per cell, also certain ones, from hazard, P(X=1|Z=0) and kappa."""
    hazard, q, kappa = (np.array(draw(per_cell)) for _ in range(3))
    hazard[0] = 0.0
    return Belief(
        np.stack(
            [
                np.stack([(1 - hazard) * (1 - q), (1 - hazard) * q], axis=-1),
                np.stack([hazard * (1 - kappa), hazard * kappa], axis=-1),
            ],
            axis=1,
        )
    )


rate = st.one_of(st.just(0.0), st.floats(1e-6, 0.5))
models = st.builds(
    SensorModel,
    lethality=st.floats(0.01, 1),
    malfunction=rate,
    false_negative=rate,
    true_positive=rate.map(lambda miss: 1 - miss),
    false_positive=rate,
)

paths = st.lists(st.integers(0, CELLS - 1), max_size=10).map(lambda inner: [0, *inner, 0])


@st.composite
def observations(draw):
    path = draw(paths)
    if draw(st.booleans()):
        return Observation(path, False)
    steps = len(path) - 1
    return Observation(path, True, draw(st.lists(st.booleans(), min_size=steps, max_size=steps)))


@pytest.mark.parametrize('method', METHODS)
@thorough
@given(belief=beliefs(), model=models, observation=observations())
def test_every_update_leaves_a_distribution_per_cell(method, belief, model, observation):
    estimator = Estimator(belief, model, method)
    try:
        estimator.assimilate(observation)
    except ValueError as refusal:
        if 'impossible' not in str(refusal):
            raise
        assume(False)
    after = estimator.belief
    for probabilities in (after.joint, after.hazard, after.target, after.kappa):
        assert ((probabilities >= 0) & (probabilities <= 1)).all()
    np.testing.assert_allclose(after.joint.sum(axis=(1, 2)), 1, rtol=0, atol=1e-12)
    assert after.entropy() >= 0
    assert after.joint_entropy() >= 0


@thorough
@given(beliefs(), models, observations())
def test_only_impossible_evidence_is_refused(belief, model, observation):
    probability = brute_force.evidence_probability(
        belief.joint, model, observation.path.tolist(), observation.readings
    )
    assume(probability == 0 or probability > 1e-250)
    try:
        update(belief, model, observation)
    except ValueError:
        assert probability == 0
    else:
        assert probability > 0


@thorough
@given(beliefs(), models, paths)
def test_information_is_bounded(belief, model, path):
    information = path_information(belief, model, path)
    steps = len(path) - 1
    assert information >= -1e-12
    assert information <= log(2) * (1 + steps) + 1e-12  # bits of the fate and the readings
    assert information <= belief.joint_entropy() + 1e-9  # total entropy


@thorough
@given(beliefs(), models, paths)
def test_information_is_the_expected_fall_of_uncertainty_at_one_cell(belief, model, path):
    """With one uncertain cell nothing is correlated: entropies add up exactly."""
    joint = belief.joint.copy()
    joint[2:] = [[1, 0], [0, 0]]
    joint[0] = [[1, 0], [0, 0]]
    path = [min(cell, 1) for cell in path[:6]] + [0]
    before, after = Belief(joint), 0.0
    steps = len(path) - 1
    outcomes = [None] + [[bool(bits >> k & 1) for k in range(steps)] for bits in range(2**steps)]
    for readings in outcomes:
        weight = brute_force.evidence_probability(joint, model, path, readings)
        if weight > 1e-12:
            outcome = Observation(path, readings is not None, readings)
            after += weight * update(before, model, outcome).joint_entropy()
    fall = before.joint_entropy() - after
    assert path_information(before, model, path) == pytest.approx(fall, abs=1e-7)
