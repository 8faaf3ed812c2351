# SPDX-License-Identifier: Apache-2.0
"""The notebooks show what comes out when they are executed."""

import itertools
import json
import os
from pathlib import Path
import subprocess
import sys

from laws import for_each
import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted(ROOT.joinpath('docs/notebooks').glob('*.ipynb'))


@pytest.fixture(scope='module')
def executed(tmp_path_factory):
    """Return a folder with the notebooks as they come out now."""
    pytest.importorskip('nbclient', reason='notebooks are executed with the wheels only')
    folder = tmp_path_factory.mktemp('executed')
    ran = subprocess.run(
        [sys.executable, ROOT / 'tools/notebooks.py', folder],
        env={**os.environ, 'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'},
        text=True,
        capture_output=True,
    )
    assert ran.returncode == 0, ran.stderr
    return folder


def shown(path):
    """Return the cells of a notebook, and the texts and pictures that stand below each."""
    return [
        (cell['source'], cell.get('execution_count'), list(merged(cell['outputs'])))
        for cell in json.loads(path.read_text())['cells']
        if cell['cell_type'] == 'code'
    ]


def merged(outputs):
    """
    Yield what a cell puts out: its text and its kinds; pictures differ with a machine's fonts.

    A kernel sends what a cell prints in as many pieces as its timer happens to find.
    """
    for stream, group in itertools.groupby(outputs, lambda each: each.get('name')):
        if stream:
            yield ''.join(''.join(each['text']) for each in group), []
            continue
        for each in group:
            data = each.get('data', {})
            yield data.get('text/plain'), sorted(data)


@pytest.mark.processes
@pytest.mark.full
@for_each('path', NOTEBOOKS)
def test_a_notebook_shows_what_comes_out(path, executed):
    assert shown(path) == shown(executed / path.name), 'python3 tools/notebooks.py'


@for_each('name', ['mission_log', 'one_path'])
def test_a_notebook_shows_texts_and_pictures(name):
    outputs = [
        each for *_, outputs in shown(ROOT / f'docs/notebooks/{name}.ipynb') for each in outputs
    ]
    assert any('image/png' in kinds for _, kinds in outputs)
    assert any(text and not kinds for text, kinds in outputs)


def test_what_a_cell_prints_is_one_text_in_however_many_pieces():
    def stream(text, name='stdout'):
        return {'output_type': 'stream', 'name': name, 'text': text}

    picture = {'output_type': 'display_data', 'data': {'image/png': '', 'text/plain': ['one']}}
    pieces = [stream(['a\n', 'b\n']), stream(['c\n']), picture, stream(['d\n'])]
    whole = [stream(['a\n', 'b\n', 'c\n']), picture, stream(['d\n'])]
    assert list(merged(pieces)) == list(merged(whole))
    assert len(list(merged(whole))) == 3
    assert list(merged([stream('a'), stream('a', 'stderr')])) == [('a', []), ('a', [])]
