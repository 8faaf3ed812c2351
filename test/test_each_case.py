# SPDX-License-Identifier: Apache-2.0
"""A law runs for all of its cases, names the one that fails, and runs it alone."""

import inspect
import os

import laws
from laws import for_each
import pytest


def small(seed, ran):
    ran.append(seed)
    assert seed < 3, 'too large'


def test_all_cases_run_in_order_as_one_item():
    ran = []
    for_each('a, b', [(1, 'x'), (2, 'y')])(lambda a, b, to: to.append((a, b)))(to=ran)
    for_each('seed', range(3))(small)(ran=ran)
    assert ran == [(1, 'x'), (2, 'y'), 0, 1, 2]


def test_of_several_all_combinations_run_and_each_runs_alone(monkeypatch):
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


def test_functions_are_called_by_their_names():
    def fails(check):
        raise AssertionError

    with pytest.raises(AssertionError, match='case check=small: '):
        for_each('check', [small])(fails)()


@pytest.mark.parametrize('fails', [ValueError, pytest.fail.Exception, AssertionError])
def test_the_first_case_that_fails_is_named(fails):
    ran = []

    def law(seed):
        ran.append(seed)
        if seed == 2:
            raise fails('no good')

    with pytest.raises(AssertionError, match='case seed=2: no good\nalone: --case seed=2'):
        for_each('seed', range(5))(law)()
    assert ran == [0, 1, 2]


def test_each_case_has_a_folder_of_its_own(tmp_path):
    for_each('seed', range(3))(lambda seed, tmp_path: (tmp_path / 'file').touch(exist_ok=False))(
        tmp_path=tmp_path
    )
    assert len(list(tmp_path.glob('*/file'))) == 3


def test_what_a_case_sets_is_undone_after_it(monkeypatch):
    def law(seed, monkeypatch):
        assert 'KBNITP_CASE' not in os.environ
        monkeypatch.setenv('KBNITP_CASE', str(seed))

    for_each('seed', range(2))(law)(monkeypatch=monkeypatch)
    assert 'KBNITP_CASE' not in os.environ


def test_the_first_of_every_so_many_cases_run_always_and_the_rest_as_full():
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
