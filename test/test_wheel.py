# SPDX-License-Identifier: Apache-2.0
"""The package works in an environment of its own, without ROS."""

import gzip
from importlib import metadata
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]
README = ROOT.joinpath('README.md').read_text()
INSTALLED = ('kbnitp_ros', 'setuptools', 'wheel')

pytestmark = [pytest.mark.processes, pytest.mark.full]


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """Return what runs a command of a new environment that has the wheel and its extras."""
    folder = tmp_path_factory.mktemp('bare')
    # What builds a wheel leaves files beside the sources.
    sources = folder / 'sources'
    shutil.copytree(ROOT, sources, ignore=shutil.ignore_patterns('.*', 'build', 'install', 'log*'))
    shutil.copytree(ROOT / 'kbnitp_ros', sources / 'kbnitp_ros', dirs_exist_ok=True)
    pip = [sys.executable, '-m', 'pip', '--disable-pip-version-check', '--quiet']
    subprocess.run([*pip, 'wheel', '--no-deps', '--wheel-dir', folder, sources], check=True)
    (wheel,) = folder.glob('*.whl')
    subprocess.run([sys.executable, '-m', 'venv', folder / 'venv'], check=True)
    versions = folder / 'versions.txt'
    versions.write_text(
        '\n'.join(
            f'{each.name}=={each.version}' for each in metadata.distributions() if fits(each)
        )
    )
    environment = {name: os.environ[name] for name in os.environ if 'ROS' not in name}
    del environment['PYTHONPATH']

    def run(command, *arguments):
        return subprocess.run(
            [folder / 'venv/bin' / command, *arguments],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )

    options = ('--quiet', '--constraint', versions)
    assert run('pip', 'install', *options, wheel).returncode == 0
    missing = run('kbnitp', 'study', 'paper')
    assert (missing.returncode, missing.stdout) == (2, '')
    assert re.fullmatch(
        r"study: No module named .*; pip install 'kbnitp_ros\[study\]'\n", missing.stderr
    )
    assert run('pip', 'install', *options, f'{wheel}[all]').returncode == 0
    return run


def fits(distribution):
    """Return whether a version may be asked for of those that know it."""
    return distribution.name not in INSTALLED and not distribution.name.startswith('ros-')


def test_only_one_command_is_installed(run):
    listed = run('python', '-c', 'import os, sys; print(*os.listdir(sys.prefix + "/bin"))').stdout
    assert 'kbnitp' in listed.split()
    assert not {'study', 'report', 'replay', 'demo', 'robot'} & set(listed.split())
    version = metadata.version('kbnitp_ros')
    assert run('kbnitp', '--version').stdout == f'kbnitp_ros {version}\n'


def test_the_example_of_the_readme_runs(run):
    (code,) = re.findall(r'```python\n(.*?)```', README, re.S)
    done = run('python', '-c', code)
    assert done.stdout.strip() == re.findall(r'# (.*)', code)[-1], done.stderr


def test_logs_and_studies_need_no_ros(run, tmp_path):
    log = tmp_path / 'mission.mcap'
    golden = ROOT / 'test/log/recorded/kappa_bnitp_smoothed.mcap.gz'
    log.write_bytes(gzip.decompress(golden.read_bytes()))
    for command, *arguments in (
        ('replay', log),
        ('report', log, '--out', tmp_path / 'report'),
        ('study', write_scenario(tmp_path / 'small.yaml'), '--out', tmp_path / 'study'),
    ):
        done = run('kbnitp', command, *arguments)
        assert done.returncode == 0, done.stderr
    assert tmp_path.joinpath('report/report.html').exists()
    assert tmp_path.joinpath('study/entropy.png').exists()


def test_nodes_say_that_they_need_ros(run):
    done = run('kbnitp', 'planner')
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith('planner: No module named ')
    assert done.stderr.endswith('; source ROS 2\n')


def write_scenario(path):
    text = ROOT.joinpath('scenarios/paper.yaml').read_text()
    small = {'robots': 3, 'trials': 1, 'lethalities': '[0.5]', 'methods': '[kappa_bnitp]'}
    for name, value in small.items():
        text, count = re.subn(rf'(?m)^{name}:.*$', f'{name}: {value}', text)
        assert count == 1, name
    path.write_text(text)
    return path
