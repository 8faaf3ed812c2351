# SPDX-License-Identifier: Apache-2.0
"""`python3 -m kbnitp_ros NAME` finds the command."""

import subprocess
import sys

from kbnitp_ros import __main__ as commands
import pytest


def test_the_rest_of_the_line_goes_to_the_command(monkeypatch, tmp_path):
    tmp_path.joinpath('echo_command.py').write_text('def main(argv=None):\n    return argv\n')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(commands.COMMANDS, 'echo', 'echo_command')
    assert commands.main(['echo', '--help', 'b']) == ['--help', 'b']


@pytest.mark.parametrize(
    'arguments, status', [([], 2), (['fly'], 2), (['--help'], 0), (['-h'], 0)], ids=str
)
def test_the_names_are_listed(arguments, status):
    done = subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', *arguments], capture_output=True, text=True
    )
    assert done.returncode == status
    told = done.stderr if status else done.stdout
    assert all(name in told for name in commands.COMMANDS)


def test_an_unknown_name_is_named(capsys):
    assert commands.main(['fly']) == 2
    assert "'fly'" in capsys.readouterr().err


def test_nothing_is_imported_before_its_name_is_known():
    program = 'import sys, kbnitp_ros.__main__; sys.exit("rclpy" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', program]).returncode == 0
