# SPDX-License-Identifier: Apache-2.0
"""The wheel suffices for logs and studies, and carries its types."""

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
COMMANDS = ROOT.joinpath('docs/commands.md').read_text()
PLACE = 'import kbnitp_ros, os; print(os.path.dirname(kbnitp_ros.__file__))'
# What the command for studies says without them.
LACKING = r"No module named .*; in a clone of kbnitp_ros: pip install '\.\[study\]'"
INSTALLED = ('kbnitp_ros', 'setuptools', 'wheel')


# This Python, and others that are there: each takes a minute or two.
OWN = f'3.{sys.version_info.minor}'
PYTHONS = [OWN] + [
    pytest.param(each, marks=pytest.mark.campaign)
    for each in ('3.10', '3.11', '3.12', '3.13')
    if each != OWN
]


def interpreter(version):
    """Return the path of a Python; skip the test if none runs."""
    if version == OWN:
        return sys.executable
    found = shutil.which(f'python{version}')
    # A shim may exist for a Python that does not.
    if not found or subprocess.run([found, '-c', ''], capture_output=True).returncode:
        pytest.skip(f'there is no Python {version}')
    return found


@pytest.fixture(scope='module', params=PYTHONS)
def run(request, tmp_path_factory):
    python = interpreter(request.param)
    folder = tmp_path_factory.mktemp('bare')
    # Building an sdist leaves files beside the sources.
    sources = folder / 'sources'
    shutil.copytree(ROOT, sources, ignore=shutil.ignore_patterns('.*', 'build', 'install', 'log*'))
    shutil.copytree(ROOT / 'kbnitp_ros', sources / 'kbnitp_ros', dirs_exist_ok=True)
    sdist = [sys.executable, 'setup.py', '--quiet', 'sdist', '--dist-dir', folder]
    subprocess.run(sdist, cwd=sources, check=True)
    (sdist,) = folder.glob('*.tar.gz')
    pip = [sys.executable, '-m', 'pip', '--disable-pip-version-check', '--quiet']
    subprocess.run([*pip, 'wheel', '--no-deps', '--wheel-dir', folder, sdist], check=True)
    (wheel,) = folder.glob('*.whl')
    subprocess.run([python, '-m', 'venv', folder / 'venv'], check=True)
    versions = folder / 'versions.txt'
    versions.write_text('\n'.join(pins(request.param)))
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
    imported = run('python', '-c', 'import kbnitp_ros.study').stderr.splitlines()[-1]
    assert re.fullmatch(rf'\w+: {LACKING}', imported)
    missing = run('kbnitp', 'study', 'paper')
    assert (missing.returncode, missing.stdout) == (2, '')
    assert re.fullmatch(rf'study: {LACKING}\n', missing.stderr)
    assert run('pip', 'install', *options, f'{wheel}[all]').returncode == 0
    return run


def pins(version):
    """Return the versions to install: other Pythons lack wheels for some of these."""
    if version == OWN:
        return [f'{each.name}=={each.version}' for each in metadata.distributions() if fits(each)]
    files = [ROOT / f'requirements/{name}.txt' for name in ('run', 'study')]
    lines = [line for file in files for line in file.read_text().splitlines()]
    return [line for line in lines if not re.match('ros-|#', line)]


def fits(distribution):
    """Return whether a version may be asked for of those that know it."""
    return distribution.name not in INSTALLED and not distribution.name.startswith('ros-')


@pytest.mark.processes
@pytest.mark.full
def test_only_one_command_is_installed(run):
    listed = run('python', '-c', 'import os, sys; print(*os.listdir(sys.prefix + "/bin"))').stdout
    assert 'kbnitp' in listed.split()
    assert not {'study', 'report', 'replay', 'demo', 'robot'} & set(listed.split())
    version, here = metadata.version('kbnitp_ros'), run('python', '-c', PLACE).stdout.strip()
    assert Path(here, 'py.typed').exists()
    assert run('kbnitp', '--version').stdout == f'kbnitp_ros {version} in {here}\n'


@pytest.mark.processes
@pytest.mark.full
def test_the_example_of_the_readme_runs(run):
    (code,) = re.findall(r'```python\n(.*?)```', COMMANDS, re.S)
    done = run('python', '-c', code)
    assert done.stdout.strip() == re.findall(r'# (.*)', code)[-1], done.stderr


@pytest.mark.processes
@pytest.mark.full
def test_logs_and_studies_need_no_ros(run, tmp_path):
    log = tmp_path / 'mission.mcap'
    golden = ROOT / 'test/log/recorded/kappa_bnitp.mcap.gz'
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


@pytest.mark.processes
@pytest.mark.full
def test_nodes_say_that_they_need_ros(run):
    done = run('kbnitp', 'planner')
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith('planner: No module named ')
    assert done.stderr.endswith('; source ROS 2\n')


def write_scenario(path):
    text = ROOT.joinpath('config/scenarios/paper.yaml').read_text()
    small = {'robots': 3, 'trials': 1, 'lethalities': '[0.5]', 'methods': '[kappa_bnitp]'}
    for name, value in small.items():
        text, count = re.subn(rf'(?m)^{name}:.*$', f'{name}: {value}', text)
        assert count == 1, name
    path.write_text(text)
    return path


SCRIPT = """
from kbnitp_ros.core import Belief, Estimator, Grid, plan, run_mission, SensorModel, World
from kbnitp_ros.log.history import read_history
from kbnitp_ros.maps import read_map
from kbnitp_ros.study import compare

grid = Grid(4, 4)
prior = Belief.prior(grid, hazard=0.15, target=0.2, kappa=0.8)
model = SensorModel(0.5)
mission = run_mission(grid, prior, model, World.random(grid, 1, 0.15, 0.8, 0.1), 3, 1)
reveal_type(prior.hazard)
reveal_type(plan(grid, prior, model).path)
reveal_type(mission[0].observation.survived)
reveal_type(Estimator(prior, model, 'kappa_bnitp').belief)
reveal_type(read_history)
reveal_type(read_map('field.yaml').grid())
reveal_type(compare(planners=['beam', lambda finder, objective: []]))
reveal_type(compare().latex())
Grid('4', 4)
"""

TYPES = [
    'numpy.ndarray.*float64',
    'numpy.ndarray.*signedinteger',
    'bool',
    'kbnitp_ros.core.field.belief.Belief',
    r'def \(.*\) -> kbnitp_ros.log.history.\w+',
    'kbnitp_ros.core.field.grid.Grid',
    'kbnitp_ros.study.results.Results',
    'str',
]


@pytest.mark.full
@pytest.mark.processes
def test_mypy_finds_the_types_in_a_users_script(tmp_path):
    pytest.importorskip('mypy')
    script = tmp_path / 'script.py'
    script.write_text(SCRIPT)
    command = [sys.executable, '-m', 'mypy', '--strict', '--cache-dir', str(tmp_path), 'script.py']
    told = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True).stdout
    revealed = re.findall(r'Revealed type is "(.*)"', told)
    assert len(revealed) == len(TYPES), told
    for found, expected in zip(revealed, TYPES):
        assert re.match(expected, found.removeprefix('builtins.')), (found, expected)
    errors = [line for line in told.splitlines() if ': error: ' in line]
    assert [re.sub('.*error: ', '', line) for line in errors] == [
        'Argument 1 to "Grid" has incompatible type "str"; expected "int"  [arg-type]'
    ], told
