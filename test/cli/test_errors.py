# SPDX-License-Identifier: Apache-2.0
"""What the system refuses is said with the file and the reason, without its number."""

import subprocess
import sys

from kbnitp_ros.__main__ import main
from laws import for_each
import pytest


def see_that_it_is_in_words(code, told, said):
    assert code == 2
    assert said in told
    assert 'Errno' not in told
    assert 'Traceback' not in told


@for_each('command, said', [
    ('demo --out /proc/here', 'demo: folder /proc/here cannot be made (No such file or '),
    ('demo --resume nothere.mcap', 'demo: nothere.mcap cannot be gone on with: No such file'),
    ('demo --params nothere.yaml', 'demo: parameter file nothere.yaml: No such file or '),
    ('demo --set world.file=nothere.yaml', 'demo: nothere.yaml: No such file or directory'),
    ('replay nothere.mcap', 'replay: nothere.mcap cannot be read: No such file or directory'),
    ('replay nothere.mcap --repair /proc/here/a.mcap', 'replay: /proc/here: No such file'),
    ('study nothere.yaml --out runs', 'study: scenario nothere.yaml is no file'),
    ('study paper --out /proc/here', 'study: /proc/here: No such file or directory'),
])  # fmt: skip
def test_no_command_says_the_number_of_an_error(tmp_path, monkeypatch, capsys, command, said):
    monkeypatch.chdir(tmp_path)
    see_that_it_is_in_words(main(command.split()), capsys.readouterr().err, said)


@pytest.mark.processes
@for_each('command, said', [
    ('recorder --ros-args -p file:=/proc/here/a.mcap', 'recorder: folder /proc/here cannot be'),
    ('agent --ros-args -p world.file:=nothere.yaml', 'agent: nothere.yaml: No such file'),
])  # fmt: skip
def test_no_node_says_the_number_of_an_error(tmp_path, command, said):
    ended = subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', *command.split()],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    see_that_it_is_in_words(ended.returncode, ended.stderr, said)
