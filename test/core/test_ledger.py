# SPDX-License-Identifier: Apache-2.0
"""Paths and reports as they come: late, twice, out of order, wrong."""

import brute_force
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    Observation,
    Report,
    SensorModel,
    update,
)
import numpy as np
import pytest

GRID = Grid(3, 3, base=4)
MODEL = SensorModel(0.5)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
A, B, C = (DeploymentKey('scout_1', stamp) for stamp in (1, 2, 3))
PATH = [4, 0, 1, 4]
RETURNED = Report(True, ((0, True), (1, False), (4, False)))
LOST = Report(False)
RETURNED_SEEN, LOST_SEEN = Observation(PATH, True, [True, False, False]), Observation(PATH, False)


@pytest.fixture
def ledger():
    return Ledger(GRID, 4, Estimator(PRIOR, MODEL, 'kappa_bnitp'))


def state(ledger):
    return (
        ledger.belief.joint.tobytes(),
        list(ledger.held),
        ledger.duplicates,
        ledger.waiting,
        ledger.out,
    )


def folded(*observations):
    belief = PRIOR
    for observation in observations:
        belief = update(belief, MODEL, observation)
    return belief.joint.tobytes()


def test_nothing_known_yet(ledger):
    assert state(ledger) == (PRIOR.joint.tobytes(), [], 0, 0, 0)


def test_a_path_then_its_report(ledger):
    assert ledger.record_path(A, PATH) is False
    assert state(ledger) == (folded(), [], 0, 0, 1)
    assert ledger.record_report(A, RETURNED) is True
    assert state(ledger) == (folded(RETURNED_SEEN), [A], 0, 0, 0)


def test_a_report_waits_for_its_path(ledger):
    assert ledger.record_report(A, LOST) is False
    assert state(ledger) == (folded(), [], 0, 1, 0)
    assert ledger.record_path(A, PATH) is True
    assert state(ledger) == (folded(LOST_SEEN), [A], 0, 0, 0)


def test_deployments_count_in_the_order_they_are_complete(ledger):
    for key in (A, B, C):
        ledger.record_path(key, PATH)
    ledger.record_report(C, LOST)
    ledger.record_report(A, RETURNED)
    ledger.record_report(B, LOST)
    assert ledger.held == [C, A, B]
    assert ledger.belief.joint.tobytes() == folded(LOST_SEEN, RETURNED_SEEN, LOST_SEEN)


def test_agents_are_told_apart_by_name(ledger):
    other = DeploymentKey('scout_2', A.stamp)
    ledger.record_path(A, PATH)
    ledger.record_path(other, [4, 8, 4])
    assert ledger.record_report(other, LOST)
    assert ledger.record_report(A, RETURNED)
    assert ledger.held == [other, A]
    assert ledger.belief.joint.tobytes() == folded(Observation([4, 8, 4], False), RETURNED_SEEN)


def test_duplicates_change_nothing_but_their_count(ledger):
    ledger.record_path(A, PATH)
    assert ledger.record_path(A, np.array(PATH)) is False
    ledger.record_report(A, RETURNED)
    assert ledger.record_report(A, Report(True, tuple(RETURNED.readings))) is False
    assert ledger.record_path(A, PATH) is False
    assert state(ledger) == (folded(RETURNED_SEEN), [A], 3, 0, 0)


def test_a_waiting_report_said_again_still_counts_once(ledger):
    ledger.record_report(A, LOST)
    assert ledger.record_report(A, LOST) is False
    assert ledger.duplicates == 1
    ledger.record_path(A, PATH)
    assert state(ledger) == (folded(LOST_SEEN), [A], 1, 0, 0)


