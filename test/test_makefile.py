# SPDX-License-Identifier: Apache-2.0
"""Checks of machines and installations print few lines, each with a remedy."""

import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

from laws import for_each
import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.processes
@for_each('folder, variables, first', [
    ('of mine', {}, 'Messages cannot be built in the folder'),
    ('field', {'ROS_DISTRO': 'jazzy'}, '*** ROS 2 jazzy is sourced'),
])  # fmt: skip
def test_make_begins_with_a_refusal(tmp_path, folder, variables, first):
    here = tmp_path / folder
    here.mkdir()
    for name in ('Makefile', 'requirements', 'tools'):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, here / name)
    made = subprocess.run(
        ['make', '--always-make', '.venv/.run'],
        cwd=here,
        env={'PATH': os.environ['PATH'], **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    assert made.returncode == 2
    assert first in made.stdout.decode().splitlines()[0]


GOOD = 'numba==0.1 \\\n    --hash=sha256:' + 64 * '0'


@pytest.mark.processes
@pytest.mark.skipif(not ROOT.joinpath('.tools').exists(), reason='uv is not installed')
@for_each('text, reason, line', [
    (f'# Lock\n{GOOD}\n<<<<<<< HEAD\n', '', 'line 4: <<<<<<< HEAD'),
    (f'# Lock\n{GOOD[:-1]}\n', '', 'line 3: --hash=sha256:'),
    (f'# Lock\n{GOOD}\n', 'numba was not found', 'line 2: numba==0.1'),
])  # fmt: skip
def test_a_line_that_does_not_fit_is_named(tmp_path, text, reason, line):
    lock = tmp_path / 'run.lock'
    lock.write_text(text)
    command = [sys.executable, ROOT / 'tools/install.py', lock]
    environment = {**os.environ, 'PIP_NO_INDEX': '1'}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert reason in done.stdout
    assert f'{lock}, {line}' in done.stdout


SCRIPT = Path(__file__).parents[1] / 'tools' / 'check_machine.sh'

# A Python of any version, with or without some of its parts.
FAKE_PYTHON = """
case $2 in
  *version_info*) echo {version} ;;
  *venv*) exit {venv} ;;
  *sysconfig*) echo {include} ;;
esac
"""


@pytest.fixture
def machine(tmp_path):
    """Return a function that runs the script on a machine with these tools and this Python."""
    headers = tmp_path / 'include'
    headers.mkdir()
    headers.joinpath('Python.h').touch()

    def check(
        without=None,
        system='Linux x86_64',
        python='python3',
        version='3.12',
        venv=0,
        include=headers,
        folder='kbnitp_ros',
        free=1200,
    ):
        tools = {
            'cc': 'true',
            'c++': 'true',
            'df': f'echo on; echo disk 9 9 {free * 1024} 9%',
            'uname': f'echo {system}',
            'python3': FAKE_PYTHON.format(version=version, venv=venv, include=include),
        }
        there = tempfile.mkdtemp(dir=tmp_path)
        for name in tools.keys() - {without}:
            Path(there, name).write_text(f'#!/bin/sh\n{tools[name]}\n')
            Path(there, name).chmod(0o755)
        here = Path(there, folder)
        here.mkdir()
        return subprocess.run(
            ['/bin/sh', SCRIPT, python, '1200'],
            cwd=here,
            env={'PATH': there},
            capture_output=True,
            text=True,
        )

    return check


@pytest.mark.processes
@for_each('version', ['3.10', '3.11', '3.12', '3.13'])
def test_a_complete_machine_is_accepted_silently(machine, version):
    done = machine(version=version)
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')


@pytest.mark.processes
@for_each('lack, missing, remedy', [
    ({'without': 'cc'}, 'C compiler', 'apt install g++'),
    ({'without': 'c++'}, 'C++ compiler', 'apt install g++'),
    ({'folder': 'of mine'}, 'of mine', 'Move this folder'),
    ({'folder': 'räume'}, 'räume', 'Move this folder'),
    ({'free': 1199}, '1199 MB free, and 1200 MB', 'free some space'),
    ({'venv': 1}, 'venv', 'apt install python3.12-venv'),
    ({'include': '/nowhere'}, '/nowhere/Python.h', 'apt install python3.12-dev'),
    ({'python': 'python9'}, 'python9', 'apt install python3'),
    ({'version': '3.9'}, '3.9', 'make PYTHON='),
    ({'version': '3.14'}, '3.14', 'make PYTHON='),
    ({'system': 'Darwin arm64'}, 'Darwin arm64', 'colcon build'),
    ({'version': '2.7'}, '2.7', 'make PYTHON='),
])  # fmt: skip
def test_missing_parts_take_one_line_with_a_remedy(machine, lack, missing, remedy):
    done = machine(**lack)
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1
    assert missing in done.stderr
    assert remedy in done.stderr
