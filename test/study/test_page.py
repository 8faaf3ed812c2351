# SPDX-License-Identifier: Apache-2.0
"""The statements of docs/results.md follow from its tables, its example from arithmetic."""

from itertools import product
from math import prod
from pathlib import Path
import re
from runpy import run_path
from shutil import copytree, ignore_patterns

from kbnitp_ros.core import log_loss, World
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario_file import read_study
from laws import for_each
import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / 'docs'
SCENARIOS = DOCS.parent / 'config/scenarios'
TOOL = DOCS.parent / 'tools/results_page.py'
LETHALITIES = (0.01, 0.1, 0.3, 0.5, 0.6, 0.9)
PRINTED = ('relaxed_bnitp', 'kappa_bnitp_published')


def split_row(line):
    return [cell.strip() for cell in line.strip('|\n ').split('|')]


def table_rows(mark):
    """Return the rows of the table behind a mark of docs/results.md, [{column: text}]."""
    block = (DOCS / 'results.md').read_text().partition(f'<!-- {mark} -->\n')[2]
    header, _, *lines = map(split_row, re.search(r'(?:^\|.*\n)+', block, re.M)[0].splitlines())
    return [dict(zip(header, line, strict=True)) for line in lines]


def numbers(cell):
    return tuple(map(float, re.findall(r'-?\d+\.\d+', cell)))


def results():
    """Return the text of all pages of results."""
    pages = [DOCS / 'results.md', *sorted(DOCS.glob('results/*.md'))]
    return '\n'.join(page.read_text() for page in pages)


def test_every_figure_is_shown():
    shown = re.findall(r'\]\((?:\.\./)?images/(\w+\.png)\)', results())
    others = ('before_after', 'benchmark', 'board', 'day', 'maps', 'nav2', 'page')
    there = {each.name for each in (DOCS / 'images').iterdir() if not each.stem.startswith(others)}
    assert sorted(shown) == sorted(there)


def test_every_study_of_the_page_has_a_page_of_tables():
    linked = set(re.findall(r'\]\((?:\.\./)?tables/(\w+)\.md\)', results()))
    assert sorted(linked) == sorted(each.stem for each in (DOCS / 'tables').glob('*.md'))


def test_numbers_on_the_pages_are_in_the_tables_of_their_studies():
    number = re.compile(r'-?\d+(?:\.\d+)?')
    checked = []
    for page in sorted(DOCS.glob('results/*.md')):
        for section in re.split('^(?=#)', page.read_text(), flags=re.MULTILINE):
            scenarios = re.findall(r'\]\(\.\./tables/(\w+)\.md\)', section)
            tables = [(DOCS / f'tables/{scenario}.md').read_text() for scenario in scenarios]
            told = {found for table in tables for found in number.findall(table)}
            told |= {f'{float(found):.0f}' for found in told}
            for row in re.findall(r'^\| (?!lethality|study|---).*', section, re.MULTILINE):
                if scenarios:
                    assert set(number.findall(row)) <= told, row
                    checked += scenarios
    assert {*checked} > {'changing_hazards', 'blobs', 'lanes', 'areas', 'certificates'}


@pytest.mark.full
@pytest.mark.parametrize('scenario', ['paper', 'calibrated', 'mismatched'])
def test_the_pages_are_made_of_the_tables(tmp_path, scenario):
    others = {'paper', 'calibrated', 'mismatched'} - {scenario}
    without = ignore_patterns(*(f'{each}.csv.gz' for each in others))
    docs = copytree(DOCS, tmp_path / 'docs', ignore=without)
    made = [docs / 'results.md', *sorted(docs.glob('tables/*.md'))]
    before = {page: page.read_text() for page in made}
    page, mark = docs / f'tables/{scenario}.md', 'table'
    if scenario == 'paper':
        page, mark = made[0], 'verdicts'
    emptied = re.sub(f'(<!-- {mark} -->\n).*?(<!-- end -->)', r'\1\2', before[page], flags=re.S)
    assert emptied != before[page]
    page.write_text(emptied)
    run_path(str(TOOL))['main'](docs)
    assert {page: page.read_text() for page in made} == before


@pytest.fixture(scope='module')
def paper():
    """Return the last row of each mission of the paper's study, and its first log loss."""
    return Results.read(DOCS / 'tables/paper.csv.gz').to_dataframe()


@for_each(
    'mark, measure', [('verdicts', None), ('default', 'log_loss'), ('default', 'robots_lost')]
)
def test_differences_of_the_page_are_means_of_the_table(paper, mark, measure):
    """By another way than the tool's: the difference of means."""
    base = paper.query(
        "hazard == 0.5 and target == 0.45 and `prior.kappa` == 0.8 and ties == 'first' and "
        'max_steps == 18'
    )
    keys = ['measure', 'lethality', 'max_visits', 'strategy', 'robot']
    means = base.groupby(keys, observed=True)['value'].mean()
    for place, row in enumerate(table_rows(mark)):
        for visits in (1, 3):
            a_cell = f'{visits} visit{"s" * (visits > 1)} a cell'
            if mark == 'default':
                at = measure, float(row['lethality']), visits
                cell = row[f'{measure.replace("_", " ")}, {a_cell}']
                expected = [means[(*at, 'kappa_bnitp', 100)] - means[(*at, PRINTED[1], 100)]]
            else:
                lethality = (0.5, 0.6, 0.9, 0.3, 0.1, 0.01, 0.9, 0.5, 0.5)[place]
                at = row['measure'].replace(' ', '_'), lethality, visits
                cell = row[a_cell]
                others = {'ITP': 'relaxed_itp', 'BNITP': 'relaxed_bnitp', 'the prior': PRINTED[1]}
                expected = [
                    means[(*at, PRINTED[1], 100)]
                    - means[(*at, others[name], 0 if name == 'the prior' else 100)]
                    for name in re.findall(r'(ITP|BNITP|the prior): ', cell)
                ]
            found = [float(each) for each in re.findall(r'(-?\d+\.\d+) \[', cell)]
            assert found == pytest.approx(expected, abs=0.051)


