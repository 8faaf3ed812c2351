# SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled where they can be, and run anyway where not."""

import os
import subprocess
import sys

import pytest

KERNEL = """
from kbnitp_ros.core.field.compiled import compiled

@compiled
def half(x):
    return x / 2

@compiled
def third(x):
    return x / 3

print(half(1.0), third(3.0), type(half).__name__)
"""


def run(source, file='kernel.py', folder=None, before='', **environment):
    """Run the kernels in a process of its own; return what it printed and what it warned of."""
    path = folder / file
    path.write_text(source)
    code = f'{before}\nimport runpy; runpy.run_path({str(path)!r})'
    done = subprocess.run(
        [sys.executable, '-c', code],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    warnings = [line for line in done.stderr.splitlines() if 'RuntimeWarning' in line]
    return done.stdout.split(), warnings


def test_kernels_are_compiled(tmp_path):
    assert run(KERNEL, folder=tmp_path) == (['0.5', '1.0', 'CPUDispatcher'], [])


def test_the_first_compilation_is_told_of_once(tmp_path):
    path = tmp_path / 'kernel.py'
    path.write_text(KERNEL)
    told = []
    for _ in range(2):
        done = subprocess.run([sys.executable, path], capture_output=True, text=True, check=True)
        told.append(done.stderr)
    assert told == ['kernels are compiled for the first time, which takes up to a minute\n', '']


def test_compilation_can_be_switched_off(tmp_path):
    printed, warnings = run(KERNEL, folder=tmp_path, NUMBA_DISABLE_JIT='1')
    assert printed == ['0.5', '1.0', 'function']
    assert not warnings


@pytest.mark.parametrize(
    'before, remedy',
    [
        # A module that is None in sys.modules cannot be imported.
        ("import sys; sys.modules['numba'] = None", 'pip install'),
        ("import numba; numba.__version__ = '0.7.0'", 'NUMBA_DISABLE_JIT'),
    ],
)
def test_a_numba_that_is_missing_or_unknown_is_told_once(tmp_path, before, remedy):
    printed, warnings = run(KERNEL, folder=tmp_path, before=before)
    assert printed[:2] == ['0.5', '1.0']
    assert len(warnings) == 1
    assert remedy in warnings[0]


def test_code_that_can_be_kept_nowhere_is_interpreted(tmp_path):
    # Functions of a file that does not exist have no folder for their code.
    nowhere = f'exec(compile({KERNEL!r}, "/nowhere/kernel.py", "exec"))'
    printed, warnings = run(nowhere, folder=tmp_path)
    assert printed == ['0.5', '1.0', 'function']
    assert len(warnings) == 1
    assert 'NUMBA_CACHE_DIR' in warnings[0]
