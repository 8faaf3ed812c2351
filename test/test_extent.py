# SPDX-License-Identifier: Apache-2.0
"""Selection of tests and cases: slow ones, those that start processes, and a single one."""

import inspect
import os
from pathlib import Path
import subprocess
import sys

from extent import VARIABLE
import laws
from laws import for_each
import pytest

TESTS = """
import os
import subprocess
from extent import FULL
from laws import for_each
import pytest


@pytest.mark.full
def test_long():
    assert FULL


@pytest.fixture
def field():
    subprocess.run(['true'])


def test_by_a_fixture(field):
    pass


@pytest.mark.processes
def test_marked():
    os.system('true')


@pytest.mark.parametrize('start', [subprocess.run, subprocess.Popen])
def test_not_marked(start):
    start(['true'])


@for_each('seed', range(6))
def test_law(seed):
    assert seed not in (3, 4)
"""


@pytest.fixture
def run(tmp_path):
    """Return a function that runs tests like `make test`, and returns status and output."""
    folder = Path(__file__).parent
    for name in ('conftest.py', 'extent.py', 'laws.py'):
        tmp_path.joinpath(name).write_text(folder.joinpath(name).read_text())
    markers = '[pytest]\nmarkers =\n    full: long\n    processes: starts them\n'
    tmp_path.joinpath('pytest.ini').write_text(markers)
    tmp_path.joinpath('test_all.py').write_text(TESTS)

    def run(*options, asked=''):
        tested = subprocess.run(
            [sys.executable, '-m', 'pytest', '-p', 'no:cacheprovider', *options],
            cwd=tmp_path,
            env={**os.environ, VARIABLE: asked, 'PYTEST_ADDOPTS': ''},
            capture_output=True,
            text=True,
        )
        return tested.returncode, tested.stdout + tested.stderr

    return run


@pytest.mark.processes
def test_tests_are_selected_by_extent_marker_and_case(run):
    status, words = run()
    assert status == 1
    assert '3 failed, 2 passed, 1 skipped' in words
    for start in ('run', 'Popen'):
        assert f'test_not_marked[{start}] starts a process: mark it with' in words
    assert 'case seed=3: ' in words
    assert 'alone: --case seed=3' in words
    _, words = run('-m', 'not processes', '-k', 'not law', asked='full')
    assert '2 failed, 1 passed, 3 deselected' in words
    assert '1 failed, 5 deselected' in run('-k', 'law', '--case', 'seed=4')[1]
    status, words = run(asked='ful')
    assert status == 4
    assert f"{VARIABLE} is 'ful': it must be full, or not be set" in words


def small(seed, ran):
    ran.append(seed)
    assert seed < 3, 'too large'


def test_all_combinations_of_cases_run_and_each_runs_alone(monkeypatch):
    ran = []

    @for_each('seed', range(2))
    @for_each('name, size', [('a', 1), ('b', 2)])
    def law(seed, name, size, to):
        to.append((seed, name, size))

    assert list(inspect.signature(law).parameters) == ['to']
    law(to=ran)
    assert ran == [(0, 'a', 1), (0, 'b', 2), (1, 'a', 1), (1, 'b', 2)]
    monkeypatch.setattr(laws, 'alone', 'seed=1, name=a, size=1')
    law(to=ran)
    assert ran[4:] == [(1, 'a', 1)]


def test_each_case_has_a_folder_of_its_own(tmp_path):
    for_each('seed', range(3))(lambda seed, tmp_path: (tmp_path / 'file').touch(exist_ok=False))(
        tmp_path=tmp_path
    )
    assert len(list(tmp_path.glob('*/file'))) == 3


def test_settings_of_a_case_are_undone_after_it(monkeypatch):
    def law(seed, monkeypatch):
        assert 'KBNITP_CASE' not in os.environ
        monkeypatch.setenv('KBNITP_CASE', str(seed))

    for_each('seed', range(2))(law)(monkeypatch=monkeypatch)
    assert 'KBNITP_CASE' not in os.environ


def test_the_first_of_every_few_cases_always_runs_and_the_rest_as_full():
    ran = []
    law = for_each('seed', range(3), every=2)(small)
    law(ran=ran, rest=False)
    assert ran == [0, 2]
    law(ran=ran, rest=True)
    assert ran == [0, 2, 1]
    ((mark,),) = [law.pytestmark]
    some, rest = mark.args[1]
    assert some is False
    assert [each.name for each in rest.marks] == ['full']
