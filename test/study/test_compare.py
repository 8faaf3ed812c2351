# SPDX-License-Identifier: Apache-2.0
"""Planners and methods are compared from Python and by the frozen benchmark."""

from hashlib import sha256
from pathlib import Path
from threading import Lock

from kbnitp_ros.core import METHODS, PLANNERS, World
from kbnitp_ros.core.planning.planners import coverage
from kbnitp_ros.study import benchmark, compare, study_figures, study_tables
from kbnitp_ros.study.scenario_file import read_scenario
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
    one, other = (
        each.to_dataframe().query("planner != 'random' and method == 'kappa_bnitp'")
        for each in (results, named)
    )
    assert set(one['planner']) == {'sweep'}
    assert one['entropy'].tolist() == other['entropy'].tolist()


def test_results_are_shown_in_a_line(results):
    assert repr(results) == 'Results(8 missions of 3 robots: Ignorant, kappa_bnitp)'


def test_a_class_is_the_method(results):
    table = results.to_dataframe()
    assert table['method'].unique().tolist() == ['Ignorant', 'kappa_bnitp']
    ignorant = table.query("method == 'Ignorant'")
    lost = ignorant['robots_lost'].diff() == 1
    assert lost.any()
    assert (ignorant['hazard_log_loss'].diff()[lost] == 0.0).all()
    assert 'Ignorant' not in METHODS
    assert 'sweep' not in PLANNERS


@pytest.mark.processes
def test_other_processes_get_functions_without_a_module():
    planners = {'mine': lambda *given: coverage(*given)}
    here, there = (
        compare(SMALL, planners=planners, workers=count).to_dataframe() for count in (1, 2)
    )
    assert here.equals(there)
    assert set(here['planner']) == {'mine'}


def test_tables_and_figures_have_their_names(results):
    tables = study_tables(results)
    assert list(tables) == ['summary', 'planners']
    (first, second) = tables['planners'].to_dataframe().to_dict('records')
    assert (first['method'], second['method']) == ('Ignorant', 'kappa_bnitp')
    assert first['planner'] == 'sweep'
    at_end = results.to_dataframe().query("deployment == 3 and method == 'Ignorant'")
    means = at_end.groupby('planner')['robots_lost'].mean()
    assert first['lost'] == means['sweep']
    assert first['more lost'] == means['sweep'] - means['random']
    assert first['lost low'] <= first['lost'] <= first['lost high']
    assert 'log_loss' in study_figures(results)


def test_a_table_in_latex_has_the_cells_of_that_in_markdown(results):
    table = study_tables(results)['planners']
    latex = table.latex()
    assert latex.count('{') == latex.count('}')
    rows = latex.partition('\\midrule\n')[2].partition('\\bottomrule')[0].splitlines()
    lines = table.markdown().splitlines()[4:]
    for row, line in zip(rows, lines, strict=True):
        cells = row.removesuffix(r' \\').split(' & ')
        plain = [cell.replace(r'\texttt{', '`').replace('}', '`') for cell in cells]
        assert [cell.replace(r'\_', '_') for cell in plain] == line.strip('| ').split(' | ')


def locked(lock):
    return lambda *given: lock and coverage(*given)


@for_each('given, error, words', [
    ({'planners': [lambda f, o: []]}, ValueError, "planner '<lambda>': it has no name; name"),
    ({'planners': [sweep, sweep]}, ValueError, "planner 'sweep': two have this name"),
    ({'planners': {'beam': sweep}}, ValueError, "planner 'beam': kbnitp_ros has a planner"),
    ({'planners': ['beem']}, ValueError, "planner is 'beem': known are relaxed"),
    ({'methods': [dict]}, TypeError, "method 'dict': it must"),
    ({'methods': ['beam']}, ValueError, "methods is 'beam': known are"),
    ({'methods': 'kappa_bnitp'}, TypeError, r"methods is 'kappa_bnitp': it must be a list, such"),
    ({'planners': sweep}, TypeError, 'planners is <function sweep.*: it must be a list'),
    ({'scenario': 3}, TypeError, 'scenario is 3: it must be a name, a file or a mapping'),
    ({'trials': 0}, ValueError, 'trials is 0: it must be a whole number from 1'),
    ({'trails': 3}, ValueError, 'trails is unknown: it has seed, trials'),
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
    return read_scenario(SCENARIOS / 'benchmark.yaml')


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
