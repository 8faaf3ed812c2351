# SPDX-License-Identifier: Apache-2.0
"""Laws hold for methods of other packages, and benchmarks are listed."""

from importlib import import_module
from pathlib import Path
import subprocess
import sys

from documented import ROOT
from extent import some
import pytest
from strangers import install

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
    'test/nodes/test_parameters.py',
]
LAWS = [
    'test/core/inference/test_ledger.py'
    '::test_an_earlier_deployment_takes_back_what_it_makes_impossible',
    'test/core/test_laws.py::test_planners_keep_their_laws',
    'test/messages/test_beliefs.py::test_a_belief_comes_back_bit_for_bit',
]


@pytest.fixture(scope='module')
def environment(tmp_path_factory):
    """Return the environment of a machine with the newcomers installed."""
    return install(tmp_path_factory.mktemp('newcomers'), 'newcomers', SOURCE, ADDED)


def check(environment, *runs):
    """Check that runs of tests pass with the newcomers installed; return pytest's output."""
    common = ['-q', '-p', 'no:cacheprovider']
    code = f'import pytest, sys; sys.exit(any(pytest.main({common} + each) for each in {[*runs]}))'
    command = [sys.executable, '-c', code]
    # Options for this run, as of xdist, are none of theirs.
    alone = {name: value for name, value in environment.items() if name != 'PYTEST_ADDOPTS'}
    tested = subprocess.run(command, cwd=ROOT, env=alone, capture_output=True, text=True)
    assert tested.returncode == 0, tested.stdout[-5000:]
    return tested.stdout


@pytest.mark.processes
@pytest.mark.parametrize('runs', some([[], [['-k', 'known or refused or shipped', *QUICK]]]))
def test_newcomers_are_held_to_all_laws_and_disturb_no_others(environment, runs):
    told = check(environment, ['-vv', '--case', NAME, *LAWS], *runs)
    # A law without a case of theirs is skipped.
    assert [law for law in LAWS if f'{law} PASSED' in told] == LAWS, told


@pytest.mark.processes
@pytest.mark.full
@pytest.mark.campaign
def test_every_test_holds_with_newcomers(environment):
    check(environment, CONCERNED)


FOLDER = Path(__file__).parents[1] / 'benchmarks'


@pytest.fixture
def load(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    before = set(sys.modules)
    yield import_module
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], '__file__', None) or '').parent == FOLDER:
            del sys.modules[name]


def test_all_benchmarks_are_listed_under_different_titles(load):
    command = load('run')
    titles = [benchmark.title for benchmark in command.BENCHMARKS]
    assert len(set(titles)) == len(titles) >= 8
    assert all(len(each.cases) > 1 for each in command.BENCHMARKS)


def test_ratios_are_to_the_first_case(load, monkeypatch, tmp_path, capsys):
    command, cases = load('run'), load('cases')
    seconds = iter([0.002, 0.5, 3e-6, 2.0])
    few = [
        cases.Benchmark(title, 'All alike.', dict.fromkeys(names, lambda: next(seconds)))
        for title, names in (('A plan', ('small', 'large')), ('An update', ('early', 'late')))
    ]
    monkeypatch.setattr(command, 'BENCHMARKS', few)
    kept = tmp_path / 'performance.md'
    kept.write_text('Before\n<!-- table benchmarks -->\n<!-- end -->\nAfter\n<!-- end -->\n')
    monkeypatch.setattr(command, 'PAGE', kept)
    assert command.main() == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[2:] == [
        '| A plan | small | 2 ms | 1 |',
        '| A plan | large | 500 ms | 250 |',
        '| An update | early | 3 µs | 1 |',
        '| An update | late | 2 s | 6.67e+05 |',
    ]
    page = kept.read_text()
    assert page.startswith('Before\n')
    assert page.endswith('<!-- end -->\nAfter\n<!-- end -->\n')
    assert '## A plan\n\nAll alike.\n\n| | takes | ratio |\n|---|---|---|\n| small' in page


def test_peers_get_the_same_posterior(load):
    peers = load('peers')
    assert peers.by_enumeration() == pytest.approx(peers.by_update(), rel=0, abs=peers.TOLERANCE)
