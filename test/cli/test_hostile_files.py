# SPDX-License-Identifier: Apache-2.0
"""Every command refuses a file that would take all memory or time, or never come to an end."""

from itertools import product
import os

from bounded import megabytes_at_start, run_command
from laws import for_each
import pytest

pytestmark = pytest.mark.processes

LAUGHS = 'a0: &a0 [x, x]\n' + ''.join(
    f'a{n}: &a{n} [{", ".join([f"*a{n - 1}"] * 10)}]\n' for n in range(1, 40)
)

CONTENTS = {
    'aliases': (LAUGHS, 'it stands for more than 250000 values'),
    'nesting': ('[' * 10**6, 'nested more than 100 deep'),
    'twice': ('a: 1\nb: 2\na: 3\n', "the key 'a' stands in line 3 and in line 1"),
    'pipe': (None, 'it is a pipe, not a file'),
    'device': (None, 'it is a device, not a file'),
    'number': ('a: ' + '1' * 5000, 'it is not YAML'),
}

# Of each command how it is given the file.
GIVEN = {
    'scenario': ('study', '{}', '--out', 'out'),
    'world': ('agent', '--ros-args', '-p', 'world.file:={}'),
    'parameters': ('planner', '--ros-args', '--params-file', '{}'),
    'parameters of the demo': ('demo', '--params', '{}'),
    'map': ('planner', '--ros-args', '-p', 'map:={}'),
    'prior': ('estimator', '--ros-args', '-p', 'prior.hazard_map:={}'),
}


@for_each('given, kind', product(GIVEN, CONTENTS), every=14)
def test_a_hostile_file_is_refused(given, kind, tmp_path):
    text, complaint = CONTENTS[kind]
    path = tmp_path / f'{given} {kind}.yaml'
    if kind == 'pipe':
        os.mkfifo(path)
    elif kind == 'device':
        path.symlink_to('/dev/zero')
    else:
        path.write_text(text)
    arguments = [each.format(path) for each in GIVEN[given]]
    ended = run_command(*arguments, cwd=tmp_path)
    assert ended.code == 2, ended
    (said,) = ended.said.splitlines()
    assert said.startswith(f'{arguments[0]}: ')
    assert str(path) in said
    if given != 'scenario' or text:
        assert complaint in said
    assert ended.megabytes < megabytes_at_start(arguments[0]) + 100
