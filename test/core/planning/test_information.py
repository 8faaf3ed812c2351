# SPDX-License-Identifier: Apache-2.0
"""Information of a path over all states and outcomes."""

from functools import cache

import brute_force
from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import (
    Belief,
    Grid,
    path_information,
    plan,
    SearchOptions,
    SensorModel,
)
from laws import for_each
import numpy as np
import pytest


def random_case(seed):
    joint, sensors, path = brute_force.random_case(np.random.default_rng(seed), 5, 7)
    return joint, SensorModel(**sensors), path


@for_each('seed', range(400), every=4)
def test_path_information_is_the_joint_information(seed):
    joint, model, path = random_case(seed)
    expected = brute_force.joint_information(joint, [model], [path])
    assert path_information(Belief(joint), model, path) == pytest.approx(expected, rel=0, abs=1e-9)


@given(st.integers(0, 10**6))
@settings(max_examples=1000 if FULL else 100, deadline=None)
def test_it_is_never_negative(seed):
    joint, model, path = random_case(seed)
    assert path_information(Belief(joint), model, path) > -1e-9


# Minimum share of the best of all paths that a search finds.
SHARES = {'beam': 0.9, 'relaxed': 0.5}


@cache
def every_path():
    visits = brute_force.all_visit_counts(3, 3, 0, 6)
    return [np.append(0, np.repeat(np.arange(9), each)[::-1]) for each in visits]


@cache
def best_of_all(seed):
    rng = np.random.default_rng(seed)
    belief = Belief(brute_force.random_joint(rng, 9, 0))
    model = SensorModel(float(rng.choice([0.1, 0.5, 0.9])))
    return belief, model, path_information(belief, model, every_path()).max()


@pytest.mark.slow
@for_each('planner', SHARES)
def test_the_search_comes_close_to_the_best_of_all_paths(planner, record_property):
    least = 1.0
    for seed in range(20 if FULL else 5):
        belief, model, best = best_of_all(seed)
        found = plan(Grid(3, 3), belief, model, SearchOptions(planner, 6, max_visits=6))
        worth = path_information(belief, model, found.path)
        assert worth <= best + 1e-9
        least = min(least, float(worth / best))
    record_property('least', least)
    assert least >= SHARES[planner]
