# SPDX-License-Identifier: Apache-2.0
"""Whoever uses the package has the types of what it returns."""

import re
import subprocess
import sys

import pytest

SCRIPT = """
from kbnitp_ros.core import Belief, Estimator, Grid, plan, run_mission, SensorModel, World
from kbnitp_ros.log.history import read_history
from kbnitp_ros.maps import read_map
from kbnitp_ros.study import compare, tables_of

grid = Grid(4, 4)
prior = Belief.prior(grid, hazard=0.15, target=0.2, kappa=0.8)
model = SensorModel(0.5)
mission = run_mission(grid, prior, model, World.random(grid, 1, 0.15, 0.8, 0.1), 3, 1)
reveal_type(prior.hazard)
reveal_type(plan(grid, prior, model, 8).path)
reveal_type(mission[0].observation.survived)
reveal_type(Estimator(prior, model, 'kappa_bnitp').belief)
reveal_type(read_history)
reveal_type(read_map('field.yaml').grid())
reveal_type(compare(planners=['beam', lambda finder, objective: []]))
reveal_type(tables_of(compare())['summary'].latex())
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
def test_mypy_finds_the_types_in_a_script_of_a_user(tmp_path):
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
