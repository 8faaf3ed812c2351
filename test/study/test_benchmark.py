# SPDX-License-Identifier: Apache-2.0
"""The benchmark is frozen, its bounds hold, and whoever is installed takes part."""

from hashlib import sha256
from pathlib import Path

from kbnitp_ros.core import PLANNERS, World
from kbnitp_ros.core.planning.planners import coverage
from kbnitp_ros.study import benchmark
from kbnitp_ros.study.scenario_file import read_scenario
from laws import for_each
import numpy as np
import pytest

SCENARIOS = Path(__file__).parents[2] / 'scenarios'

# Of version 2. A change needs another version.
HASHES = {
    'benchmark.yaml': 'a206285acfa4c495b76f801253c467c3fa7a1c37a025fd24c201c707c78d1a3a',
    'benchmark_2.npz': 'c86098bdee88ae916f3917971ddc2e3e3c22660c13e250f720ef5b83b59d8726',
}
WORLDS = 'f0be80f0c0315837c1891eaa64a5fc9e92606b97f9e234872efb4c4fc5770066'


@pytest.fixture(scope='module')
def scenario():
    return read_scenario(SCENARIOS / 'benchmark.yaml')


def test_the_benchmark_is_frozen(scenario):
    found = {each: sha256(SCENARIOS.joinpath(each).read_bytes()).hexdigest() for each in HASHES}
    assert (benchmark.VERSION, found) == (2, HASHES)
    assert 'Benchmark, version 2.' in (SCENARIOS.parent / 'docs/benchmark.md').read_text()
    densities = vars(scenario.world)
    worlds = [
        World.random(scenario.field(), np.random.default_rng([scenario.seed, number]), **densities)
        for number in range(scenario.trials)
    ]
    drawn = np.packbits([(each.hazard, each.target) for each in worlds])
    assert sha256(drawn.tobytes()).hexdigest() == WORLDS


@for_each('planner', ['random', 'coverage', 'shortest_unvisited', 'relaxed'])
def test_no_plan_is_worth_more_than_the_bound(scenario, planner):
    beliefs = benchmark.frozen()
    ratio, _ = benchmark.worth_of(planner, scenario.field(), 18, beliefs)
    assert ratio.shape == (len(beliefs),)
    assert (ratio > 0.0).all()
    assert (ratio <= 1.0 + 1e-9).all()


def mine(finder, objective):
    return coverage(finder, objective)


def test_planners_of_others_are_entered():
    with PLANNERS.including({'mine': mine}):
        planners, methods = benchmark.entered()
    assert planners[-2:] == ['beam', 'mine']
    assert set(planners) <= {*PLANNERS, 'mine'}
    assert 'relaxed_bnitp' in methods


@pytest.mark.slow
def test_the_table_has_a_row_for_each(monkeypatch, tmp_path):
    entered = ['random', 'beam', 'mine'], ['relaxed_itp', benchmark.METHOD]
    monkeypatch.setattr(benchmark, 'entered', lambda: entered)
    with PLANNERS.including({'mine': mine}):
        written = benchmark.run_benchmark(tmp_path, 1, trials=1, robots=2)
    assert {each.name for each in written} == {
        f'benchmark.{each}' for each in ('md', 'tex', 'pdf', 'png', 'svg')
    }
    _, _, *rows = [
        line for line in (tmp_path / 'benchmark.md').read_text().splitlines() if '|' in line
    ]
    cells = [[cell.strip(' `') for cell in row.strip('|').split('|')] for row in rows]
    assert [each[:2] for each in cells] == [
        *([planner, benchmark.METHOD] for planner in entered[0]),
        ['beam', 'relaxed_itp'],
    ]
    assert all(0.0 < float(each[3]) <= 1.0 for each in cells)
    assert float(cells[1][3]) > float(cells[0][3])
    assert all(float(each[5]) > 0.0 and 0 <= float(each[7]) <= 2 for each in cells)
