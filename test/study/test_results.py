# SPDX-License-Identifier: Apache-2.0
"""One tidy table: read back, compared in pairs, printed and drawn."""

from dataclasses import replace

from disk import room_for
from kbnitp_ros.study import bootstrap, curves, differences, study_figures
from kbnitp_ros.study.comparing import write_report
from kbnitp_ros.study.results import KEYS, Results
from kbnitp_ros.study.scenario import Strategy
from kbnitp_ros.study.scenario_file import parse_study
from kbnitp_ros.study.trial import Trial
from laws import for_each
from legible import check_lines, check_texts
import numpy as np
import pandas
import pytest
from small_study import CONTENT, run, single

FIRST, PRINTED, EXACT = 'relaxed_bnitp', 'kappa_bnitp_published', 'kappa_bnitp'


@pytest.fixture(scope='module')
def chosen():
    """Return a study with choices of numbers, texts and null, and its results."""
    study = parse_study(
        {**CONTENT, 'trials': 2, 'robots': 3},
        {'max_visits': [1, 2], 'believed_lethality': [None, 1.0], 'ties': ['first', 'random']},
    )
    return study, Results.of(study, run(study))


def test_the_table_is_tidy(results, outcomes):
    table = results.to_dataframe()
    assert list(table) == ['world', 'strategy', 'lethality', 'robot', 'measure', 'value']
    assert not table.duplicated(['world', 'strategy', 'lethality', 'robot', 'measure']).any()
    assert results.axes == ['lethality']
    assert results.strategies == [FIRST, PRINTED, EXACT]
    for trial, outcome in outcomes.items():
        rows = table[
            (table['world'] == trial.number)
            & (table['strategy'] == trial.method)
            & (table['lethality'] == trial.lethality)
        ]
        values = outcome.to_numpy()
        robot, measure = np.nonzero(~np.isnan(values))
        assert rows['robot'].tolist() == robot.tolist()
        assert rows['measure'].tolist() == outcome.columns[measure].tolist()
        assert rows['value'].tolist() == values[robot, measure].tolist()


def test_each_choice_has_a_column(chosen):
    study, results = chosen
    assert results.axes == ['lethality', 'max_visits', 'believed_lethality', 'ties']
    table = results.to_dataframe()
    assert set(table['believed_lethality']) == {'null', '1.0'}
    rows = table.query(
        "max_visits == 2 and believed_lethality == '1.0' and ties == 'random' and "
        "lethality == 0.9 and strategy == 'kappa_bnitp' and world == 1 and measure == 'entropy'"
    )
    trial = Trial(0.9, 'kappa_bnitp', 1, choices=(2, 1.0, 'random'))
    entropy = run_one(study, trial)['entropy']
    assert rows['value'].tolist() == entropy.tolist()


def run_one(study, trial):
    return run(replace(study, scenarios={trial.choices: study.scenarios[trial.choices]}))[trial]


@for_each('name', ['table.csv', ''])
def test_results_are_read_back(chosen, tmp_path, name):
    _, results = chosen
    results.write(tmp_path)
    found = Results.read(tmp_path / name)
    assert (found.axes, found.strategies) == (results.axes, results.strategies)
    assert repr(found) == repr(results)
    pandas.testing.assert_frame_equal(
        found.to_dataframe(), results.to_dataframe(), check_exact=True
    )


@for_each('made, complaint', [
    (lambda folder: folder, 'has no table.csv: run the study again'),
    (lambda folder: folder / 'none.csv', 'none.csv has no table.csv'),
])  # fmt: skip
def test_an_unfinished_study_is_refused(tmp_path, made, complaint):
    with pytest.raises(ValueError, match=complaint):
        Results.read(made(tmp_path))


@for_each('name', KEYS)
def test_a_table_without_a_column_is_refused(results, name):
    with pytest.raises(ValueError, match=f'the table has no column {name}: it needs world, str'):
        Results(results.to_dataframe().drop(columns=name))


