# SPDX-License-Identifier: Apache-2.0
"""What the README and the page of commands tell people to type works as it stands there."""

import os
from pathlib import Path
import re
import shlex
import signal
import subprocess
import sys
import time

from extent import FULL
from laws import for_each
import pytest

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[1]
PAGES = ('README.md', 'docs/commands.md')
TEXT = '\n'.join((ROOT / page).read_text() for page in PAGES)
BLOCKS = re.findall(r'```(\w+)\n(.*?)```', TEXT, re.S)
SHELL = [line for language, block in BLOCKS if language == 'bash' for line in block.splitlines()]
PYTHON = [block for language, block in BLOCKS if language == 'python']


def commands(*names):
    return [
        shlex.split(line)[1:]
        for line in SHELL
        if re.match(f'python3 -m kbnitp_ros ({"|".join(names)}) ', line)
    ]


def start(command, folder):
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'}
    return subprocess.Popen([sys.executable, *command], cwd=folder, env=environment)


# Smaller demos are in test/cli.
@pytest.mark.full
def test_the_demo_and_its_replay(tmp_path):
    typed = commands('demo', 'replay', 'report')
    assert [words[2] for words in typed] == [
        'demo', 'report', 'replay', 'demo', 'demo', 'replay',
    ]  # fmt: skip
    for command in typed:
        # Of an option that is given twice the last counts.
        fewer = ['--robots', '3'] if '--robots' in command and not FULL else []
        assert start([*command, *fewer], tmp_path).wait(timeout=300) == 0


@pytest.mark.full
def test_the_study_starts(tmp_path):
    (command,) = commands('study')
    study = start(command, tmp_path)
    out = tmp_path / command[command.index('--out') + 1]
    deadline = time.monotonic() + 120
    while not list(out.glob('trials/*.npz')) and time.monotonic() < deadline:
        time.sleep(0.1)
    study.send_signal(signal.SIGINT)
    assert study.wait(timeout=180) == 130
    assert list(out.glob('trials/*.npz'))


@pytest.mark.full
def test_the_forecast(tmp_path):
    (command,) = commands('forecast')
    assert start([*command, '--worlds', '2'], tmp_path).wait(timeout=300) == 0
    assert (tmp_path / command[command.index('--out') + 1] / 'forecast.csv').exists()


@for_each('snippet', PYTHON)
def test_the_python_example(snippet):
    printed = subprocess.run(
        [sys.executable, '-c', snippet], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert snippet.endswith(f'# {printed}')


def test_the_readme_is_short_and_so_are_its_sentences():
    text = (ROOT / 'README.md').read_text()
    assert len(text.split()) <= 900
    prose = re.sub(r'```.*?```|^\|.*?$|^#.*?$', '', text, flags=re.S | re.M)
    sentences = re.split(r'(?<=[.:;?])\s+|\n\s*\n', prose)
    assert [each for each in sentences if len(each.split()) > 30] == []
