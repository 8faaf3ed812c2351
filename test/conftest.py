# SPDX-License-Identifier: Apache-2.0
"""Which tests run, which of them may start processes, and how they draw."""

from multiprocessing import forkserver
import os
import shutil
import sys

import extent
from hypothesis import HealthCheck, settings
import laws
import pytest

# Of numpy, which is not imported yet: tests run side by side, and threads would wait in vain.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# Fixtures that start processes, so that the tests that ask for them are marked `processes`.
STARTERS = {'browser', 'field', 'set_out'}

# What Python's audit hooks call the start of a process.
STARTS = {'os.fork', 'os.forkpty', 'os.posix_spawn', 'os.spawn', 'os.system', 'subprocess.Popen'}

# What pages are shown in.
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)

# How long something takes is the machine's affair.
settings.register_profile('busy', deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('busy')


# The test without the marker `processes` that runs now.
_without_processes = None


def _refuse_processes(event, _):
    if event in STARTS and _without_processes is not None:
        pytest.fail(f'{_without_processes} starts a process: mark it with pytest.mark.processes')


sys.addaudithook(_refuse_processes)


def pytest_addoption(parser):
    """Let one case of a law run alone."""
    parser.addoption(
        '--case', help='run this case of laws alone, as its failure names it, or those of a value'
    )


def pytest_configure(config):
    """Refuse a misspelt wish for all tests, which would run less than was meant."""
    if (asked := os.environ.get(extent.VARIABLE, '')) not in ('', 'full'):
        raise pytest.UsageError(f'{extent.VARIABLE} is {asked!r}: it must be full, or not be set')
    laws.alone = config.getoption('--case')


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """
    Mark the tests that start processes, and skip those marked `full` unless all are asked for.

    Tests of processes come first, so that several workers end at about the same time.
    """
    for item in items:
        if STARTERS.intersection(item.fixturenames):
            item.add_marker('processes')
    items.sort(key=lambda item: item.get_closest_marker('processes') is None)
    if extent.FULL:
        return
    skip = pytest.mark.skip(reason=f'only with {extent.VARIABLE}=full')
    for item in items:
        if item.get_closest_marker('full'):
            item.add_marker(skip)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Have a test fail that starts a process and is not marked so."""
    global _without_processes
    _without_processes = None if item.get_closest_marker('processes') else item.nodeid
    try:
        return (yield)
    finally:
        _without_processes = None


@pytest.fixture(scope='session')
def whole_mission():
    """Return a mission of 8 robots, made once; not to be changed."""
    # It needs ROS, which most tests do not import.
    from mission_log import mission

    return mission()


@pytest.fixture(scope='module')
def browser():
    """Return a browser, or skip what needs one where none is installed."""
    if BROWSER is None:
        pytest.skip(f'no browser is installed: apt install {BROWSERS[0]}')
    sync_api = pytest.importorskip('playwright.sync_api')
    with sync_api.sync_playwright() as playwright:
        # Root has no sandbox, as in most containers.
        browser = playwright.chromium.launch(executable_path=BROWSER, args=['--no-sandbox'])
        yield browser
        browser.close()


@pytest.fixture(scope='session')
def server():
    """Start the process that nodes are forked from: it has no threads and no ROS context."""
    with pytest.MonkeyPatch.context() as patch:
        # It passes over modules that it does not find, and is not given the paths of the tests.
        patch.setenv('PYTHONPATH', os.pathsep.join(sys.path))
        forkserver.ensure_running()
