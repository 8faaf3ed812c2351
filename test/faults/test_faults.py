# SPDX-License-Identifier: Apache-2.0
"""A share of the campaign: no fault loses a deployment or counts one twice."""

from collections import Counter
from functools import partial

from campaign import run_mission, run_missions
from extent import LONG
from fickle_robot import CRASHED, UNPLUGGED
from kbnitp_ros.nodes.robot import NEW_LINKS
from networks import NoNetworksError
import pytest
from schedule import NODES, STRUCK

pytestmark = pytest.mark.processes

# Seeds of missions with faults of all kinds, of one agent and of four.
EVERY_KIND = (9, 22)


def check(outcomes):
    """See that missions ended as if nothing had struck, and that everything did."""
    assert not [str(outcome) for outcome in outcomes if outcome.findings]
    faults = sum((outcome.faults for outcome in outcomes), start=Counter())
    assert faults.keys() == {*STRUCK, 'held'}
    struck = {node for outcome in outcomes for _, node in outcome.strikes}
    assert struck == set(NODES)


def test_missions_under_faults_end_as_if_unbroken(tmp_path, processes):
    check([run_mission((seed, 'mixed', tmp_path), processes) for seed in EVERY_KIND])


@pytest.mark.full
def test_many_missions_under_faults_end_as_if_unbroken(tmp_path):
    jobs = [(seed, 'mixed', tmp_path) for seed in range(100, 124)]
    jobs += [(1, kind, tmp_path) for kind in STRUCK]
    outcomes = run_missions(jobs)
    assert len(outcomes) == len(jobs)
    check(outcomes)


@pytest.mark.full
@pytest.mark.parametrize('is_apart, codes', [
    (False, {CRASHED}),
    pytest.param(True, {CRASHED, UNPLUGGED, NEW_LINKS}, marks=LONG),
])  # fmt: skip
def test_no_robot_is_lost_that_stayed_and_none_forgotten_that_left(tmp_path, is_apart, codes):
    jobs = [(seed, 'mixed', tmp_path) for seed in (1, 2)]
    try:
        outcomes = run_missions(jobs, run=partial(run_mission, has_robots=True, is_apart=is_apart))
    except NoNetworksError as error:
        pytest.skip(f'no networks can be made: {error}')
    assert not [str(outcome) for outcome in outcomes if outcome.findings]
    crashes = sum((outcome.crashes for outcome in outcomes), start=Counter())
    assert crashes.keys() == codes
