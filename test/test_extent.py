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

LONG = """
import pytest
from extent import FULL


@pytest.mark.full
def test_long():
    assert FULL


def test_short():
    print(f'all: {FULL}')
"""

PROCESSES = """
import os
import subprocess
import pytest


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


def test_without():
    pass
"""

CASES = """
from laws import for_each


@for_each('seed', range(6))
def test_law(seed):
    assert seed not in (3, 4)


@for_each('place', 'ab')
def test_other(place):
    pass
"""


@pytest.fixture
def run(tmp_path):
    """Return a function that runs tests like `make test`, and returns status and output."""
    folder = Path(__file__).parent
    for name in ('conftest.py', 'extent.py', 'laws.py'):
        tmp_path.joinpath(name).write_text(folder.joinpath(name).read_text())
    markers = '[pytest]\nmarkers =\n    full: long\n    processes: starts them\n'
    tmp_path.joinpath('pytest.ini').write_text(markers)

    def run(tests, *options, asked=''):
        tmp_path.joinpath('test_all.py').write_text(tests)
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
@pytest.mark.parametrize('asked, expected, told', [
    ('', 0, '1 passed, 1 skipped'),
    ('full', 0, '2 passed'),
    ('ful', 4, f"{VARIABLE} is 'ful': it must be full, or not be set"),
])  # fmt: skip
def test_all_tests_run_on_request(run, asked, expected, told):
    status, words = run(LONG, asked=asked)
    assert status == expected
    assert told in words


@pytest.mark.processes
def test_tests_with_processes_are_marked_and_may_be_left_out(run):
    status, words = run(PROCESSES)
    assert status == 1
    assert '2 failed, 3 passed' in words
    for start in ('run', 'Popen'):
        assert f'test_not_marked[{start}] starts a process: mark it with' in words
    _, words = run(PROCESSES, '-m', 'not processes')
    assert '2 failed, 1 passed, 2 deselected' in words


@pytest.mark.processes
def test_the_case_that_failed_runs_alone(run):
    status, words = run(CASES)
    assert status == 1
    assert '1 failed, 1 passed' in words
    assert 'case seed=3: ' in words
    assert 'alone: --case seed=3' in words
    assert '1 failed, 1 skipped' in run(CASES, '--case', 'seed=4')[1]


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
