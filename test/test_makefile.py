# SPDX-License-Identifier: Apache-2.0
"""`make build` and `make test` say what they install, how far they are and why they fail."""

import os
from pathlib import Path
import shutil
import signal
import subprocess
import time

import pytest

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[1]

WORKS = 'for n in 1 2 3; do echo fetching part $n; sleep 0.5; done'
REFUSED = 'echo npm http fetch; echo npm error code SELF_SIGNED_CERT_IN_CHAIN >&2; exit 7'
UNKNOWN = 'echo Collecting quark; echo "ERROR: No matching distribution found" >&2; exit 1'


@pytest.fixture
def tree(tmp_path):
    """Return a folder with the Makefile, and pip and npm that do what they are told."""
    for name in ('Makefile', 'requirements-dev.lock', 'tools'):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, tmp_path / name)
    locks = [f'test/{name}/package-lock.json' for name in ('log', 'report')]
    for name in (*locks, '.venv/.run', '.venv/bin/pip', 'bin/npm'):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    # Newer than what it is made of.
    os.utime(tmp_path / '.venv/.run')
    (tmp_path / 'requirements.lock').touch()
    os.utime(tmp_path / 'requirements.lock', (0, 0))
    return tmp_path


def make(tree, pip, npm):
    """Return what comes of installing what tests need with programs that do this, in shell."""
    for name, does in (('.venv/bin/pip', pip), ('bin/npm', npm)):
        (tree / name).write_text(f'#!/bin/bash\n{does}\n')
        (tree / name).chmod(0o755)
    environment = {name: value for name, value in os.environ.items() if name != 'ROS_DISTRO'}
    environment |= {'PATH': f'{tree / "bin"}:{os.environ["PATH"]}', 'STEP_PERIOD': '0.2'}
    return subprocess.Popen(
        ['make', '.venv/.dev', '.venv/.npm'],
        cwd=tree,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Shells start background jobs deaf to it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def test_progress_is_shown_in_few_lines(tree):
    made = make(tree, WORKS, WORKS)
    told, complaints = made.communicate(timeout=60)
    assert made.returncode == 0, complaints
    assert complaints == ''
    for what in ('requirements-dev.lock into .venv', 'test/log/package-lock.json with npm'):
        assert f'Installing {what} ...\n' in told
    assert told.count('s: fetching part 2') >= 3
    assert told.count('done in') == 3
    assert (tree / '.venv/.dev').exists()
    assert (tree / '.venv/.npm').exists()


@pytest.mark.parametrize(
    'pip, npm, reasons, missing',
    [
        (UNKNOWN, WORKS, ['quark', 'ERROR: No matching distribution', 'exit code 1: '], 'dev'),
        (WORKS, REFUSED, ['npm error code SELF_SIGNED_CERT', 'exit code 7: npm ci'], 'npm'),
    ],
    ids=['pip', 'npm'],
)
def test_what_fails_says_why(tree, pip, npm, reasons, missing):
    made = make(tree, pip, npm)
    _, complaints = made.communicate(timeout=60)
    assert made.returncode == 2
    for reason in reasons:
        assert reason in complaints
    assert not (tree / '.venv' / f'.{missing}').exists()


@pytest.mark.parametrize('target, command, with_npm', [
    ('check', 'ruff check', False),
    ('test-quick', "-m 'not processes and not slow'", False),
    ('test', 'pytest', True),
    ('test-full', 'pytest', True),
])  # fmt: skip
def test_only_tests_that_read_logs_in_javascript_need_npm(tree, target, command, with_npm):
    for name in ('colcon_defaults.yaml', 'package.xml', 'setup.cfg', 'setup.py'):
        (tree / name).touch()
    dry = ['make', '--dry-run', target]
    environment = {name: value for name, value in os.environ.items() if name != 'ROS_DISTRO'}
    told = subprocess.run(dry, cwd=tree, env=environment, capture_output=True, text=True).stdout
    assert command in told
    assert 'requirements-dev.lock' in told
    assert ('npm' in told) == with_npm


def test_a_certificate_that_is_not_trusted_has_its_remedy(tree):
    npm = 'echo "npm error self-signed certificate in certificate chain"; exit 1'
    _, complaints = make(tree, WORKS, npm).communicate(timeout=60)
    assert 'PIP_CERT=FILE' in complaints
    assert 'NODE_EXTRA_CA_CERTS=FILE' in complaints
    _, complaints = make(tree, UNKNOWN, WORKS).communicate(timeout=60)
    assert 'PIP_CERT' not in complaints


def test_an_interrupt_ends_what_runs(tree):
    made = make(tree, 'echo $$ > pid; exec sleep 60', WORKS)
    deadline = time.monotonic() + 30
    while not (tree / 'pid').exists() or not (tree / 'pid').read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.killpg(made.pid, signal.SIGINT)
    made.communicate(timeout=30)
    assert made.returncode != 0
    assert not Path('/proc', (tree / 'pid').read_text().strip()).exists()
