# SPDX-License-Identifier: Apache-2.0
"""Planners and methods are compared from Python and by the frozen benchmark."""

from hashlib import sha256
from pathlib import Path
from threading import Lock

from kbnitp_ros.core import METHODS, PLANNERS, World
from kbnitp_ros.core.planning.planners import coverage
from kbnitp_ros.study import benchmark, compare
from kbnitp_ros.study.scenario_file import read_study
from laws import for_each
import numpy as np
import pytest
from rounds import Ignorant
from small_study import CONTENT

SMALL = {**CONTENT, 'trials': 2, 'robots': 3, 'lethalities': [0.9]}


def sweep(finder, objective):
    """Go row by row, like the planner 'coverage'."""
    return coverage(finder, objective)


@pytest.fixture(scope='module')
def results():
    return compare(SMALL, planners=['random', sweep], methods=[Ignorant, 'kappa_bnitp'], workers=1)


def test_a_function_equals_the_named_planner(results):
    named = compare(SMALL, planners=['random', 'coverage'], methods=['kappa_bnitp'], workers=1)
    assert results.strategies == [
        f'{method}, {planner}'
        for method in ('Ignorant', 'kappa_bnitp')
        for planner in ('random', 'sweep')
    ]
    one, other = (
        each.to_dataframe().query(f"strategy == '{name}'")['value'].tolist()
        for each, name in ((results, 'kappa_bnitp, sweep'), (named, 'kappa_bnitp, coverage'))
    )
    assert one == other


def test_results_are_shown_in_a_line(results):
    assert repr(results).startswith('Results(2 worlds of 3 robots: Ignorant, random, Ignorant, sw')


def test_a_class_is_the_method(results):
    table = results.to_dataframe().query("strategy == 'Ignorant, sweep'")
    lost, loss = (
        table[table['measure'] == measure].groupby('world')['value'].diff()
        for measure in ('robots_lost', 'hazard_log_loss')
    )
    assert (lost == 1).any()
    assert (loss.to_numpy()[lost.to_numpy() == 1] == 0.0).all()
    assert 'Ignorant' not in METHODS
    assert 'sweep' not in PLANNERS


@pytest.mark.processes
def test_other_processes_get_functions_without_a_module():
    planners = {'mine': lambda *given: coverage(*given)}
    here, there = (
        compare(SMALL, planners=planners, workers=count).to_dataframe() for count in (1, 2)
    )
    assert here.equals(there)


def locked(lock):
    return lambda *given: lock and coverage(*given)


@for_each('given, error, words', [
    ({'planners': [lambda f, o: []]}, ValueError, "planner '<lambda>': it has no name; name"),
    ({'planners': [sweep, sweep]}, ValueError, "planner 'sweep': two have this name"),
    ({'planners': {'beam': sweep}}, ValueError, "planner 'beam': kbnitp_ros has a planner"),
    ({'planners': [None]}, TypeError, 'planner is None: it must be a name or a function'),
    ({'methods': {'mine': 3}}, TypeError, 'method is 3: it must be a name or a function'),
    ({'scenario': {**SMALL, 'teams': 'x'}, 'planners': ['beam']}, ValueError, "teams is 'x'"),
    ({'planners': ['beem']}, ValueError, "planner is 'beem': known are relaxed"),
    ({'methods': [dict]}, TypeError, "method 'dict': it must"),
    ({'methods': ['beam']}, ValueError, "methods is 'beam': known are"),
    ({'methods': 'kappa_bnitp'}, TypeError, r"methods is 'kappa_bnitp': it must be a list, such"),
    ({'planners': sweep}, TypeError, 'planners is <function sweep.*: it must be a list'),
    ({'scenario': 3}, TypeError, 'scenario is 3: it must be a name, a file or a mapping'),
    ({'trials': 0}, ValueError, 'trials is 0: it must be a whole number from 1'),
    ({'trails': 3}, ValueError, 'trails is unknown: did you mean trials'),
    ({'kappa': 0.5}, ValueError, 'kappa may be world.kappa or prior.kappa: give one'),
])  # fmt: skip
def test_bad_comparisons_are_refused(given, error, words):
    with pytest.raises(error, match=words):
        compare(**{'scenario': SMALL, **given}, workers=1)


