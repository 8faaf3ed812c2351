# SPDX-License-Identifier: Apache-2.0
"""Every method, planner and allocation keeps its laws on any belief."""

import brute_force
from extent import FULL
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import (
    ALLOCATIONS,
    Belief,
    METHODS,
    Observation,
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


CELLS = 6
thorough = settings(max_examples=100 if FULL else 30, deadline=None, derandomize=True)

probability = st.one_of(st.sampled_from([0.0, 1.0, 0.5]), st.floats(1e-6, 1 - 1e-6))
per_cell = st.lists(probability, min_size=CELLS, max_size=CELLS)


@st.composite
def beliefs(draw):
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
