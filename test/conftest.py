# SPDX-License-Identifier: Apache-2.0
"""Which tests run: those of the marker `full` only when all are asked for; and how they draw."""

import os
from pathlib import Path

import extent
from hypothesis import HealthCheck, settings
import pytest

# Folders whose tests mostly start processes, and take seconds.
PROCESSES = ('cli', 'faults', 'nodes', 'plugins', Path(__file__).parent.name)

# How long something takes is the machine's affair.
settings.register_profile('busy', deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('busy')


def pytest_configure():
    """Refuse a misspelt wish for all tests, which would run less than was meant."""
    if (asked := os.environ.get(extent.VARIABLE, '')) not in ('', 'full'):
        raise pytest.UsageError(f'{extent.VARIABLE} is {asked!r}: it must be full, or not be set')


def pytest_collection_modifyitems(items):
    """
    Skip the tests of the marker `full` unless all are asked for.

    Tests of processes come first, so that several workers end at about the same time.
    """
    items.sort(key=lambda item: item.path.parent.name not in PROCESSES)
    if extent.FULL:
        return
    skip = pytest.mark.skip(reason=f'only with {extent.VARIABLE}=full')
    for item in items:
        if item.get_closest_marker('full'):
            item.add_marker(skip)
