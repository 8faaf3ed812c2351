# SPDX-License-Identifier: Apache-2.0
"""A signal ends every executable well, also while it starts."""

from itertools import product
import os
from pathlib import Path
import signal
import subprocess
import sys

from ament_index_python.packages import get_package_prefix
from kbnitp_ros.starting import EXECUTABLES, EXTRAS, NODES
from laws import for_each
import pytest

pytestmark = pytest.mark.processes

# Stands for a library that takes long to import, which all need.
SLOW = """
import time
print('importing', flush=True)
time.sleep(60)
"""

INSTALLED = Path(get_package_prefix('kbnitp_ros'), 'lib', 'kbnitp_ros')


def test_a_middleware_that_is_not_installed_is_named():
    env = {**os.environ, 'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}
    for name in sorted({*EXECUTABLES} - {*EXTRAS}):
        command = [sys.executable, '-m', 'kbnitp_ros', name]
        ended = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
        assert (ended.returncode, ended.stdout) == (2, '')
        assert ended.stderr == (
            f"{name}: RMW_IMPLEMENTATION is 'rmw_cyclonedds_cpp', which is not installed: install "
            'it, or name one of rmw_fastrtps_cpp\n'
        )


@for_each(
    'number, name, is_installed',
    product([signal.SIGINT, signal.SIGTERM], EXECUTABLES, [False, True]),
)
def test_a_signal_while_it_imports_ends_it_without_a_traceback(
    tmp_path, number, name, is_installed
):
    tmp_path.joinpath('numpy.py').write_text(SLOW)
    command = [INSTALLED / name] if is_installed else [sys.executable, '-m', 'kbnitp_ros', name]
    path = os.pathsep.join([str(tmp_path), os.environ['PYTHONPATH']])
    started = subprocess.Popen(
        command,
        env={**os.environ, 'PYTHONPATH': path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert started.stdout.readline() == 'importing\n'
    started.send_signal(number)
    said, complained = started.communicate(timeout=60)
    assert started.returncode == (0 if name in NODES else 128 + number)
    assert said + complained == ''
