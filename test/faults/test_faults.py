# SPDX-License-Identifier: Apache-2.0
"""A share of the campaign: no fault loses a deployment or counts one twice."""

from __future__ import annotations

from collections import Counter

from campaign import run_missions
from extent import FULL
import pytest
from schedule import NODES, STRUCK

pytestmark = pytest.mark.processes

# Seeds of missions with faults of all kinds, of one agent and of four.
EVERY_KIND = (9, 22)


def test_missions_under_faults_end_as_if_unbroken(tmp_path):
    jobs = [(seed, 'mixed', tmp_path) for seed in EVERY_KIND]
    if FULL:
        jobs += [(seed, 'mixed', tmp_path) for seed in range(100, 124)]
        jobs += [(1, kind, tmp_path) for kind in STRUCK]
    outcomes = run_missions(jobs)
    assert len(outcomes) == len(jobs)
    assert not [str(outcome) for outcome in outcomes if outcome.findings]
    faults = sum((outcome.faults for outcome in outcomes), start=Counter())
    assert faults.keys() == STRUCK.keys()
    struck = {node for outcome in outcomes for _, node in outcome.strikes}
    assert struck == set(NODES)
