# SPDX-License-Identifier: Apache-2.0
"""A ledger's belief is that of the evidence so far, in any order of arrival."""

from collections import defaultdict
import tracemalloc

import brute_force
from extent import FULL
from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import (
    Belief,
    DeploymentKey,
    Estimator,
    Grid,
    Ledger,
    METHODS,
    Observation,
    Report,
    SensorModel,
    update,
)
from kbnitp_ros.core.inference.record import Cause, Verdict
from laws import for_each
import numpy as np
import pytest
from rounds import LEARN_FROM_LOSSES

GRID = Grid(3, 3, base=4)
MODEL = SensorModel(0.5)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
A, B, C = (DeploymentKey('scout_1', stamp) for stamp in (1, 2, 3))
PATH = [4, 0, 1, 4]
RETURNED = Report(True, ((0, True), (1, False), (4, False)))
LOST = Report(False)
RETURNED_SEEN, LOST_SEEN = Observation(PATH, True, [True, False, False]), Observation(PATH, False)


def new_ledger():
    return Ledger(GRID, 4, Estimator(PRIOR, MODEL, 'kappa_bnitp'))


@pytest.fixture
def ledger():
    return new_ledger()


def state(ledger):
    return (
        ledger.belief.joint.tobytes(),
        list(ledger.deployments),
        (ledger.newest, ledger.newest_stamp),
        ledger.duplicates,
        ledger.pending,
        len(ledger.paths) - len(ledger.outcomes),
    )


def folded(*observations):
    belief = PRIOR
    for observation in observations:
        belief = update(belief, MODEL, observation)
    return belief.joint.tobytes()


def test_a_late_return_replaces_the_loss(ledger):
    for key, report in ((A, LOST), (B, LOST)):
        ledger.record_path(key, PATH)
        ledger.record_report(key, report)
    assert ledger.record_report(A, Report(True, RETURNED.readings, stamp=7)) is True
    assert state(ledger) == (folded(RETURNED_SEEN, LOST_SEEN), [A, B], (A, 7), 0, 0, 0)
    assert ledger.record_report(A, Report(False, stamp=9)) is False
    assert ledger.record_report(A, Report(True, RETURNED.readings, stamp=9)) is False
    assert state(ledger) == (folded(RETURNED_SEEN, LOST_SEEN), [A, B], (A, 7), 2, 0, 0)


@for_each('path, message', [
    ([4, 9, 4], 'path.*9'),
    ([4, 5, 0, 4], 'path jumps'),
    ([0, 4], 'path must start at the base'),
    ([4], 'path'),
    ([4] * 6, 'path has 5 steps.*4'),
])  # fmt: skip
def test_impossible_paths_are_refused(path, message):
    ledger = new_ledger()
    ledger.record_report(B, LOST)
    before = state(ledger)
    with pytest.raises(ValueError, match=message):
        ledger.record_path(A, path)
    assert state(ledger) == before
    assert not ledger.record_path(A, PATH)  # the correct one may still arrive
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


# Returns of one deployment (for example of two robots of one name), in order of precedence.
RETURNS = [
    Report(True, ((0, True), (1, -1), (4, -1))),
    Report(True, ((0, True), (4, True))),
    Report(True, ((0, True), (1, False), (4, False))),
    Report(True, ((0, True), (3, False), (4, False))),
    Report(True, ((0, True), (1, True), (4, False))),
]


@for_each('second', range(len(RETURNS)))
@for_each('first', range(len(RETURNS)))
def test_the_return_with_more_readings_counts_in_any_order(first, second):
    ledger = new_ledger()
    ledger.record_path(A, PATH)
    assert ledger.record_report(A, RETURNS[first])
    before = state(ledger)
    if first > second:
        with pytest.raises(ValueError, match='reports of .*scout_1.*differ: the one with more'):
            ledger.record_report(A, RETURNS[second])
        assert state(ledger) == before
    else:
        assert ledger.record_report(A, RETURNS[second]) is (first < second)
    causes = [each.cause for each in ledger.standings[A].refusals]
    assert causes == [Cause.CONTRADICTED] * (first != second)
    assert ledger.standings[A].verdict is Verdict.RETURN
    counts = RETURNS[max(first, second)].readings
    walk, readings = zip((4, 0), *counts)
    assert ledger.belief.joint.tobytes() == folded(Observation(walk, True, readings[1:]))


UNFIT = [
    (Report(True), 'readings.*scout_1.*one for each step'),
    (Report(True, ((0, True), (1, False))), 'readings.*scout_1.*end at the base 4'),
    (Report(True, ((0, True), (2, False), (4, False))), 'readings.*scout_1.*jumps.*0 to 2'),
    (Report(True, RETURNED.readings, steps_survived=1), 'scout_1.*steps_survived is 1.*returned'),
    (Report(False, steps_survived=3), 'scout_1.*steps_survived is 3.*at most 2'),
    (Report(True, ((0, True), (99, False), (4, False))), 'readings.*scout_1.*99'),
    (Report(False, ((0, True), (1, False), (4, False))), 'scout_1.*readings has 3.*lost.*none'),
]


