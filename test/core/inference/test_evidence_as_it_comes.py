# SPDX-License-Identifier: Apache-2.0
"""Last contacts and missing readings are taken in exactly."""

import brute_force
from kbnitp_ros.core import Belief, Observation, SensorModel, update
from laws import for_each
import numpy as np
import pytest

# When a last contact is all that was told


THREE = Belief.from_maps([0.0, 0.3, 0.3, 0.3], [0.5] * 4, [0.5] * 4).joint
DEADLY, THROUGH = SensorModel(0.9), [0, 1, 2, 3, 0]
STEPS = len(THROUGH) - 1


def losses_by_step():
    """Return the prior of all states of the cells, and P(lost in each step | state)."""
    cells, states, prior = brute_force.enumerate_states(THREE, THROUGH[1:])
    lost_after = np.array(
        [brute_force.fates(DEADLY, cells, states, THROUGH, j)[0] for j in range(STEPS + 1)]
    )
    return prior, lost_after[:-1] - lost_after[1:]


def last_heard(contact):
    """Return g(j | i), by j and i: each step survived is heard with the chance `contact`."""
    since = np.arange(STEPS) - np.arange(STEPS)[:, None]
    chance = np.where(since >= 0, contact * (1 - contact) ** np.maximum(since, 0), 0.0)
    chance[0] = (1 - contact) ** np.arange(STEPS)
    assert chance.sum(axis=0) == pytest.approx(1.0)
    return chance


@for_each('heard, is_all', [
    (np.triu(np.tile([[0.1], [0.5], [0.3], [0.9]], STEPS)), True),
    (last_heard(0.0), True),
    (last_heard(0.2), False),
    (last_heard(1.0), False),
])  # fmt: skip
def test_the_likelihood_is_all_that_is_told_if_hearing_does_not_depend_on_the_loss(heard, is_all):
    _, by_step = losses_by_step()
    taken = np.cumsum(by_step[::-1], axis=0)[::-1]
    ratio = (heard @ by_step / taken)[heard.any(axis=1)]
    in_proportion = np.isclose(ratio, ratio[:, :1]).all(axis=1)
    # In the last step there is no later one to tell it from.
    assert in_proportion[:-1].all() == is_all
    assert in_proportion[-1]


def test_beliefs_in_each_contact_blame_late_steps_too_much():
    """Averaged over what may be heard, they are not what is believed of a loss alone."""
    prior, by_step = losses_by_step()
    chance = last_heard(1.0) @ by_step @ prior
    beliefs = [
        update(Belief(THREE), DEADLY, Observation(THROUGH, False, None, j)).hazard
        for j in range(STEPS)
    ]
    average = (chance[:, None] * beliefs).sum(axis=0) / chance.sum()
    alone = update(Belief(THREE), DEADLY, Observation(THROUGH, False)).hazard
    assert average[1] < alone[1] - 0.05
    assert average[3] > alone[3] + 0.05


def test_nothing_known_is_nothing_changed():
    joint, sensors, path = brute_force.random_case(np.random.default_rng(1), 5, 7)
    model = SensorModel(**sensors)
    plain = update(Belief(joint), model, Observation(path, False)).joint
    told = update(Belief(joint), model, Observation(path, False, None, 0)).joint
    assert plain.tobytes() == told.tobytes()
    readings = [True, False] * len(path)
    looked = Observation(path, True, readings[: len(path) - 1])
    as_numbers = Observation(path, True, np.array(readings[: len(path) - 1], dtype=int))
    assert looked.readings.dtype == as_numbers.readings.dtype == bool


@for_each('arguments, message', [
    ({'survived': False, 'steps_survived': 3}, 'steps_survived is 3.*at most 2'),
    ({'survived': False, 'steps_survived': -1}, 'steps_survived is -1.*at least 0'),
    ({'survived': False, 'steps_survived': 1.5}, 'steps_survived is 1.5'),
    ({'readings': [1, 0, 1], 'steps_survived': 1}, 'steps_survived is 1.*returned'),
    ({'readings': [1, 0, -2]}, 'readings is -2'),
    ({'readings': [-1, 0, 2]}, 'readings is 2'),
    ({'readings': [-1, 0]}, 'readings has shape'),
    ({'readings': [-1, 0, float('nan')]}, 'readings is nan'),
])  # fmt: skip
def test_what_cannot_be_known_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Observation(**{'path': [0, 1, 2, 0], 'survived': True, **arguments})
