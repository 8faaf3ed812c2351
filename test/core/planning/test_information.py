# SPDX-License-Identifier: Apache-2.0
"""The expected information of a path, against the sum over every state and every outcome."""

from math import log

import brute_force
from kbnitp_ros.core import Belief, path_information, SensorModel
from laws import for_each
import numpy as np
import pytest


def random_case(seed):
    joint, sensors, path = brute_force.random_case(np.random.default_rng(seed), 5, 7)
    return joint, SensorModel(**sensors), path


@for_each('seed', range(400))
def test_path_information_is_the_joint_information(seed):
    joint, model, path = random_case(seed)
    expected = brute_force.information(joint, model, path)
    assert path_information(Belief(joint), model, path) == pytest.approx(expected, rel=0, abs=1e-9)


def test_the_cases_cover_what_they_claim():
    paths = [random_case(seed)[2] for seed in range(400)]
    assert sum(len(set(path[1:])) < len(path) - 1 for path in paths) > 100
    assert sum((np.diff(path) == 0).any() for path in paths) > 100
    assert sum(len(set(path)) >= 4 for path in paths) > 50
    assert sum(len(path) == 8 for path in paths) > 20


@for_each('seed', range(50))
def test_the_count_of_exposures_tells_all_there_is(seed):
    """The fast search used in the planning tests is right too."""
    joint, model, path = random_case(seed)
    visits = np.bincount(path[1:], minlength=len(joint))[None]
    fast = brute_force.information_of_visits(joint, model, visits)[0]
    assert fast == pytest.approx(brute_force.information(joint, model, path), abs=1e-12)


def test_even_odds_and_a_perfect_robot_by_hand():
    """A perfect sensor of a certain return tells the target; a deadly hazard tells itself."""
    belief = Belief.from_maps([0.0, 0.0, 0.5], [0.0, 0.5, 0.5], [0.0, 0.5, 0.5])
    model = SensorModel(1.0, malfunction=0, false_negative=0, true_positive=1, false_positive=0)
    assert path_information(belief, model, [0, 1, 0]) == pytest.approx(log(2))
    assert path_information(belief, model, [0, 2, 0]) == pytest.approx(log(2) + 0.5 * log(2))


def test_nothing_to_learn():
    certain = Belief.from_maps([0.0, 1.0], [1.0, 0.0], [1.0, 0.0])
    assert path_information(certain, SensorModel(0.5), [0, 1, 1, 0]) == pytest.approx(0, abs=1e-12)
    useless = SensorModel(0.0, true_positive=0.3, false_positive=0.3)
    unsure = Belief.from_maps([0.0, 0.5], [0.5, 0.5], [0.5, 0.5])
    assert path_information(unsure, useless, [0, 1, 1, 0]) == pytest.approx(0, abs=1e-12)


@for_each('seed', range(20))
def test_order_of_the_cells_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    belief = Belief(brute_force.random_joint(rng, 5, 0))
    model = SensorModel(**brute_force.random_sensors(rng))
    inner = rng.integers(1, 5, 6)
    one, other = ([0, *rng.permutation(inner), 0] for _ in range(2))
    assert path_information(belief, model, one) == pytest.approx(
        path_information(belief, model, other), abs=1e-12
    )


@for_each('path, message', [
    ([], 'path.*at least two'),
    ([0], 'path.*at least two'),
    ([0, 5, 0], 'path.*5.*0 to 1'),
    ([0, -1, 0], 'path.*-1.*'),
    ([0, 0.5, 0], 'path.*whole numbers'),
])  # fmt: skip
def test_bad_paths_are_refused(path, message):
    belief = Belief.from_maps([0.0, 0.5], [0.5, 0.5], [0.5, 0.5])
    with pytest.raises(ValueError, match=message):
        path_information(belief, SensorModel(0.5), path)
