# SPDX-License-Identifier: Apache-2.0
"""What the system refuses is told by file and reason, without its number."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    'command, told',
    [
        ('demo --out /proc/here', 'demo: folder /proc/here cannot be made (No such file or '),
        ('demo --resume nothere.mcap', 'demo: nothere.mcap'),
        ('demo --params nothere.yaml', 'demo: parameter file nothere.yaml: No such file or '),
        ('demo --set world.file=nothere.yaml', 'demo: nothere.yaml: No such file or directory'),
        ('replay nothere.mcap', 'replay: nothere.mcap'),
        ('replay nothere.mcap --repair /proc/here/a.mcap', 'replay: '),
        ('study nothere.yaml --out runs', 'study: scenario nothere.yaml is no file'),
        ('study paper --out /proc/here', 'study: /proc/here: No such file or directory'),
        ('recorder --ros-args -p file:=/proc/here/a.mcap', 'recorder: /proc/here/a.mcap: No such'),
        ('recorder --ros-args -p resume:=nothere.mcap', 'recorder: nothere.mcap'),
        ('agent --ros-args -p world.file:=nothere.yaml', 'agent: nothere.yaml: No such file'),
    ],
)
def test_no_number_of_an_error_is_told(tmp_path, command, told):
    done = subprocess.run(
        [sys.executable, '-m', 'kbnitp_ros', *command.split()],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert told in done.stderr
    assert 'Errno' not in done.stderr
    assert 'Traceback' not in done.stderr
