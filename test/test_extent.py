# SPDX-License-Identifier: Apache-2.0
"""What takes long is tested when all is asked for, and a wish that is misspelt is refused."""

import os
from pathlib import Path
import subprocess
import sys

from extent import VARIABLE
import pytest

TESTS = """
import pytest
from extent import FULL


@pytest.mark.full
def test_long():
    assert FULL


def test_short():
    print(f'all: {FULL}')
"""


@pytest.mark.parametrize(
    'asked, status, told',
    [
        ('', 0, '1 passed, 1 skipped'),
        ('full', 0, '2 passed'),
        ('ful', 4, f"{VARIABLE} is 'ful': it must be full, or not be set"),
    ],
)
def test_all_is_tested_if_asked_for(tmp_path, asked, status, told):
    folder = Path(__file__).parent
    for name in ('conftest.py', 'extent.py'):
        tmp_path.joinpath(name).write_text(folder.joinpath(name).read_text())
    tmp_path.joinpath('test_all.py').write_text(TESTS)
    tmp_path.joinpath('pytest.ini').write_text('[pytest]\nmarkers =\n    full: long\n')
    tested = subprocess.run(
        [sys.executable, '-m', 'pytest', '-p', 'no:cacheprovider'],
        cwd=tmp_path,
        env={**os.environ, VARIABLE: asked},
        capture_output=True,
        text=True,
    )
    assert tested.returncode == status
    assert told in tested.stdout + tested.stderr