@for_each('text, complaint', [
    ('', 'No columns to parse'),
    ('1,a,0,log_loss,x', 'the column value is of object: it must be of numbers'),
    ('1,a,x,log_loss,1', 'the column robot is of object: it must be of whole numbers'),
    ('1,a,0,log_loss,1\n1,a,0,log_loss,2', 'row 2 has a value that an earlier row has'),
    ('1,a,0,log_loss,1,2', 'its rows have more values than its header'),
])  # fmt: skip
def test_a_file_that_is_no_table_is_named(tmp_path, text, complaint):
    file = tmp_path / 'mine.csv'
    tmp_path.mkdir(exist_ok=True)
    file.write_text(text and f'{",".join(KEYS)}\n{text}\n')
    with pytest.raises(ValueError, match=f'mine.csv is not the table of a study: {complaint}'):
        Results.read(file)


def test_strategies_may_be_named_by_numbers(results, tmp_path):
    numbered = results.to_dataframe().replace({'strategy': {FIRST: '1', EXACT: '2'}})
    (tmp_path / 'mine.csv').write_text(numbered[numbered['strategy'].isin(['1', '2'])].to_csv())
    assert Results.read(tmp_path / 'mine.csv').strategies == ['1', '2']


@for_each('make, error, words', [
    (lambda _: Results([1]), TypeError, r'table is \[1\]: it must be a DataFrame'),
    (lambda _: Results.read(None), TypeError, 'path is None: it must be the path of a file'),
    (lambda r: r.write(3), TypeError, 'folder is 3: it must be the path of a file or folder'),
    (lambda r: r.means(None), ValueError, 'measure is None: see .measures'),
    (lambda r: r.means(robot='x'), TypeError, "robot is 'x': it must be a number"),
    (lambda r: r.means(rng='x'), TypeError, "rng is 'x': it must be a seed"),
    (lambda r: r.difference([], FIRST), ValueError, r'strategy \[\] is unknown'),
    (lambda _: bootstrap(3), ValueError, 'samples is 3: it must have a value for each world'),
    (lambda _: bootstrap(['x']), TypeError, r"samples is \['x'\]: it must be an array of num"),
    (lambda r: curves(r, 3), ValueError, 'measure is 3: see .measures'),
    (lambda _: curves(3, 'entropy'), TypeError, r'results is 3: it must be Results.read\(...\)'),
    (lambda r: differences(r, 'log_los'), ValueError, 'did you mean log_loss'),
])  # fmt: skip
def test_wrong_arguments_are_refused(results, make, error, words):
    with pytest.raises(error, match=words):
        make(results)


def test_the_interval_is_that_of_resampled_means():
    samples = np.array([1.0, 2.0, 3.0, 10.0])
    rng = np.random.default_rng(1)
    resampled = rng.choice(samples, (100_000, 4)).mean(axis=1)
    expected = np.quantile(resampled, (0.025, 0.975))
    np.testing.assert_allclose(bootstrap(samples)[1:], expected, atol=0.2)
    np.testing.assert_allclose(bootstrap(samples, rng)[1:], expected, atol=0.3)
    assert bootstrap(np.arange(30.0), rng) != bootstrap(np.arange(30.0))
    assert bootstrap(samples) == bootstrap(samples, np.random.default_rng(0))
    both = bootstrap(np.stack([samples, 2 * samples], axis=1))
    np.testing.assert_array_equal([each[1] for each in both], 2 * np.array([e[0] for e in both]))


def final(scenario, outcomes, method, name):
    return np.array([outcomes[Trial(0.9, method, n)][name].iloc[-1] for n in range(3)])


def test_differences_are_paired_by_world(results, outcomes, scenario):
    exact, first = (final(scenario, outcomes, each, 'log_loss') for each in (EXACT, FIRST))
    found = results.difference(EXACT, FIRST).set_index('lethality').loc[0.9]
    assert found[['mean', 'low', 'high']].tolist() == list(bootstrap(exact - first))
    assert found['worlds'] == 3
    # Rows in any order, and worlds that only one has, change nothing.
    table = results.to_dataframe()
    fewer = Results(table[~((table['world'] == 2) & (table['strategy'] == FIRST))].sample(frac=1))
    pair = fewer.difference(EXACT, FIRST).set_index('lethality').loc[0.9]
    assert pair['mean'] == pytest.approx((exact - first)[:2].mean())
    assert pair['worlds'] == 2
    early = results.difference(EXACT, FIRST, 'robots_lost', robot=1)
    assert early['mean'].tolist() == [0.0, 0.0]