@for_each('is_reported_first', [False, True])
@for_each('report, message', UNFIT)
def test_a_report_that_does_not_fit_its_path_is_refused(report, message, is_reported_first):
    ledger = new_ledger()
    evidence = [(A, PATH), (A, report)]
    first, second = reversed(evidence) if is_reported_first else evidence
    tell(ledger, *first)
    with pytest.raises(ValueError, match=message):
        tell(ledger, *second)
    assert state(ledger) == (folded(), [], (None, 0), 0, 0, 1)
    assert ledger.record_report(A, RETURNED)  # the correct one may still arrive
    assert ledger.belief.joint.tobytes() == folded(RETURNED_SEEN)


@for_each('readings', [
    ((1, True), (0, False), (4, False)),
    ((0, True), (4, True)),
    ((0, True), (1, False), (2, True), (1, False), (4, False)),
    ((0, -1), (1, 0), (4, -1)),
    ((4, -1),),
])  # fmt: skip
def test_the_walk_that_was_made_is_the_evidence(readings):
    ledger = new_ledger()
    ledger.record_path(A, PATH)
    assert ledger.record_report(A, Report(True, readings))
    assert not ledger.record_report(A, Report(True, readings, stamp=9))
    walk = [PATH[0], *(cell for cell, _ in readings)]
    made = Observation(walk, True, np.array([reading for _, reading in readings]))
    assert ledger.belief.joint.tobytes() == folded(made)
    kept = ledger.outcomes[A]
    assert kept.path.tolist() == walk
    assert kept.readings.tolist() == made.readings.tolist()


def test_a_report_that_waits_beside_one_that_does_not_fit_is_taken_in(ledger):
    """As if the path had come first: only the wrong report is refused."""
    for report, _ in UNFIT:
        ledger.record_report(A, report)
    ledger.record_report(A, RETURNED)
    assert ledger.pending == len(UNFIT) + 1
    assert ledger.record_path(A, PATH)
    assert state(ledger)[1:] == ([A], (A, 0), 0, 0, 0)
    assert ledger.belief.joint.tobytes() == folded(RETURNED_SEEN)


# The sensor never errs: one cell had no target for A and has one for B. Or only hazards destroy
# robots, always: one cell destroyed A and let B through.
RIGHT = SensorModel(0.5, true_positive=1.0, false_positive=0.0)
DEADLY = SensorModel(1.0, malfunction=0.0, false_negative=0.0)
BLANK = Report(True, ((0, False), (4, False)))


@for_each('impossible, model, method', [
    *((BLANK, RIGHT, method) for method in METHODS),
    *((LOST, DEADLY, method) for method in LEARN_FROM_LOSSES),
])  # fmt: skip
def test_an_earlier_deployment_takes_back_what_it_makes_impossible(impossible, model, method):
    """Deployments are judged in their order, whatever arrives first."""
    ledger = Ledger(GRID, 4, Estimator(PRIOR, model, method))
    back = Report(True, ((0, True), (4, False)))
    for key in (A, B, C):
        ledger.record_path(key, [4, 0, 4])
    ledger.record_report(B, back)
    ledger.record_report(C, back)
    assert ledger.record_report(A, impossible)
    assert ledger.deployments == [A]
    assert ledger.held.keys() == {B, C}
    assert all('impossible' in why for why in ledger.held.values())
    # A return with more readings, or one in place of the loss, makes the others possible again.
    seen = Report(True, ((0, True), (1, False), (4, False)))
    assert ledger.record_report(A, seen)
    assert ledger.deployments == [A, B, C]
    assert not ledger.held
    again = Estimator(PRIOR, model, method)
    again.assimilate(Observation(PATH, True, [True, False, False]))
    for _ in range(2):
        again.assimilate(Observation([4, 0, 4], True, [True, False]))
    assert ledger.belief.joint.tobytes() == again.belief.joint.tobytes()


def test_keys_name_the_agent_and_the_time():
    assert str(DeploymentKey('scout_1', 12_000_000_034)) == 'scout_1 at 12.000000034'


@pytest.mark.slow
def test_pending_reports_are_bounded_by_bytes_and_bad_stamps_dropped_first(ledger):
    ledger.record_path(DeploymentKey('scout', 10**18), PATH)
    real = DeploymentKey('scout', 10**18 + 1)
    ledger.record_report(real, Report(False))
    refusals = []
    tracemalloc.start()
    for number in range(700):
        # Of maximum length, with cells that are separate integers in memory.
        readings = tuple((1000 + cell, 0) for cell in range(1500))
        try:
            ledger.record_report(DeploymentKey('scout', number + 1), Report(True, readings))
        except ValueError as error:
            refusals.append(str(error))
        assert ledger.pending < 400
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert refusals
    assert all('at most 50 MB are kept' in refusal for refusal in refusals)
    assert peak < 60e6
    # The report of a robot in flight is never dropped for them.
    assert ledger.record_path(real, PATH)


