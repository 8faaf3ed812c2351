# SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled if possible, and run uncompiled if not."""

import ast
import os
from pathlib import Path
import pickle
import re
import shutil
import subprocess
import sys

import kbnitp_ros.core
from laws import for_each
import numba
import pytest

pytestmark = pytest.mark.processes

CORE = Path(kbnitp_ros.core.__file__).parent

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


# Lines of the package on stderr.
TOLD = re.compile('RuntimeWarning|^compiling')
ANNOUNCED = 'compiling kernels, which takes up to half a minute'


def run(source, file='kernel.py', folder=None, before='', **environment):
    path = folder / file
    # Files without a code change keep their compiled code.
    if not path.exists():
        path.write_text(source)
    code = f'{before}\nimport runpy; runpy.run_path({str(path)!r})'
    done = subprocess.run(
        [sys.executable, '-c', code],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    warnings = [line for line in done.stderr.splitlines() if TOLD.search(line)]
    return done.stdout.split(), warnings


def test_compilation_can_be_switched_off(tmp_path):
    printed, warnings = run(KERNEL, folder=tmp_path, NUMBA_DISABLE_JIT='1')
    assert printed == ['0.5', '1.0', 'function']
    assert not warnings


def test_kernels_run_interpreted_on_request(tmp_path):
    asked = KERNEL.replace('import compiled', 'import compiled, interpreted').replace(
        'print(', 'import sys\nwith interpreted():\n    print('
    )
    printed, _ = run(f"{asked}\nprint('numba' in sys.modules)", folder=tmp_path)
    assert printed == ['0.5', '1.0', 'Compiled', 'False']


def test_a_missing_numba_is_reported_once(tmp_path):
    # None in sys.modules: the module cannot be imported.
    printed, warnings = run(
        KERNEL, folder=tmp_path, before="import sys; sys.modules['numba'] = None"
    )
    assert printed[:2] == ['0.5', '1.0']
    assert len(warnings) == 1
    assert 'pip install' in warnings[0]


def test_code_without_a_cache_is_compiled_at_every_start(tmp_path):
    # Functions of a file that does not exist have no cache folder.
    nowhere = f'exec(compile({KERNEL!r}, "/nowhere/kernel.py", "exec"))'
    printed, warnings = run(nowhere, folder=tmp_path)
    assert printed == ['0.5', '1.0', 'CPUDispatcher']
    assert 'NUMBA_CACHE_DIR' in warnings[0]


# What a power loss, or another program, leaves of a file; None: a folder.
TORN = {
    'half': lambda whole: whole[: len(whole) // 2],
    'empty': lambda whole: b'',
    'a folder': None,
    'noise': lambda whole: bytes(range(256)) * 8,
    'other': lambda whole: pickle.dumps(numba.__version__) + pickle.dumps('no index'),
}


@for_each('torn', TORN, every=5)
def test_compilation_is_announced_once_and_torn_files_are_compiled_anew(tmp_path, torn):
    kept = tmp_path / 'kept'
    environment = {'folder': tmp_path, 'NUMBA_CACHE_DIR': str(kept)}
    compiled = ['0.5', '1.0', 'CPUDispatcher']
    assert run(KERNEL, **environment) == (compiled, [ANNOUNCED])
    (index,) = kept.glob('*/kernel.half-*.nbi')
    (data,) = kept.glob('*/kernel.third-*.nbc')
    for file in (index, data):
        whole = file.read_bytes()
        file.unlink()
        if TORN[torn]:
            file.write_bytes(TORN[torn](whole))
        else:
            file.mkdir()
    printed, (warning, announced) = run(KERNEL, **environment)
    assert (printed, announced) == (compiled, ANNOUNCED)
    assert str(index.parent) in warning
    assert run(KERNEL, **environment) == (compiled, [])


def test_a_full_disk_is_reported_and_kernels_run(tmp_path):
    full = 'import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))'
    full += '; import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)'
    printed, warnings = run(KERNEL, folder=tmp_path, before=full, NUMBA_CACHE_DIR=str(tmp_path))
    assert printed == ['0.5', '1.0', 'CPUDispatcher']
    assert 'File too large' in warnings[-1]


CHANGED = """
from kbnitp_ros.core.planning.label_kernels import surprisal
print(surprisal(0.5))
"""


@pytest.mark.full
def test_changed_sources_are_compiled_anew(tmp_path):
    """Also if another kernel file changes than the called kernel's."""
    without = shutil.ignore_patterns('__pycache__')
    shutil.copytree(CORE.parent, tmp_path / 'kbnitp_ros', ignore=without)
    before = f'import sys; sys.path.insert(0, {str(tmp_path)!r})'
    environment = {'folder': tmp_path, 'before': before, 'NUMBA_CACHE_DIR': ''}
    printed = [run(CHANGED, **environment)[0] for _ in range(2)]
    folders = sorted(tmp_path.glob('kbnitp_ros/__pycache__/kernels-*'))
    assert (len(folders), printed[0]) == (1, printed[1])
    other = tmp_path / 'kbnitp_ros' / 'core' / 'planning' / 'information_kernels.py'
    other.write_text(other.read_text() + '# changed')
    run(CHANGED, **environment)
    assert len(sorted(tmp_path.glob('kbnitp_ros/__pycache__/kernels-*'))) == 2


def test_inlined_kernels_return_no_arrays():
    # numba itself refuses kernels that make arrays.
    returned = {
        kernel.name: ast.unparse(kernel.returns)
        for path in CORE.rglob('*_kernels.py')
        for kernel in ast.parse(path.read_text()).body
        if isinstance(kernel, ast.FunctionDef)
        and 'inlined' in map(ast.unparse, kernel.decorator_list)
    }
    assert set(returned.values()) == {'float', 'int', 'None'}
