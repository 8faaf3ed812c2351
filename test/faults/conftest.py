# SPDX-License-Identifier: Apache-2.0
"""Missions of real nodes for tests that inject faults."""

from contextlib import ExitStack

from forked import COVERED, ForkedProcesses
from kbnitp_ros.cli.processes import environment, free_domain, Processes
from mission import Mission
import pytest


@pytest.fixture(scope='session')
def processes(server):
    """Return the class that starts nodes: forked where possible."""
    return Processes if COVERED else ForkedProcesses


@pytest.fixture
def set_out(processes, tmp_path, monkeypatch):
    """Return a function that makes a mission on a free domain, with no node started."""
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        for name, value in environment(domain).items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'ros_log'))
        yield lambda parameters, **others: stack.enter_context(
            Mission(domain, tmp_path, parameters, processes=processes, **others)
        )
