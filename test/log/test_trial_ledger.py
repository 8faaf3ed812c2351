# SPDX-License-Identifier: Apache-2.0
"""What a ledger is told on trial can be taken back, as if it had never been said."""

from hypothesis import given, settings
from hypothesis import strategies as st
from kbnitp_ros.core import Belief, DeploymentKey, Estimator, Ledger, Report
from kbnitp_ros.log.evidence import Evidence
from kbnitp_ros.log.trial import TrialLedger
from mission_log import GRID, MAX_STEPS, MODEL

PATHS = {
    DeploymentKey('scout_1', 1): [2, 7, 2],
    DeploymentKey('scout_2', 1): [2, 1, 2],
    DeploymentKey('scout_1', 2): [2, 7, 12, 7, 2],
    DeploymentKey('scout_2', 3): [2, 3, 2],
}


@st.composite
def reported(draw):
    """Return what may be said of one of the deployments, also what is refused."""
    key = draw(st.sampled_from(sorted(PATHS)))
    survived = draw(st.booleans())
    walks = [PATHS[key][1:], PATHS[key][1:], [2], [7]]
    cells = draw(st.sampled_from(walks)) if survived else []
    reading = draw(st.sampled_from([0, 1, -1]))
    stamp = draw(st.integers(0, 9))
    known = 0 if survived else draw(st.integers(0, 3))
    return key, Report(survived, tuple((cell, reading) for cell in cells), stamp, known)


def estimator():
    """Return one that knows nothing yet."""
    return Estimator(Belief.prior(GRID, 0.3, 0.4, 0.7), MODEL)


def state(ledger):
    """Return all that a belief is published of."""
    return (
        ledger.deployments.copy(),
        [ledger.ending(key) for key in ledger.deployments],
        ledger.newest,
        ledger.newest_stamp,
        ledger.belief.joint.tobytes(),
    )


@given(st.lists(st.tuples(st.lists(reported(), max_size=4), reported(), st.booleans())))
@settings(max_examples=150, deadline=None)
def test_a_trial_that_is_taken_back_leaves_nothing(trials):
    evidence = Evidence(GRID, MAX_STEPS)
    plain = Ledger(GRID, MAX_STEPS, estimator())
    for key, path in PATHS.items():
        evidence.record_path(key, path)
        plain.record_path(key, path)
    on_trial = TrialLedger(GRID, MAX_STEPS, estimator(), evidence)
    for taken, last, is_kept in trials:
        before = state(on_trial)
        told = plain.copy()
        for each in (*taken, last):
            try:
                told.record_report(*each)
                is_refused = False
            except ValueError:
                is_refused = True
        try:
            on_trial.tell(taken, last)
        except ValueError:
            assert is_refused
            on_trial.take_back()
            assert state(on_trial) == before
            continue
        assert not is_refused
        assert on_trial.deployments == told.deployments
        assert on_trial.belief.joint.tobytes() == told.belief.joint.tobytes()
        assert (on_trial.newest, on_trial.newest_stamp) == (last[0], last[1].stamp)
        if is_kept:
            changed = on_trial.keep()
            assert set(changed) <= {key for key, _ in (*taken, last)}
            plain = told
        else:
            on_trial.take_back()
            assert state(on_trial) == before
