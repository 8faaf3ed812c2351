#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""
Check names and docstrings by the rules of CONTRIBUTING.md, "How we write".

``python3 tools/prose.py`` prints what breaks them, and exits with 1 if anything does. ``python3
tools/prose.py --sample SEED`` prints docstrings, comments, console texts and sentences to read.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator
from pathlib import Path
import random
import re
import sys
import tokenize

ROOT = Path(__file__).parents[1]
CODE = ('kbnitp_ros', 'test', 'tools', 'benchmarks', 'launch')

OPENINGS = re.compile(
    r'(what|which|whether|those|one that|who|all that|all who|have) ', re.IGNORECASE
)
CONSTANT = re.compile(r'_?(MOST|LARGEST|LONGEST)(_\w+)?$')

# Numbers of docstrings and comments, of console texts, and of sentences of docs in a sample.
SAMPLE = 100, 60, 60

Text = tuple[Path, int, str]


def modules(*folders: str) -> Iterator[tuple[Path, ast.Module]]:
    """Yield the Python files in some folders, parsed."""
    for folder in folders:
        for path in sorted((ROOT / folder).rglob('*.py')):
            if 'node_modules' not in path.parts:
                yield path, ast.parse(path.read_text())


def docstrings(path: Path, tree: ast.Module) -> Iterator[Text]:
    """Yield the docstrings of a file."""
    kinds = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
    for node in ast.walk(tree):
        if isinstance(node, kinds) and (text := ast.get_docstring(node)):
            yield path, node.body[0].lineno, text


def comments(path: Path) -> Iterator[Text]:
    """Yield the comments of a file, those on lines that follow each other as one."""
    before = -1
    text: list[str] = []
    with path.open('rb') as file:
        for token in tokenize.tokenize(file.readline):
            if token.type == tokenize.COMMENT and not token.string.startswith('# SPDX'):
                if text and token.start[0] != before + 1:
                    yield path, before, ' '.join(text)
                    text = []
                text.append(token.string.lstrip('# '))
                before = token.start[0]
    if text:
        yield path, before, ' '.join(text)


def console(path: Path, tree: ast.Module) -> Iterator[Text]:
    """Yield texts of at least six words that are no docstrings, with {} for what is inserted."""
    known = {text for _, _, text in docstrings(path, tree)}
    joined = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    parts = {id(part) for node in joined for part in node.values}
    for node in ast.walk(tree):
        text = ''
        if isinstance(node, ast.JoinedStr):
            values = [getattr(part, 'value', None) for part in node.values]
            text = ''.join(value if isinstance(value, str) else '{}' for value in values)
        elif isinstance(node, ast.Constant) and id(node) not in parts:
            text = str(node.value)
        if len(text.split()) >= 6 and '\n' not in text and text not in known:
            yield path, node.lineno, text


def sentences(path: Path) -> Iterator[Text]:
    """Yield the sentences of a page of docs."""
    prose = re.sub(r'```.*?```|^[|#!:-].*?$|^    .*?$', '', path.read_text(), flags=re.S | re.M)
    for sentence in re.split(r'(?<=[.:;?])\s+|\n\s*\n', prose):
        if len(sentence.split()) >= 5:
            yield path, 0, ' '.join(sentence.split())


def broken() -> Iterator[Text]:
    """Yield what breaks the rules, by name."""
    for path, tree in modules(*CODE):
        for _, line, text in docstrings(path, tree):
            if OPENINGS.match(text):
                yield path, line, f'docstring begins {" ".join(text.split()[:3])!r}'
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name.endswith('_of'):
                if not node.name.startswith('test_'):
                    yield path, node.lineno, f'function {node.name}: name it by a verb or a noun'
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                if CONSTANT.match(node.id):
                    yield path, node.lineno, f'constant {node.id}: name it MAX_...'
            elif isinstance(node, ast.For) and getattr(node.target, 'id', '') == 'each':
                yield path, node.lineno, 'loop variable each: name it by its noun'


def sample(seed: str) -> Iterator[Text]:
    """Draw docstrings and comments, console texts, and sentences."""
    rng = random.Random(seed)
    parsed = list(modules('kbnitp_ros'))
    words = [text for path, tree in parsed for text in docstrings(path, tree)]
    words += [text for path, _ in parsed for text in comments(path)]
    said = [text for path, tree in parsed for text in console(path, tree)]
    pages = [page for page in sorted(ROOT.glob('docs/**/*.md')) if page.parent.name != 'tables']
    told = [text for page in [ROOT / 'README.md', *pages] for text in sentences(page)]
    for texts, count in zip((words, said, told), SAMPLE):
        yield from rng.sample(texts, count)


def main() -> int:
    """Print what breaks the rules, or a sample; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--sample', metavar='SEED', help='print a sample to read')
    seed = parser.parse_args().sample
    found = list(broken() if seed is None else sample(seed))
    for path, line, text in found:
        print(f'{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}')
    return int(bool(found) and seed is None)


if __name__ == '__main__':
    sys.exit(main())
