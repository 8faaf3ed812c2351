# SPDX-License-Identifier: Apache-2.0
"""What the tutorials tell people to type works as it stands there, block after block."""

import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[1]
PAGES = ROOT / 'docs/tutorials'
BLOCK = re.compile(r'^```(\w+)\n(.*?)^```', re.MULTILINE | re.DOTALL)


def follow(page, folder):
    """Do what a page says, block after block, in a folder."""
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'}
    printed = ''
    for language, block in BLOCK.findall(page.read_text()):
        file = re.match(r'# (\w+\.\w+)\n', block)
        if language == 'text':
            assert block in printed
        elif language in ('bash', 'python'):
            program = ['bash', '-e'] if language == 'bash' else [sys.executable, '-']
            ran = subprocess.run(
                program, input=block, cwd=folder, env=environment, text=True, capture_output=True
            )
            assert ran.returncode == 0, ran.stderr
            printed = ran.stdout
        else:
            assert file, f'nobody reads a block that begins {block[:40]!r}'
        if file and language != 'text':
            folder.joinpath(file[1]).write_text(block)


# Missions over DDS take a while; the other tests run the same commands with other values.
@pytest.mark.full
@pytest.mark.parametrize('name', sorted(page.stem for page in PAGES.glob('*.md')))
def test_a_tutorial(name, tmp_path):
    follow(PAGES / f'{name}.md', tmp_path)
