# SPDX-License-Identifier: Apache-2.0
"""What docs/files.md shows is what is read."""

from dataclasses import fields, is_dataclass
import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
from typing import get_args, get_type_hints

from kbnitp_ros.configuration.field import read_world
from kbnitp_ros.configuration.given import read_sections, values_for
from kbnitp_ros.core import Grid
from kbnitp_ros.study.scenario import read_scenario, Scenario
from kbnitp_ros.study.trial import trials_of
import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT.joinpath('docs', 'files.md').read_text()
SHOWN = {
    name: f'# {name}\n{text}'
    for name, text in re.findall(r'```yaml\n# (\w+)\n(.*?)```', PAGE, re.DOTALL)
}
COMMANDS = re.findall(r'```bash\n(.*?)\n```', PAGE, re.DOTALL)


@pytest.fixture
def shown(tmp_path):
    """Return a function that writes what the page shows to a file."""

    def write(name, to='shown.yaml'):
        path = tmp_path / to
        path.write_text(SHOWN[name])
        return path

    return write


def test_parameters(shown):
    sections = read_sections(shown('parameters'))
    assert values_for(sections, '/agent')['sensor.lethality'] == 0.6
    assert values_for(sections, '/planner')['sensor.lethality'] == 0.3
    assert values_for(sections, '/north/planner')['robots'] == 40
    assert 'robots' not in values_for(sections, '/planner')


def test_a_world(shown):
    world = read_world(shown('world'), Grid(4, 3))
    assert world.hazard.nonzero()[0].tolist() == [1, 10]
    assert world.target.nonzero()[0].tolist() == [1, 4, 10]


def keys_of(kind):
    """Yield the keys of a section and of those in it."""
    for name, hint in get_type_hints(kind).items():
        yield name
        for inner in (hint, *get_args(hint)):
            if is_dataclass(inner):
                yield from (field.name for field in fields(inner))


def test_a_scenario_with_every_key(shown):
    path = shown('scenario')
    trials = len(trials_of(read_scenario(path)))
    assert f'= {trials} missions' in PAGE
    missing = [key for key in keys_of(Scenario) if not re.search(rf'\b{key}:', SHOWN['scenario'])]
    assert missing == []


@pytest.mark.processes
@pytest.mark.full
@pytest.mark.parametrize('command', COMMANDS)
def test_the_commands(shown, tmp_path, command):
    shown('world', 'hidden.yaml')
    typed = [sys.executable, *shlex.split(command)[1:]]
    environment = {**os.environ, 'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'}
    done = subprocess.run(
        typed, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
