# SPDX-License-Identifier: Apache-2.0
"""The lists of CONTRIBUTING.md are complete, and laws hold for methods of other packages."""

import gzip
from importlib import import_module
import os
from pathlib import Path
from shutil import copytree
import subprocess
import sys

from documented import ROOT
import pytest
from strangers import install

LISTS = ROOT.joinpath('CONTRIBUTING.md').read_text().split('## Steps of frequent changes')[1]

COLUMN = """
from pathlib import Path
from kbnitp_ros.report.tables import mission_curves
from kbnitp_ros.report.mission import read_mission
from kbnitp_ros.report.tables import write_tables
mission = read_mission('log.mcap')
write_tables(Path(), mission, mission_curves(mission))
head, *lines = Path('deployments.csv').read_text().splitlines()
place = head.split(',').index('first_cell')
assert lines and all(line.split(',')[place] == '0' for line in lines), lines
"""

METHOD = """
from kbnitp_ros.core import METHODS
from kbnitp_ros.testing import check_method
assert 'late' in METHODS
check_method('late', cases=1)
"""

COMPARISON = """
from types import SimpleNamespace
from kbnitp_ros.study.comparison import COMPARISONS
last = COMPARISONS[-1]
section = last.summarise(SimpleNamespace(scenario=None))
assert last.table(section).markdown().splitlines()[-1] == '| 0.5 | 3 |'
"""

LATE = """
from kbnitp_ros.core.inference.sampler import Sampler


class Late(Sampler):
    version = 1
"""

BY_LUCK = """
    AREAS,
    Comparison(
        name='luck',
        applies=learns,
        caption='Luck.',
        columns={'luck': ('luck', '{}')},
        head=lambda scenario: {},
        rows=lambda results: [{'lethality': 0.5, 'luck': 3}],
    ),
)
"""


def paragraph(beginning):
    (found,) = (each for each in LISTS.split('\n\n') if each.startswith(beginning))
    return found


@pytest.mark.processes
@pytest.mark.parametrize('change, edits, script', [
    (
        'A column of the report',
        {
            'kbnitp_ros/report/tables.py': {
                "'path': 'string'": "'first_cell': 'int64',\n    'path': 'string'",
                "'path': text(": "'first_cell': int(deployment.path[0]), 'path': text(",
            },
        },
        COLUMN,
    ),
    pytest.param(
        'A method',
        {
            'kbnitp_ros/core/inference/late.py': {'': LATE},
            'kbnitp_ros/core/inference/methods.py': {
                "        'relaxed_itp': ": "        'late': Late,\n        'relaxed_itp': ",
                'from kbnitp_ros.core.inference.sampler': (
                    'from kbnitp_ros.core.inference.late import Late\n'
                    'from kbnitp_ros.core.inference.sampler'
                ),
            },
        },
        METHOD,
        marks=pytest.mark.full,
    ),
    (
        'A comparison in studies',
        {'kbnitp_ros/study/comparison.py': {'\n    AREAS,\n)\n': BY_LUCK}},
        COMPARISON,
    ),
])  # fmt: skip
def test_a_list_names_all_that_a_change_needs(tmp_path, change, edits, script):
    copytree(ROOT / 'kbnitp_ros', tmp_path / 'kbnitp_ros')
    listed = paragraph(change)
    for name, replaced in edits.items():
        folder, _, file = name.rpartition('/')
        path = tmp_path / name
        assert name in listed or (folder in listed and (not path.exists() or file in listed)), name
        source = path.read_text() if path.exists() else ''
        for before, after in replaced.items():
            assert not before or source.count(before) == 1, before
            source = source.replace(before, after) if before else after
        path.write_text(source)
    log = ROOT / 'test' / 'log' / 'recorded' / 'kappa_bnitp.mcap.gz'
    tmp_path.joinpath('log.mcap').write_bytes(gzip.decompress(log.read_bytes()))
    path = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    told = subprocess.run(
        [sys.executable, '-c', script],
        cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': path},
        capture_output=True,
        text=True,
    )
    assert told.returncode == 0, told.stderr


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
    '::test_a_report_that_makes_later_returns_impossible_is_refused',
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
def test_newcomers_are_held_to_all_laws_and_disturb_no_others(environment):
    told = check(
        environment,
        ['-vv', '--case', NAME, *LAWS],
        ['-k', 'known or refused or shipped', *QUICK],
    )
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