MAX_STEPS = 6
ADJACENT = brute_force.adjacent(3, 3)


class Evidence:
    """Evidence so far, kept plainly and folded from the start every time."""

    def __init__(self, method):
        self.method = method
        self.paths = {}
        self.reports = defaultdict(list)

    def take(self, key, said):
        """Add a path or a report."""
        if isinstance(said, Report):
            self.reports[key].append(said)
        else:
            self.paths[key] = said

    def complete(self):
        return sorted(
            (key for key in self.paths if key in self.reports), key=lambda key: key[::-1]
        )

    def joint(self):
        estimator = Estimator(PRIOR, MODEL, self.method)
        for key in self.complete():
            observation = Observation(self.paths[key], False)
            for report in self.reports[key]:
                if report.survived:
                    readings = [detected for _, detected in report.readings]
                    observation = Observation(self.paths[key], True, readings)
            estimator.assimilate(observation)
        return estimator.belief.joint.tobytes()


@st.composite
def paths(draw):
    """Draw a closed walk from the base through any neighbour of it."""
    inner = [4]
    for _ in range(draw(st.integers(0, MAX_STEPS - 2))):
        inner.append(draw(st.sampled_from(ADJACENT[inner[-1]])))
    return (*inner, 4)


@st.composite
def arrivals(draw):
    """Draw the messages of a mission, each at least once, in any order."""
    messages = []
    keys = st.builds(DeploymentKey, st.sampled_from(['a', 'b', 'c']), st.integers(0, 9))
    for key in draw(st.lists(keys, unique=True, min_size=1, max_size=7)):
        path = draw(paths())
        readings = tuple((cell, draw(st.booleans())) for cell in path[1:])
        said = draw(
            st.sampled_from(
                [
                    (path,),
                    (path, Report(False)),
                    (path, Report(True, readings)),
                    (path, Report(False), Report(True, readings)),
                    (Report(True, readings),),
                ]
            )
        )
        messages += [(key, each) for each in said for _ in range(draw(st.integers(1, 2)))]
    return draw(st.permutations(messages))


def tell(ledger, key, said):
    record = ledger.record_report if isinstance(said, Report) else ledger.record_path
    return record(key, said)


@pytest.mark.slow
@for_each('method', METHODS)
@given(arrivals())
@settings(max_examples=150 if FULL else 10, deadline=None)
def test_every_arrival_leaves_the_belief_of_the_evidence_so_far(method, messages):
    ledger, evidence = Ledger(GRID, MAX_STEPS, Estimator(PRIOR, MODEL, method)), Evidence(method)
    for key, said in messages:
        before = ledger.belief
        changed = tell(ledger, key, said)
        evidence.take(key, said)
        assert changed or ledger.belief is before
        assert ledger.newest == (evidence.complete() or [None])[-1]
        assert ledger.deployments == evidence.complete()
        assert ledger.belief.joint.tobytes() == evidence.joint()
    distinct = {(key, said) for key, said in messages}
    lost_and_found = sum(
        {Report(False)} < {said for other, said in distinct if other == key}
        and sum(isinstance(said, Report) for other, said in distinct if other == key) == 2
        for key, _ in {(key, None) for key, _ in messages}
    )
    assert 0 <= ledger.duplicates - (len(messages) - len(distinct)) <= lost_and_found


def mission(robots, rng):
    for number in range(robots):
        path = tuple(brute_force.random_path(rng, 3, 3, 4, MAX_STEPS))
        survived = rng.random() < 0.5
        readings = tuple((cell, bool(rng.random() < 0.5)) for cell in path[1:])
        report = Report(True, readings) if survived else Report(False)
        yield DeploymentKey('scout', number), path, report


def test_disorder_is_cheap(monkeypatch):
    """A deployment that is late by a few of a thousand does not repeat a thousand updates."""
    updates = []
    assimilate = Estimator.assimilate
    monkeypatch.setattr(
        Estimator,
        'assimilate',
        lambda self, *evidence: updates.append(1) or assimilate(self, *evidence),
    )
    deployments = list(mission(1000, np.random.default_rng(1)))
    ledger = Ledger(GRID, MAX_STEPS, Estimator(PRIOR, MODEL))
    for key, path, report in [*deployments[:980], *deployments[981:]]:
        ledger.record_path(key, path)
        ledger.record_report(key, report)
    assert len(updates) == 999
    key, path, report = deployments[980]
    ledger.record_path(key, path)
    ledger.record_report(key, report)
    assert 20 <= len(updates) - 999 <= 25
