# SPDX-License-Identifier: Apache-2.0
"""The code cites the equations of docs/mathematics.md, by labels that stand there."""

import ast
from collections import Counter
from functools import cache
import re

from documented import ROOT

LABELS = re.findall(r'^ *:label: (\S+)$', (ROOT / 'docs/mathematics.md').read_text(), re.MULTILINE)
CITATION = re.compile(r':eq:`([^`]*)`')


def citations(source):
    """Yield the labels that the docstrings of a module cite, with what cites them."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, documented):
            for label in CITATION.findall(ast.get_docstring(node) or ''):
                yield label, getattr(node, 'name', 'module')


@cache
def cited():
    """Return all (label, what cites it) of the package."""
    return {
        (label, f'{path.relative_to(ROOT)}: {name}')
        for path in sorted((ROOT / 'kbnitp_ros').rglob('*.py'))
        for label, name in citations(path.read_text())
    }


def test_a_citation_is_found_in_any_docstring():
    source = (
        '"""Equation :eq:`a`."""\n'
        'class C:\n'
        '    """C."""\n'
        '    def f(self):\n'
        '        """Equations :eq:`b`, :eq:`c`."""\n'
        'text = ":eq:`d`"\n'
    )
    assert list(citations(source)) == [('a', 'module'), ('b', 'f'), ('c', 'f')]


def test_each_label_stands_once():
    assert [label for label, times in Counter(LABELS).items() if times > 1] == []


def test_what_is_cited_stands_in_the_page():
    assert sorted(each for each in cited() if each[0] not in LABELS) == []


def test_every_numbered_equation_is_cited_by_what_computes_it():
    assert sorted(set(LABELS) - {label for label, _ in cited()}) == []
