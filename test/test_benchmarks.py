# SPDX-License-Identifier: Apache-2.0
"""The benchmarks measure what they say, and write it down."""

from importlib import import_module
from pathlib import Path
import sys

import pytest

FOLDER = Path(__file__).parents[1] / 'benchmarks'


@pytest.fixture
def load(monkeypatch):
    """Return a function that imports a file of benchmarks/ as the command does."""
    monkeypatch.syspath_prepend(str(FOLDER))
    before = set(sys.modules)
    yield import_module
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], '__file__', None) or '').parent == FOLDER:
            del sys.modules[name]


def test_all_are_listed_and_told_apart(load):
    command = load('run')
    titles = [each.title for each in command.BENCHMARKS]
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
    monkeypatch.setattr(command, 'PAGE', tmp_path / 'performance.md')
    assert command.main() == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[2:] == [
        '| A plan | small | 2 ms | 1 |',
        '| A plan | large | 500 ms | 250 |',
        '| An update | early | 3 µs | 1 |',
        '| An update | late | 2 s | 6.67e+05 |',
    ]
    page = (tmp_path / 'performance.md').read_text()
    assert '## A plan\n\nAll alike.\n\n| | takes | ratio |\n|---|---|---|\n| small' in page


def test_peers_get_the_same_posterior(load):
    peers = load('peers')
    assert peers.by_enumeration() == pytest.approx(peers.by_update(), rel=0, abs=peers.TOLERANCE)
