# SPDX-License-Identifier: Apache-2.0
"""Missions to record, made once."""

from mission_log import mission
import pytest


@pytest.fixture(scope='session')
def whole_mission():
    """Return a mission of 8 robots; not to be changed."""
    return mission()