def test_verdicts_follow_from_the_intervals_of_the_page():
    for row in table_rows('verdicts'):
        claim = row['claim of the paper']
        is_below = claim.startswith(('At 50', 'At 60', 'κ', 'Entropy'))
        held = []
        for visits in ('1 visit a cell', '3 visits a cell'):
            intervals = re.findall(r'\[(-?\d+\.\d+), (-?\d+\.\d+)\]', row[visits])
            ends = [(float(low), float(high)) for low, high in intervals]
            held.append(all(high < 0 if is_below else low > 0 for low, high in ends))
        words = row['verdict'].strip('*')
        assert (
            words.partition(':')[0]
            == {
                (True, True): 'reproduced',
                (True, False): 'reproduced only with 1 visit a cell',
                (False, True): 'reproduced only with 3 visits a cell',
                (False, False): 'not reproduced',
            }[tuple(held)]
        ), claim


@for_each(
    'scenario, worse, before',
    [('paper', LETHALITIES[3:], 107), ('calibrated', LETHALITIES[2:], 75)],
)
def test_the_printed_update_can_be_worse_than_the_prior(scenario, worse, before):
    table = Results.read(DOCS / f'tables/{scenario}.csv.gz').to_dataframe()
    for name, value in (('ties', 'first'), ('hazard', 0.5), ('target', 0.45), ('max_steps', 18)):
        table = table[table[name] == value] if name in table else table
    if scenario == 'paper':
        table = table[table['prior.kappa'] == 0.8]
    keys = ['measure', 'lethality', 'strategy', 'robot']
    means = table.groupby(keys, observed=True)['value'].mean()
    for lethality, method in product(LETHALITIES, (*PRINTED, 'relaxed_itp', 'kappa_bnitp')):
        rises = means['log_loss', lethality, method, 100] > means['log_loss', lethality, method, 0]
        assert rises == (method in PRINTED and lethality in worse), (lethality, method)
        assert means['entropy', lethality, method, 100] < before


@for_each('name, nats', [('paper', 107), ('calibrated', 75)])
def test_the_log_loss_before_the_first_robot(name, nats):
    scenario = read_study(SCENARIOS / f'{name}.yaml').first
    prior = scenario.belief(scenario.truth(0.5, 0))
    losses = []
    for number in range(scenario.trials):
        rng = np.random.default_rng([scenario.seed, number])
        world = World.random(scenario.field(), rng, **vars(scenario.world))
        losses.append(log_loss(prior.hazard, world.hazard) + log_loss(prior.target, world.target))
    assert round(np.mean(losses)) == nats
    assert f'{nats} nats' in (DOCS / 'results.md').read_text()


def survival(lethality=0.9):
    return np.array([0.95, 0.95 * (1 - lethality * 0.95)])


def printed_loss(hazards):
    """Return the hazards of a, b and c after a loss, by the formula on the page."""
    s0, s1 = survival()
    marginals = [(1 - z) * (1 - s0) + z * (1 - s1) for z in hazards] + [1 - s0]
    w = [d * prod(1 - before for before in marginals[:j]) for j, d in enumerate(marginals)]
    after = []
    for z, own in zip(hazards, w):
        safe, hazardous = (own * (1 - s) + (sum(w) - own) * s for s in (s0, s1))
        assert hazardous - safe == pytest.approx((s0 - s1) * (2 * own / sum(w) - 1) * sum(w))
        after.append(z * hazardous / (z * hazardous + (1 - z) * safe))
    return after, w


def exact_hazard(losses):
    """Return the hazard of a, equal to that of b and c, by enumeration."""
    s0, s1 = survival()
    states = list(product((0, 1), repeat=3))
    weights = [(1 - s0 ** (4 - sum(z)) * s1 ** sum(z)) ** losses for z in states]
    return sum(w for z, w in zip(states, weights) if z[0]) / sum(weights)


def test_the_example_is_right():
    text = (DOCS / 'results.md').read_text()
    _, w = printed_loss([0.5] * 3)
    assert 'w = {:.4f}, {:.4f}, {:.4f} and {:.4f}'.format(*w) in text
    assert f'= {survival()[1]:.5f}' in text
    lines = [split_row(line) for line in text.splitlines() if re.match(r'\| \d \|', line)]
    hazards = [0.5] * 3
    for losses, line in enumerate(lines):
        assert line == [f'{losses}', *(f'{p:.4f}' for p in (*hazards, exact_hazard(losses)))]
        hazards, _ = printed_loss(hazards)
    assert len(lines) == 6
