# SPDX-License-Identifier: Apache-2.0
"""
A new method, planner or allocation is one file and one line, and is held to what holds of all.

In a copy of the project there is one more of each, of little use: a method that learns nothing of
losses, a planner that returns the worst path it found, and an allocation that sends all robots but
the first along such a path. No test of the others may fail of that, and those of all must hold.
"""

import os
from pathlib import Path
from shutil import copytree, ignore_patterns
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]

NAME = 'newcomer'
CORE = 'kbnitp_ros/core'
FILES = {
    f'{CORE}/inference/new_method.py': """
import numpy as np


def lost_likelihood(hazard, model, visits):
    return np.ones((len(hazard), 2))
""",
    f'{CORE}/planning/new_planner.py': """
from kbnitp_ros.core.planning.planners import beam


def paths(*search):
    return beam(*search)[-1:]
""",
    f'{CORE}/planning/new_allocation.py': """
def allocate(finder, objective, agents):
    found = finder.paths(objective)
    return [found[0].path] + [found[-1].path] * (agents - 1), None
""",
}
LINES = {
    f'{CORE}/inference/methods.py': f"""
from kbnitp_ros.core.inference import new_method
VERSIONS['{NAME}'] = (OnePass(new_method.lost_likelihood, correlated=True),)
""",
    f'{CORE}/planning/planners.py': f"""
from kbnitp_ros.core.planning import new_planner
PLANNERS['{NAME}'] = new_planner.paths
""",
    f'{CORE}/planning/allocations.py': f"""
from kbnitp_ros.core.planning import new_allocation
ALLOCATIONS['{NAME}'] = new_allocation.allocate
""",
}

# The tests that take names from the registries or have names of their own, and those of them that
# tell most in little time.
CONCERNED = [
    'test/core',
    'test/messages',
    'test/log/test_replay.py',
    'test/study',
    'test/nodes/test_parameters.py',
]
QUICK = [
    'test/core/inference/test_update.py',
    'test/core/inference/test_ledger.py',
    'test/core/planning/test_planning.py',
    'test/messages/test_beliefs.py',
    'test/study/test_scenario.py',
    'test/study/test_page.py',
    'test/nodes/test_parameters.py',
]


@pytest.fixture(scope='module')
def copy(tmp_path_factory):
    """Return where the project is with newcomers."""
    copy = tmp_path_factory.mktemp('newcomers')
    ignored = ignore_patterns('__pycache__', 'node_modules', '.*_cache')
    for folder in ('kbnitp_ros', 'test', 'config', 'docs', 'scenarios'):
        copytree(ROOT / folder, copy / folder, ignore=ignored)
    copy.joinpath('setup.cfg').write_text(ROOT.joinpath('setup.cfg').read_text())
    for name, text in FILES.items():
        copy.joinpath(name).write_text(text)
    for name, line in LINES.items():
        with copy.joinpath(name).open('a') as registry:
            registry.write(line)
    page = run(copy, 'kbnitp_ros.nodes.parameters')
    assert page.returncode == 0
    copy.joinpath('docs/parameters.md').write_text(page.stdout)
    return copy


def run(copy, *module):
    """Run a module in the copy."""
    environment = {**os.environ, 'PYTHONPATH': f'{copy}:{os.environ.get("PYTHONPATH", "")}'}
    return subprocess.run(
        [sys.executable, '-m', *module], cwd=copy, env=environment, capture_output=True, text=True
    )


def check(copy, *arguments):
    """See that tests hold in the copy."""
    tested = run(copy, 'pytest', '-q', '-p', 'no:cacheprovider', *arguments)
    assert tested.returncode == 0, tested.stdout[-5000:]


def test_newcomers_are_held_to_what_holds_of_all_and_disturb_nobody(copy):
    check(copy, '-k', f'{NAME} or known or refused or shipped or page or printed', *QUICK)


@pytest.mark.full
def test_every_test_holds_with_newcomers(copy):
    check(copy, *CONCERNED)
