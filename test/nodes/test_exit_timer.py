# SPDX-License-Identifier: Apache-2.0
"""A process that cannot end by itself is ended with the exit code it would have had."""

import subprocess
import sys

from kbnitp_ros.cli.processes import environment, free_domain
import pytest

pytestmark = pytest.mark.processes

# Waits for good, and lets no other Python run meanwhile.
STUCK = """
import ctypes
from kbnitp_ros.nodes.runtime.exit_timer import exit_at_the_latest
with exit_at_the_latest(0.1, {code}):
    ctypes.PyDLL(None).pause()
"""

IN_TIME = """
import time
from kbnitp_ros.nodes.runtime.exit_timer import exit_at_the_latest
with exit_at_the_latest(0.1, 3):
    pass
time.sleep(0.3)
"""


@pytest.mark.parametrize('code', [0, 1, 2])
def test_a_process_that_is_stuck_ends(code):
    ended = subprocess.run([sys.executable, '-c', STUCK.format(code=code)], timeout=60)
    assert ended.returncode == code


def test_a_process_that_is_in_time_goes_on():
    assert subprocess.run([sys.executable, '-c', IN_TIME], timeout=60).returncode == 0


def test_a_node_that_cannot_leave_the_graph_ends_as_it_would_have():
    program = """
import ctypes, os, signal
from kbnitp_ros.nodes import estimator
from kbnitp_ros.nodes.runtime import process
process.TEARDOWN = 0.2
estimator.EstimatorNode.destroy_node = lambda self: ctypes.PyDLL(None).pause()
estimator.EstimatorNode.create_poll = lambda self, look: os.kill(os.getpid(), signal.SIGTERM)
estimator.main()
"""
    with free_domain() as domain:
        ended = subprocess.run(
            [sys.executable, '-c', program],
            env=environment(domain),
            timeout=60,
            capture_output=True,
        )
    assert ended.returncode == 0, ended.stderr