@pytest.mark.processes
def test_functions_that_cannot_be_pickled_are_refused():
    with pytest.raises(TypeError, match='cannot be sent to other processes: define it in'):
        compare(SMALL, planners={'mine': locked(Lock())}, workers=2)


SCENARIOS = Path(__file__).parents[2] / 'config/scenarios'

# Of version 2. A change needs another version.
HASHES = {
    'benchmark.yaml': 'a206285acfa4c495b76f801253c467c3fa7a1c37a025fd24c201c707c78d1a3a',
    'benchmark_2.npz': 'c86098bdee88ae916f3917971ddc2e3e3c22660c13e250f720ef5b83b59d8726',
}
WORLDS = 'f0be80f0c0315837c1891eaa64a5fc9e92606b97f9e234872efb4c4fc5770066'


@pytest.fixture(scope='module')
def scenario():
    return read_study(SCENARIOS / 'benchmark.yaml').first


def test_the_benchmark_is_frozen(scenario):
    found = {each: sha256(SCENARIOS.joinpath(each).read_bytes()).hexdigest() for each in HASHES}
    assert (benchmark.VERSION, found) == (2, HASHES)
    assert 'Benchmark, version 2.' in (SCENARIOS.parents[1] / 'docs/benchmark.md').read_text()
    densities = vars(scenario.world)
    worlds = [
        World.random(scenario.field(), np.random.default_rng([scenario.seed, number]), **densities)
        for number in range(scenario.trials)
    ]
    drawn = np.packbits([(each.hazard, each.target) for each in worlds])
    assert sha256(drawn.tobytes()).hexdigest() == WORLDS


@for_each('planner', ['random', 'coverage', 'shortest_unvisited', 'relaxed'])
def test_no_plan_exceeds_the_bound(scenario, planner):
    beliefs = benchmark.frozen()
    ratio, _ = benchmark.plan_worths(planner, scenario.field(), 18, beliefs)
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


@for_each('name, complaint', [
    ('methods', 'methods cannot be set'), ('workers', 'workers is unknown'),
])  # fmt: skip
def test_the_benchmark_chooses_what_it_compares(tmp_path, name, complaint):
    with pytest.raises(ValueError, match=complaint):
        benchmark.run_benchmark(tmp_path, 1, {name: 'beam'})


@pytest.mark.slow
def test_the_table_has_a_row_for_each(monkeypatch, tmp_path):
    entered = ['random', 'beam', 'mine'], ['relaxed_itp', benchmark.METHOD]
    monkeypatch.setattr(benchmark, 'entered', lambda: entered)
    with PLANNERS.including({'mine': mine}):
        written = benchmark.run_benchmark(tmp_path, 1, {'trials': 1, 'robots': [2, 3]})
    assert {each.name for each in written} == {
        *(f'benchmark.{each}' for each in ('md', 'tex', 'pdf', 'png', 'svg')),
        'table.csv',
    }
    _, _, *rows = [
        line for line in (tmp_path / 'benchmark.md').read_text().splitlines() if '|' in line
    ]
    cells = [[cell.strip(' `') for cell in row.strip('|').split('|')] for row in rows]
    pairs = [(planner, benchmark.METHOD) for planner in entered[0]] + [('beam', 'relaxed_itp')]
    assert sorted(each[:3] for each in cells) == sorted(
        [*pair, robots] for pair in pairs for robots in ('2', '3')
    )
    assert all(0.0 < float(each[4]) <= 1.0 for each in cells)
    least = {each[0]: float(each[4]) for each in cells}
    assert least['beam'] > least['random']
    assert all(float(each[6]) > 0.0 and 0 <= float(each[8]) <= float(each[2]) for each in cells)
