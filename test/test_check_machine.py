# SPDX-License-Identifier: Apache-2.0
"""`make build` says in one line what the machine lacks."""

from pathlib import Path
import subprocess
import tempfile

from laws import for_each
import pytest

pytestmark = pytest.mark.processes

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
    ):
        tools = {
            'cc': 'true',
            'c++': 'true',
            'cmake': 'true',
            'uname': f'echo {system}',
            'python3': FAKE_PYTHON.format(version=version, venv=venv, include=include),
        }
        there = tempfile.mkdtemp(dir=tmp_path)
        for name in tools.keys() - {without}:
            Path(there, name).write_text(f'#!/bin/sh\n{tools[name]}\n')
            Path(there, name).chmod(0o755)
        return subprocess.run(
            ['/bin/sh', SCRIPT, python], env={'PATH': there}, capture_output=True, text=True
        )

    return check


@for_each('version', ['3.10', '3.11', '3.12', '3.13'])
def test_a_machine_with_everything_is_accepted_in_silence(machine, version):
    done = machine(version=version)
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')


@for_each('lack, missing, remedy', [
    ({'without': 'cc'}, 'C compiler', 'apt install g++'),
    ({'without': 'c++'}, 'C++ compiler', 'apt install g++'),
    ({'without': 'cmake'}, 'cmake', 'apt install cmake'),
    ({'venv': 1}, 'venv', 'apt install python3.12-venv'),
    ({'include': '/nowhere'}, '/nowhere/Python.h', 'apt install python3.12-dev'),
    ({'python': 'python9'}, 'python9', 'apt install python3'),
    ({'version': '3.9'}, '3.9', 'make PYTHON='),
    ({'version': '3.14'}, '3.14', 'make PYTHON='),
    ({'system': 'Darwin arm64'}, 'Darwin arm64', 'colcon build'),
    ({'version': '2.7'}, '2.7', 'make PYTHON='),
])  # fmt: skip
def test_what_is_missing_takes_one_line_with_its_remedy(machine, lack, missing, remedy):
    done = machine(**lack)
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1
    assert missing in done.stderr
    assert remedy in done.stderr
