# SPDX-License-Identifier: Apache-2.0
"""Value of a path: information or behavioral entropies over all states and outcomes."""

from functools import cache
from itertools import product

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
from kbnitp_ros.core.planning.objective import (
    behavioral_entropy,
)
from kbnitp_ros.core.planning.options import ALPHAS as RANGE
from laws import for_each
import numpy as np
import pytest
from rounds import plan_round


def random_case(seed):
    joint, sensors, path = brute_force.random_case(np.random.default_rng(seed), 5, 7)
    return joint, SensorModel(**sensors), path


@for_each('seed', range(400), every=4)
def test_path_information_is_the_joint_information(seed):
    joint, model, path = random_case(seed)
    expected = brute_force.joint_information(joint, [model], [path])
    assert path_information(Belief(joint), model, path) == pytest.approx(expected, rel=0, abs=1e-9)


LOW, HIGH = RANGE
ALPHAS = (LOW, 0.5, 0.8, 1.25, 2.0, HIGH)
SEEKING = ('beam', 'relaxed')
# Minimum share of the best of all paths that a search finds.
SHARES = {'beam': 0.9, 'relaxed': 0.5}


def case_of_alpha(seed):
    joint, sensors, path = brute_force.random_case(np.random.default_rng(seed), 4, 5)
    return joint, SensorModel(**sensors), path


@for_each('alpha, seed', product(ALPHAS, range(200 if FULL else 25)))
def test_the_value_is_the_expected_fall_of_the_entropies(seed, alpha):
    joint, model, path = case_of_alpha(seed)
    expected = brute_force.behavioral_information(joint, model, path, alpha)
    found = path_information(Belief(joint), model, path, alpha)
    assert found == pytest.approx(expected, rel=0, abs=1e-9)


@for_each('seed', range(100))
def test_at_alpha_1_it_is_the_information(seed):
    joint, model, path = case_of_alpha(seed)
    belief = Belief(joint)
    information = path_information(belief, model, path)
    for alpha in (1.0, 1.0 - 1e-9, 1.0 + 1e-9):
        found = path_information(belief, model, path, alpha)
        assert found == pytest.approx(information, rel=0, abs=1e-7 if alpha != 1.0 else 1e-12)


@for_each('alpha', ALPHAS)
def test_the_entropy_is_concave_up_to_alpha_1_only(alpha):
    curvature = np.diff(behavioral_entropy(np.linspace(0.0, 1.0, 2001), alpha), 2)
    assert (curvature < 0.0).all() == (alpha <= 1.0)


@given(st.integers(0, 10**6), st.floats(LOW, 1.0))
@settings(max_examples=1000 if FULL else 100, deadline=None)
def test_up_to_alpha_1_it_is_never_negative(seed, alpha):
    joint, model, path = case_of_alpha(seed)
    assert path_information(Belief(joint), model, path, alpha) > -1e-9


@cache
def every_path():
    visits = brute_force.all_visit_counts(3, 3, 0, 6)
    return [np.append(0, np.repeat(np.arange(9), each)[::-1]) for each in visits]


@cache
def best_of_all(seed, alpha):
    rng = np.random.default_rng(seed)
    belief = Belief(brute_force.random_joint(rng, 9, 0))
    model = SensorModel(float(rng.choice([0.1, 0.5, 0.9])))
    paths = every_path()
    return belief, model, max(path_information(belief, model, p, alpha) for p in paths)


@pytest.mark.slow
@for_each('alpha, planner', product(ALPHAS, SHARES))
def test_the_search_comes_close_to_the_best_of_all_paths(alpha, planner, record_property):
    options = SearchOptions(planner, 6, objective='behavioral', alpha=alpha, max_visits=6)
    least = 1.0
    for seed in range(20 if FULL else 1):
        belief, model, best = best_of_all(seed, alpha)
        found = plan(Grid(3, 3), belief, model, options)
        worth = path_information(belief, model, found.path, alpha)
        assert worth <= best + 1e-9
        least = min(least, worth / best)
    record_property('least', least)
    assert least >= SHARES[planner]


def random_problem(seed):
    rng = np.random.default_rng(seed)
    belief = Belief(brute_force.random_joint(rng, 25, 0))
    return Grid(5, 5), belief, SensorModel(**brute_force.random_sensors(rng))


@pytest.mark.slow
@for_each('planner, agents, seed', product(SEEKING, [1, 2], range(20)))
def test_at_alpha_1_plans_are_the_very_same(planner, agents, seed):
    problem = *random_problem(seed), 10, agents, 'greedy', planner
    usual, behavioral_one = (
        [(planned.path.tolist(), planned.information, planned.survival) for planned in team]
        for team in (plan_round(*problem), plan_round(*problem, objective='behavioral', alpha=1.0))
    )
    assert usual == behavioral_one
