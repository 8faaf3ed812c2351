# SPDX-License-Identifier: Apache-2.0
"""The statements of docs/results.md follow from its tables, its example from arithmetic."""

from itertools import product
from math import prod
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_ros.core import log_loss, World
from kbnitp_ros.study.scenario import in_short, team_labels
from kbnitp_ros.study.scenario_file import read_scenario
from laws import for_each
import numpy as np
from PIL import Image
import pytest

DOCS = Path(__file__).parents[2] / 'docs'
SCENARIOS = DOCS.parent / 'config/scenarios'
METHODS = read_scenario(SCENARIOS / 'paper.yaml').methods
LETHALITIES = (0.01, 0.1, 0.3, 0.5, 0.6, 0.9)
FEW = ('25', '50', '100')


def split_row(line):
    return [cell.strip() for cell in line.strip('|\n ').split('|')]


def table_text(scenario):
    text = (DOCS / f'tables/{scenario}.md').read_text()
    (block,) = re.findall('<!-- table -->\n(.*?)<!-- end -->', text, re.DOTALL)
    return block


def table_rows(scenario, place=0):
    """Return the rows of a scenario's first or second table, [{column: text}]."""
    tables = re.findall(r'(?:^\|.*\n)+', table_text(scenario), re.MULTILINE)
    header, _, *lines = map(split_row, tables[place].splitlines())
    return [dict(zip(header, line)) for line in lines]


def numbers(cell):
    return tuple(map(float, re.findall(r'-?\d+\.\d+', cell)))


def table(scenario):
    """Return {(lethality, method): {column: (mean, low, high)}}."""
    return {
        (float(row['lethality']), row['method'].strip('`')): {
            column: numbers(cell) for column, cell in row.items()
        }
        for row in table_rows(scenario)
    }


@for_each('path', sorted((DOCS / 'tables').glob('*.md')))
def test_tables_are_of_whole_studies_with_their_names_of_rows(path):
    scenario = read_scenario(SCENARIOS / path.name.replace('.md', '.yaml'))
    labels = team_labels(scenario)
    told = [(row['lethality'], row['method'].partition(', ')[2]) for row in table_rows(path.stem)]
    assert told == [
        (in_short(lethality), labels[team])
        for lethality in scenario.lethalities
        for _, team in scenario.contenders
    ]
    (said,) = re.findall(r'^After (\d+) robots: means of (\d+) trials', table_text(path.stem))
    assert said == (str(scenario.robots), str(scenario.trials))


def results():
    """Return the text of all pages of results."""
    pages = [DOCS / 'results.md', *sorted(DOCS.glob('results/*.md'))]
    return '\n'.join(page.read_text() for page in pages)


def test_every_figure_is_shown():
    shown = re.findall(r'\]\((?:\.\./)?images/(\w+\.png)\)', results())
    others = ('before_after', 'benchmark', 'maps', 'page')
    there = {each.name for each in (DOCS / 'images').iterdir() if not each.stem.startswith(others)}
    assert sorted(shown) == sorted(there)


@for_each(
    'scenario, before, worse',
    [('paper', 107, (0.5, 0.6, 0.9)), ('calibrated', 74, LETHALITIES[2:])],
)
def test_the_printed_update_can_be_worse_than_the_prior(scenario, before, worse):
    rows = table(scenario)
    for lethality, method in product(LETHALITIES, METHODS):
        printed = method in ('relaxed_bnitp', 'kappa_bnitp_published')
        assert (rows[lethality, method]['log loss'][1] > before) == (
            printed and lethality in worse
        )
        assert rows[lethality, method]['entropy'][2] < before
    for lethality in LETHALITIES[1:]:
        lost = [rows[lethality, method]['robots lost'][0] for method in METHODS]
        assert min(lost[1:3]) > max(lost[0], *lost[3:])


@for_each('name, nats', [('paper', 107), ('calibrated', 74)])
def test_the_log_loss_before_the_first_robot(name, nats):
    scenario = read_scenario(SCENARIOS / f'{name}.yaml')
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


@pytest.mark.processes
def test_tables_and_shown_figures_are_copied_to_the_pages(tmp_path):
    runs, docs = tmp_path / 'runs', tmp_path / 'docs'
    (runs / 'paper').mkdir(parents=True)
    (docs / 'images').mkdir(parents=True)
    colours = {'entropy': 'red', 'log_loss': 'blue', 'reliability': 'lime'}
    for figure, colour in colours.items():
        Image.new('RGB', (3200, 1000), colour).save(runs / 'paper' / f'{figure}.png')
    (runs / 'paper' / 'summary.md').write_text('new\n')
    shown = (
        '![Words](images/paper_entropy.png)\n![Words](images/other_log_loss.png)\n'
        '![Words](images/paper_log_loss.png)\n'
    )
    (docs / 'results.md').write_text(shown)
    (docs / 'tables').mkdir()
    before = 'Words\n<!-- table -->\nold\nold\n<!-- end -->\nWords\n'
    (docs / 'tables/paper.md').write_text(before)
    subprocess.run([sys.executable, DOCS.parent / 'tools/results_page.py', runs, docs], check=True)
    assert (docs / 'results.md').read_text() == shown
    assert (docs / 'tables/paper.md').read_text() == before.replace('old\nold\n', 'new\n')
    brought = {path.name: Image.open(path) for path in (docs / 'images').iterdir()}
    assert brought.keys() == {'paper_entropy.png', 'paper_log_loss.png'}
    for name, colour in (('paper_entropy.png', (255, 0, 0)), ('paper_log_loss.png', (0, 0, 255))):
        assert brought[name].size == (1600, 500)
        assert brought[name].convert('RGB').getpixel((800, 250)) == colour


def test_every_study_of_the_page_has_a_page_of_tables():
    linked = re.findall(r'\]\((?:\.\./)?tables/(\w+)\.md\)', results())
    assert sorted(linked) == sorted(each.stem for each in (DOCS / 'tables').glob('*.md'))
    for scenario in linked:
        page = (DOCS / f'tables/{scenario}.md').read_text()
        assert re.search(r'\[Results\]\(\.\./results(/\w+)?\.md#', page)


def test_numbers_on_the_page_are_in_the_tables_of_their_studies():
    number = re.compile(r'-?\d+(?:\.\d+)?')
    checked = []
    for section in re.split('^(?=#)', results(), flags=re.MULTILINE):
        scenarios = re.findall(r'\]\((?:\.\./)?tables/(\w+)\.md\)', section)
        told = {n for scenario in scenarios for n in number.findall(table_text(scenario))}
        told |= {f'{float(n):.0f}' for n in told}
        for row in re.findall(r'^\| (?!lethality|study|---).*', section, re.MULTILINE):
            if scenarios:
                assert set(number.findall(row)) <= told, row
                checked += scenarios
    assert {*checked} > {'changing_hazards', 'blobs', 'lanes', 'areas', 'certificates'}


def test_lanes_that_are_certified_are_free_as_often_as_stated():
    for name, place in (('', 1), ('_learning', 3), ('_clustered', 1)):
        for row in table_rows(f'certificates{name}', place):
            free, (difference, _, high) = numbers(row['free']), numbers(row['difference'])
            assert difference >= -0.01
            assert high >= 0
            asked = float(row['confidence'])
            assert free[0] > asked - (0.004 if asked == 0.99 else 0)
