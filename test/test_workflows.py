# SPDX-License-Identifier: Apache-2.0
"""The workflows do what the README tells people to do, with what the tests import."""

from pathlib import Path
import re

from laws import for_each
import pytest
from test_package import imported_by, PYTHON_PACKAGES
import yaml

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted(ROOT.joinpath('.github/workflows').glob('*.yml'))
README = (ROOT / 'README.md').read_text()
COMMANDS = (ROOT / 'docs/commands.md').read_text()


def steps(name):
    """Return what a workflow runs, line by line."""
    workflow = yaml.safe_load((ROOT / f'.github/workflows/{name}.yml').read_text())
    (job,) = workflow['jobs'].values()
    return [line for step in job['steps'] for line in step.get('run', '').splitlines()]


@for_each('path', WORKFLOWS)
def test_actions_are_pinned_by_commit(path):
    used = re.findall(r'uses: (.*)', path.read_text())
    assert used
    for action in used:
        assert re.fullmatch(r'[\w-]+/[\w-]+@[0-9a-f]{40}  # v\d+\.\d+\.\d+', action)


def test_wheels_are_tried_by_the_commands_of_the_readme():
    made = [line.split()[1] for line in steps('wheels') if line.startswith('make ')]
    assert made == ['build', 'demo', 'check', 'docs', 'test']
    targets = re.findall(r'^(\w+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    assert set(made) <= set(targets)
    assert '```bash\nmake build\nmake demo\n```' in README


def test_wheels_are_tried_with_every_python_that_they_are_for():
    workflow = yaml.safe_load((ROOT / '.github/workflows/wheels.yml').read_text())
    versions = workflow['jobs']['build']['strategy']['matrix']['python']
    script = (ROOT / 'tools/check_machine.sh').read_text()
    assert ' | '.join(versions) + ')' in script


def test_ros_is_tried_by_the_commands_of_the_readme():
    run = steps('ros')
    told = re.search(r'(rosdep install .*)\n(colcon build)\n', COMMANDS)
    assert told[1] in run
    assert any(line.endswith(told[2]) for line in run)
    assert any('colcon test ' in line for line in run)
    assert 'colcon test-result --verbose' in run


@pytest.mark.slow
def test_ros_is_tried_with_what_rosdep_does_not_know():
    imported = imported_by('kbnitp_ros', 'test')
    unknown = {wheel for name, (key, wheel) in PYTHON_PACKAGES.items() if key is None}
    wanted = {PYTHON_PACKAGES[name][1] for name in imported & PYTHON_PACKAGES.keys()} & unknown
    installed = {name for line in steps('ros') if 'pip install' in line for name in line.split()}
    assert len(wanted) > 5
    assert wanted <= installed
