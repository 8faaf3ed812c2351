# SPDX-License-Identifier: Apache-2.0
"""Whatever way paths and reports come, the belief is that of the evidence in its order."""

from collections import defaultdict

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
)
from laws import for_each
import numpy as np
import pytest

GRID = Grid(3, 3, base=4)
MODEL = SensorModel(0.5)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
MAX_STEPS = 6
ADJACENT = brute_force.adjacent(3, 3)


class Evidence:
    """What has come so far, kept and folded in the plainest way: all again every time."""

    def __init__(self, method):
        self.method = method
        self.paths = {}
        self.reports = defaultdict(list)

    def take(self, key, said):
        """Keep a path or a report."""
        if isinstance(said, Report):
            self.reports[key].append(said)
        else:
            self.paths[key] = said

    def complete(self):
        """Return the deployments with path and report, in their order."""
        return sorted(
            (key for key in self.paths if key in self.reports), key=lambda key: key[::-1]
        )

    def joint(self):
        """Return the belief's bits."""
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
    """Draw a closed walk from the base, by way of any of its neighbours, all of which touch it."""
    inner = [4]
    for _ in range(draw(st.integers(0, MAX_STEPS - 2))):
        inner.append(draw(st.sampled_from(ADJACENT[inner[-1]])))
    return (*inner, 4)


@st.composite
def arrivals(draw):
    """Draw the messages of a mission, each once or more, in any order."""
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
    """Tell a ledger of a path or a report, and return whether its belief changed."""
    record = ledger.record_report if isinstance(said, Report) else ledger.record_path
    return record(key, said)


@pytest.mark.slow
@for_each('method', METHODS)
@given(arrivals())
@settings(max_examples=150 if FULL else 20, deadline=None)
def test_every_arrival_leaves_the_belief_of_the_evidence_so_far(method, messages):
    ledger, evidence = Ledger(GRID, MAX_STEPS, Estimator(PRIOR, MODEL, method)), Evidence(method)
    for key, said in messages:
        before = ledger.belief
        changed = tell(ledger, key, said)
        evidence.take(key, said)
        assert changed is (ledger.belief is not before)
        assert changed <= (ledger.newest == key)
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
    """Return the deployments of a long mission in their order."""
    for number in range(robots):
        path = tuple(brute_force.random_path(rng, 3, 3, 4, MAX_STEPS))
        survived = rng.random() < 0.5
        readings = tuple((cell, bool(rng.random() < 0.5)) for cell in path[1:])
        report = Report(True, readings) if survived else Report(False)
        yield DeploymentKey('scout', number), path, report


def test_disorder_is_cheap(monkeypatch):
    """A deployment that is late by a few of a thousand costs no thousand updates."""
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
