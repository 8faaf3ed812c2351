# SPDX-License-Identifier: Apache-2.0
"""What comes back, or does not, from one deployment."""

from kbnitp_ros.core import Observation
from laws import for_each
import numpy as np
import pytest


def test_a_returned_robot_brings_a_reading_for_each_step():
    observation = Observation([0, 1, 1, 0], True, [True, False, False])
    assert observation.path.tolist() == [0, 1, 1, 0]
    assert observation.survived is True
    assert observation.readings.tolist() == [True, False, False]
    as_numbers = Observation([0, 1, 1, 0], True, np.array([1, 0, 0]))
    assert observation.readings.dtype == as_numbers.readings.dtype == bool


def test_a_lost_robot_brings_none():
    observation = Observation(np.array([0, 1, 0]), False)
    assert observation.readings is None
    assert observation.survived is False


@for_each('path, survived, readings, message', [
    ([0, 1, 0], True, None, 'readings.*missing.*each step'),
    ([0, 1, 0], True, [True], r'readings.*\(1,\).*2'),
    ([0, 1, 0], True, [True] * 3, r'readings.*\(3,\).*2'),
    ([0, 1, 0], True, [], r'readings.*\(0,\).*2'),
    ([0, 1, 0], True, [[True, False]], r'readings.*\(1, 2\).*2'),
    ([0, 1, 0], True, [0.5, 1.0], r'readings.*0\.5.*True or False'),
    ([0, 1, 0], True, [2, 0], 'readings.*2.*True or False'),
    ([0, 1, 0], True, [float('nan'), 0.0], 'readings.*nan.*True or False'),
    ([0, 1, 0], False, [True, False], 'readings.*lost.*none'),
    ([0, 1, 0], False, [], 'readings.*lost.*none'),
    ([], False, None, 'path.*at least two'),
    ([0], False, None, 'path.*at least two'),
    ([[0, 1, 0]], False, None, 'path'),
    ([0, 1.5, 0], False, None, 'path.*whole numbers'),
    ([0, -1, 0], False, None, 'path.*-1.*from 0'),
    ([0, 1, 2], False, None, 'path.*0.*2.*base'),
])  # fmt: skip
def test_bad_observations_are_refused(path, survived, readings, message):
    with pytest.raises(ValueError, match=message):
        Observation(path, survived, readings)


@for_each('survived', [2, -1, 0.5, float('nan'), 'yes', None])
def test_survived_is_a_yes_or_no(survived):
    with pytest.raises(ValueError, match='survived'):
        Observation([0, 1, 0], survived, None)


def test_observations_cannot_be_changed():
    path, readings = np.array([0, 1, 0]), np.array([True, False])
    observation = Observation(path, True, readings)
    with pytest.raises(AttributeError):
        observation.survived = False
    for array in (observation.path, observation.readings):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = 1
    path[1], readings[0] = 2, False
    assert observation.path.tolist() == [0, 1, 0]
    assert observation.readings.tolist() == [True, False]