@for_each('given, complaint', [
    ((EXACT, 'magic'), "strategy 'magic' is unknown: the table has relaxed_bnitp, kappa"),
    ((EXACT, FIRST, 'log_los'), "measure is 'log_los': did you mean log_loss"),
    ((EXACT, FIRST, 'log_loss', 9), 'robot is 9: it must be one of the table, such as 4'),
])  # fmt: skip
def test_what_a_table_lacks_is_refused(results, given, complaint):
    with pytest.raises(ValueError, match=complaint):
        results.difference(*given)


def test_the_summary_has_means_and_differences_with_intervals(results, outcomes, scenario):
    rows = results.summary().set_index(['lethality', 'strategy'])
    assert len(rows) == 6
    printed, first = (final(scenario, outcomes, each, 'log_loss') for each in (PRINTED, FIRST))
    for samples, name in ((printed, 'log loss'), (printed - first, 'difference')):
        mean, low, high = bootstrap(samples)
        assert rows.loc[(0.9, PRINTED), name] == f'{mean:.1f} [{low:.1f}, {high:.1f}]'
    assert rows.loc[(0.9, FIRST), 'difference'] == ''
    lost = final(scenario, outcomes, PRINTED, 'robots_lost').mean()
    assert rows.loc[(0.9, PRINTED), 'robots lost'].startswith(f'{lost:.1f} [')


def test_a_table_in_latex_has_the_cells_of_that_in_markdown(chosen):
    _, results = chosen
    latex = results.latex()
    assert latex.count('{') == latex.count('}')
    rows = latex.partition('\\midrule\n')[2].partition('\\bottomrule')[0].splitlines()
    lines = results.markdown().splitlines()[4:]
    assert len(lines) == 2 * 8 * 3
    for row, line in zip(rows, lines, strict=True):
        cells = row.removesuffix(r' \\').split(' & ')
        plain = [cell.replace(r'\_', '_').strip() for cell in cells]
        assert plain == [cell.strip() for cell in line[1:-1].split('|')]
    assert r'95 \% bootstrap' in latex


def test_a_single_world_has_no_interval(results):
    table = results.to_dataframe()
    alone = Results(table[table['world'] == 0])
    assert alone.means('entropy')['low'].isna().all()
    assert '[' not in alone.markdown().split('|---|')[1]


def test_a_full_disk_is_reported_by_file(results, tmp_path):
    with room_for(1000), pytest.raises(OSError, match=f'File too large: .{tmp_path}'):
        write_report(results, tmp_path)


MANY = {
    'planners': {'teams': tuple(Strategy(planner=name) for name in ('', 'coverage', 'random'))},
    'costs': {
        'teams': tuple(Strategy(loss_cost=cost) for cost in (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)),
        'lethalities': (0.1, 0.3, 0.5),
    },
    'contacts': {'teams': (Strategy(), Strategy(last_contact=0.5)), 'trials': 1},
    'lethalities': {'lethalities': (0.01, 0.1, 0.3, 0.5, 0.6, 0.9)},
}


@pytest.mark.slow
@for_each('name', MANY, every=4)
def test_figures_are_legible(scenario, name):
    changes = {'methods': ('kappa_bnitp',), 'trials': 2} | MANY[name]
    study = single(replace(scenario, **changes))
    figures = study_figures(Results.of(study, run(study)))
    assert {'entropy', 'log_loss', 'final'} <= figures.keys()
    assert ('differences' in figures) == (len(study.first.contenders) > 1)
    for figure in figures.values():
        check_texts(figure)
    for name in figures.keys() - {'final'}:
        check_lines(figures[name])


@pytest.mark.slow
@pytest.mark.full
def test_figures_of_choices_are_legible(chosen):
    for figure in study_figures(chosen[1]).values():
        check_texts(figure)


def test_lines_are_the_measured_values(chosen):
    """The paired differences are read back from the figure."""
    _, results = chosen
    panels = iter(differences(results, 'log_loss').axes)
    for _, series in results.series('log_loss'):
        axes = next(panels)
        lines = [line for line in axes.lines if len(line.get_xdata()) == 4]
        for strategy, line in zip((PRINTED, EXACT), lines, strict=True):
            expected = (series[strategy] - series[FIRST]).mean()
            np.testing.assert_allclose(line.get_ydata(), expected, atol=1e-12)