def test_any_order_of_delivery_with_repeats_ends_in_the_same_beliefs():
    rng = np.random.default_rng(0)
    keys = [DeploymentKey('scout_1', k) for k in range(8)]
    paths = {key: brute_force.random_path(rng, 3, 3, 4, 4) for key in keys}
    reports = {
        key: Report(True, tuple((cell, bool(rng.random() < 0.5)) for cell in path[1:]))
        for key, path in paths.items()
    }
    ends = []
    for _ in range(5):
        ledger = Ledger(GRID, 4, Estimator(PRIOR, MODEL, 'kappa_bnitp'))
        for i in rng.permutation(np.repeat(np.arange(16), 2)):
            if i < 8:
                ledger.record_path(keys[i], paths[keys[i]])
            else:
                ledger.record_report(keys[i - 8], reports[keys[i - 8]])
        assert sorted(ledger.held) == keys
        assert (ledger.duplicates, ledger.waiting, ledger.out) == (16, 0, 0)
        ends.append(ledger.belief.joint)
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    'path, message',
    [
        ([4, 9, 4], 'path.*9'),
        ([4, 5, 0, 4], 'path jumps'),
        ([0, 4], 'path must start at the base'),
        ([4], 'path'),
        ([4] * 6, 'path has 5 steps.*4'),
    ],
)
def test_impossible_paths_are_refused(ledger, path, message):
    ledger.record_report(B, LOST)
    before = state(ledger)
    with pytest.raises(ValueError, match=message):
        ledger.record_path(A, path)
    assert state(ledger) == before
    assert not ledger.record_path(A, PATH)  # the right one may still come
    assert ledger.record_report(A, LOST)


def test_another_path_for_a_known_deployment_is_refused(ledger):
    ledger.record_path(A, PATH)
    for _ in range(2):
        before = state(ledger)
        with pytest.raises(ValueError, match='path.*scout_1.*differs'):
            ledger.record_path(A, [4, 8, 4])
        assert state(ledger) == before
        ledger.record_report(A, RETURNED)
    assert ledger.belief.joint.tobytes() == folded(RETURNED_SEEN)


@pytest.mark.parametrize('known', ['waiting', 'held'])
def test_another_report_for_a_known_deployment_is_refused(ledger, known):
    if known == 'held':
        ledger.record_path(A, PATH)
    ledger.record_report(A, RETURNED)
    before = state(ledger)
    for other in (LOST, Report(True, ((0, True), (1, True), (4, False)))):
        with pytest.raises(ValueError, match='report.*scout_1.*differs'):
            ledger.record_report(A, other)
    assert state(ledger) == before


UNFIT = [
    (Report(True), 'readings.*scout_1.*3 steps'),
    (Report(True, ((0, True), (1, False))), 'readings.*scout_1.*3 steps'),
    (Report(True, ((0, True), (1, False), (4, False), (4, False))), 'readings.*scout_1.*3 steps'),
    (Report(True, ((1, True), (0, False), (4, False))), r'readings.*scout_1.*\[1, 0, 4\]'),
    (Report(True, ((0, True), (99, False), (4, False))), 'readings.*scout_1.*99'),
    (Report(False, ((0, True), (1, False), (4, False))), 'readings.*scout_1.*lost.*none'),
]


@pytest.mark.parametrize('report, message', UNFIT)
def test_a_report_that_does_not_fit_its_path_is_refused(ledger, report, message):
    ledger.record_path(A, PATH)
    before = state(ledger)
    with pytest.raises(ValueError, match=message):
        ledger.record_report(A, report)
    assert state(ledger) == before
    assert ledger.record_report(A, RETURNED)  # the right one may still come
    assert ledger.belief.joint.tobytes() == folded(RETURNED_SEEN)


@pytest.mark.parametrize('report, message', UNFIT)
def test_a_waiting_report_that_does_not_fit_its_path_is_dropped(ledger, report, message):
    ledger.record_report(A, report)
    with pytest.raises(ValueError, match=message):
        ledger.record_path(A, PATH)
    assert state(ledger) == (folded(), [], 0, 0, 1)
    assert ledger.record_report(A, RETURNED)
    assert ledger.belief.joint.tobytes() == folded(RETURNED_SEEN)


def test_impossible_evidence_is_refused():
    safe = Belief.prior(GRID, 0.0, 0.45, 0.45)
    perfect = SensorModel(0.5, malfunction=0.0)
    ledger = Ledger(GRID, 4, Estimator(safe, perfect, 'kappa_bnitp'))
    ledger.record_path(A, PATH)
    before = state(ledger)
    with pytest.raises(ValueError, match='impossible|probability'):
        ledger.record_report(A, LOST)
    assert state(ledger) == before
    assert ledger.record_report(A, RETURNED)


def test_keys_name_the_agent_and_the_time():
    assert str(DeploymentKey('scout_1', 12_000_000_034)) == 'scout_1 at 12.000000034'
