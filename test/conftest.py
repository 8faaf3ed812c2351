# SPDX-License-Identifier: Apache-2.0
"""Select tests, mark those that start processes, and fix how hypothesis draws."""

from multiprocessing import forkserver
import os
from pathlib import Path
import shutil
import sys

import extent
from hypothesis import HealthCheck, settings
import laws
import pytest

# Set before numpy is imported: tests run in parallel, so threads would only wait.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# Fixtures that start processes: tests that use them are marked `processes`.
STARTERS = {'browser', 'field', 'set_out'}

# Audit events of Python for the start of a process.
STARTS = {'os.fork', 'os.forkpty', 'os.posix_spawn', 'os.spawn', 'os.system', 'subprocess.Popen'}

# Browser that shows pages.
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)

# How long a test takes depends on the machine.
settings.register_profile('busy', deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('busy')


# The running test, if it lacks the marker `processes`.
_without_processes = None


def _refuse_processes(event, _):
    if event in STARTS and _without_processes is not None:
        pytest.fail(f'{_without_processes} starts a process: mark it with pytest.mark.processes')


sys.addaudithook(_refuse_processes)


def pytest_addoption(parser):
    parser.addoption(
        '--case', help='run this case of laws alone, as its failure names it, or those of a value'
    )
    parser.addoption('--pictures', help='folder to take pictures of docs/ to')


def pytest_configure(config):
    """Refuse a misspelt KBNITP_TESTS, which would run fewer tests than meant."""
    if (asked := os.environ.get(extent.VARIABLE, '')) not in ('', 'full'):
        raise pytest.UsageError(f'{extent.VARIABLE} is {asked!r}: it must be full, or not be set')
    laws.alone = config.getoption('--case')


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """
    Mark tests that start processes, and skip `full` ones unless requested.

    Tests of processes come first, so that workers end at about the same time.
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
    """Fail a test that starts a process without the marker `processes`."""
    global _without_processes
    _without_processes = None if item.get_closest_marker('processes') else item.nodeid
    try:
        return (yield)
    finally:
        _without_processes = None


@pytest.fixture(scope='session')
def whole_mission():
    """Return a mission of 8 robots, made once; do not change it."""
    # Imports ROS, which most tests do not need.
    from mission_log import mission

    return mission()


@pytest.fixture(scope='module')
def browser():
    """Return a browser; skip the test if none is installed."""
    if BROWSER is None:
        pytest.skip(f'no browser is installed: apt install {BROWSERS[0]}')
    sync_api = pytest.importorskip('playwright.sync_api')
    with sync_api.sync_playwright() as playwright:
        # Chromium has no sandbox for root, as in most containers.
        browser = playwright.chromium.launch(executable_path=BROWSER, args=['--no-sandbox'])
        yield browser
        browser.close()


@pytest.fixture(scope='session')
def server():
    """Start the process that nodes are forked from, without threads or a ROS context."""
    with pytest.MonkeyPatch.context() as patch:
        # It skips modules that it does not find, and does not get the tests' path.
        patch.setenv('PYTHONPATH', os.pathsep.join(sys.path))
        forkserver.ensure_running()


@pytest.fixture
def gate(tmp_path, monkeypatch):
    """Return the file that `gated:search` and `gated:lane` wait for in nodes that start next."""
    shutil.copy(Path(__file__).with_name('gated.py'), tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path / 'open'
