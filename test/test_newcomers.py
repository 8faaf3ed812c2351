# SPDX-License-Identifier: Apache-2.0
"""
A method, planner or allocation of another package is held to what holds of all.

A package outside the project has one of each, of little use: a stateful method that learns
nothing of losses, a planner that returns the worst path it found, and an allocation that sends all
robots but the first along such a path. No test of the others may fail of that, and those of all
must hold.
"""

from pathlib import Path
import subprocess
import sys

import pytest
from strangers import install

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[1]

NAME = 'newcomer'
SOURCE = """
from kbnitp_ros.core import update
from kbnitp_ros.core import KnownModel
from kbnitp_ros.core.planning.planners import beam


class Returns(KnownModel):
    def assimilate(self, observation, robot_type):
        after = update(self.belief, robot_type.model(self.model), observation)
        if observation.survived:
            self.belief = after


def worst(finder, objective):
    return beam(finder, objective)[-1:]


def allocate(robots):
    first, *others = ([each.path for each in r.finder.candidates(r.objective)] for r in robots)
    return [first[0], *(paths[-1] for paths in others)]
"""
ADDED = {
    'methods': {NAME: 'Returns'},
    'planners': {NAME: 'worst'},
    'allocations': {NAME: 'allocate'},
}

# The tests that take names from the registries or have names of their own, those of them that
# tell most in little time, and those with laws that hold of all methods or planners.
CONCERNED = [
    'test/core',
    'test/messages',
    'test/log/test_replay.py',
    'test/study',
    'test/nodes/test_parameters.py',
    'test/nodes/test_given.py',
]
QUICK = [
    'test/core/inference/test_methods.py',
    'test/core/inference/test_ledger.py',
    'test/core/planning/test_planning.py',
    'test/messages/test_beliefs.py',
    'test/study/test_scenario.py',
    'test/study/test_page.py',
    'test/nodes/test_parameters.py',
]
LAWS = [
    'test/core/inference/test_ledger.py'
    '::test_a_return_that_makes_later_ones_impossible_is_refused',
    'test/core/test_laws.py::test_planners_keep_their_laws',
    'test/messages/test_beliefs.py::test_a_belief_comes_back_bit_for_bit',
]


@pytest.fixture(scope='module')
def environment(tmp_path_factory):
    """Return the environment of a machine on which the newcomers are installed."""
    return install(tmp_path_factory.mktemp('newcomers'), 'newcomers', SOURCE, ADDED)


def check(environment, *runs):
    """See that runs of tests hold where the newcomers are installed; return what pytest prints."""
    common = ['-q', '-p', 'no:cacheprovider']
    code = f'import pytest, sys; sys.exit(any(pytest.main({common} + each) for each in {[*runs]}))'
    command = [sys.executable, '-c', code]
    tested = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert tested.returncode == 0, tested.stdout[-5000:]
    return tested.stdout


def test_newcomers_are_held_to_what_holds_of_all_and_disturb_nobody(environment):
    told = check(
        environment,
        ['-vv', '--case', NAME, *LAWS],
        ['-k', 'known or refused or shipped or page', *QUICK],
    )
    # A law without a case of theirs is skipped.
    assert [law for law in LAWS if f'{law} PASSED' in told] == LAWS, told


@pytest.mark.full
def test_quick_tests_hold_with_newcomers(environment):
    check(environment, QUICK)


@pytest.mark.full
@pytest.mark.campaign
def test_every_test_holds_with_newcomers(environment):
    check(environment, CONCERNED)
