# SPDX-License-Identifier: Apache-2.0
"""A step that a robot cannot vouch for gives neither survival nor a reading, in every method."""

import brute_force
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Dynamics,
    Estimator,
    Grid,
    Ledger,
    METHODS,
    Observation,
    Report,
    SensorModel,
    Unknowns,
    update,
)
from kbnitp_ros.core.inference.one_pass import OnePass
from laws import for_each
import numpy as np
import pytest

GRID = Grid(3, 2)
KEY = DeploymentKey('scout_1', 1)
ONE_PASS = [name for name, method in METHODS.items() if isinstance(method, OnePass)]


def draw(seed):
    """Draw a belief, sensors, and a return with steps that do not count."""
    rng = np.random.default_rng(seed)
    while True:
        joint, sensors, path = brute_force.random_case(rng, most_cells=5, most_steps=9)
        model = SensorModel(**sensors)
        readings = rng.integers(-1, 2, len(path) - 1)
        entered = rng.random(len(path) - 1) < rng.choice([0.0, 0.5, 0.8])
        counted = [path[0], *np.array(path[1:])[entered].tolist()]
        read = readings[entered].tolist()
        if len(counted) == 1 or (
            brute_force.evidence_probability(joint, model, counted, read, 0, None) > 1e-9
        ):
            return joint, model, Observation(path, True, readings, entered=entered), counted, read


@for_each('method', ONE_PASS)
@for_each('seed', range(60))
def test_a_return_counts_where_it_is_vouched_for(seed, method):
    joint, model, observation, path, read = draw(seed)
    if not METHODS[method].correlated:
        joint = Belief(joint).independent().joint
    found = update(Belief(joint), model, observation, method)
    expected = joint if len(path) == 1 else brute_force.posterior(joint, model, (path, read))
    assert found.hazard == pytest.approx(expected[:, 1].sum(axis=1), rel=0, abs=1e-12)
    assert found.target == pytest.approx(expected[:, :, 1].sum(axis=1), rel=0, abs=1e-12)
    if METHODS[method].correlated:
        assert found.joint == pytest.approx(expected, rel=0, abs=1e-12)


ESTIMATORS = {
    **{name: {'method': name} for name in METHODS},
    'changing': {'dynamics': Dynamics('changing', 0.02, 0.1)},
    'used up': {'dynamics': Dynamics('used_up')},
    'kinds': {'dynamics': Dynamics('learn')},
    'learnt': {'unknowns': Unknowns(lethality=(0.1, 0.9), malfunction=(0.0, 0.2))},
    'learnt by sampling': {
        'method': 'kappa_bnitp_sampled', 'unknowns': Unknowns(lethality=(0.1, 0.9)),
    },
}  # fmt: skip


@for_each('name', list(ESTIMATORS))
def test_it_counts_like_the_shorter_walk_to_the_bit(name):
    def believed(*observations):
        prior = Belief.prior(GRID, 0.3, 0.4, 0.7)
        estimator = Estimator(prior, SensorModel(0.5), **ESTIMATORS[name], seed=3)
        for observation in observations:
            estimator.assimilate(observation)
        return estimator

    lost = Observation([0, 1, 4, 1, 0], False)
    whole = Observation(
        [0, 1, 2, 5, 4, 1, 0], True, [1, 1, 0, 1, 0, -1], entered=[1, 0, 0, 0, 1, 1]
    )
    shorter = Observation([0, 1, 1, 0], True, [1, 0, -1])
    found, expected = believed(whole, lost, whole), believed(shorter, lost, shorter)
    assert found.belief.joint.tobytes() == expected.belief.joint.tobytes()
    assert found.kinds == expected.kinds
    assert found.model_check == expected.model_check
    for number, learnt in found.parameters.items():
        assert learnt.mean == expected.parameters[number].mean
    # Without a step that counts only the loss does; time passes all the same.
    empty = Observation([0, 1, 0], True, [1, 1], entered=[0, 0])
    if 'dynamics' not in ESTIMATORS[name]:
        one, other = believed(empty, lost, empty), believed(lost)
        assert one.belief.joint == pytest.approx(other.belief.joint, rel=0, abs=0.02)
        if 'sampl' not in name:
            assert one.belief.joint == pytest.approx(other.belief.joint, rel=0, abs=1e-12)


def test_it_is_stored_normalised():
    observation = Observation([0, 1, 0], True, [True, False], entered=[True, True])
    assert observation == Observation([0, 1, 0], True, [True, False])
    partly = Observation([0, 1, 0], True, [True, False], entered=[0, 1])
    assert partly.readings.tolist() == [-1, 0]
    assert partly.is_entered.tolist() == [False, True]
    given = np.array([False, True])
    assert Observation([0, 1, 0], True, [1, 0], entered=given) == partly
    assert given.flags.writeable


def ledger():
    estimator = Estimator(Belief.prior(GRID, 0.3, 0.4, 0.7), SensorModel(0.5))
    record = Ledger(GRID, 6, estimator)
    record.record_path(KEY, [0, 1, 2, 1, 0])
    return record


READINGS = ((1, 1), (2, 0), (1, 0), (0, 0))


def test_a_report_of_another_field_counts_for_nothing():
    record = ledger()
    before = record.belief
    other = Report(True, READINGS, field_id=Grid(4, 2).id)
    with pytest.raises(ValueError, match='was made in another field: field_id is'):
        record.record_report(KEY, other)
    with pytest.raises(ValueError, match='another field'):
        record.record_report(KEY, Report(False, field_id=Grid(3, 2, yaw=0.1).id))
    assert record.belief is before
    assert record.record_report(KEY, Report(True, READINGS, field_id=GRID.id))


def test_a_later_version_repeats_a_report_without_contradicting_it():
    record = ledger()
    assert record.record_report(KEY, Report(True, READINGS, content=1))
    # The agent now says which of its steps it vouches for.
    again = Report(True, READINGS, content=2, entered=(True, False, True, True))
    assert not record.record_report(KEY, again)
    assert not record.standings[KEY].refusals
    # Another reading is a contradiction still.
    read = tuple((cell, 1 - reading) for cell, reading in READINGS)
    with pytest.raises(ValueError, match='reports of deployment .* differ'):
        record.record_report(KEY, Report(True, read, entered=(True, False, True, True)))
