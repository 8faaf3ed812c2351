# SPDX-License-Identifier: Apache-2.0
"""What docs/results.md says follows from the tables, and its example from arithmetic."""

from itertools import product
from math import prod
from pathlib import Path
import re
import subprocess
import sys

from kbnitp_ros.core import log_loss, World
from kbnitp_ros.study.scenario import in_short, SAMPLED, team_labels
from kbnitp_ros.study.scenario_file import read_scenario
from laws import for_each
import numpy as np
from PIL import Image
import pytest

DOCS = Path(__file__).parents[2] / 'docs'
SCENARIOS = DOCS.parent / 'scenarios'
METHODS = read_scenario(SCENARIOS / 'paper.yaml').methods
LETHALITIES = (0.01, 0.1, 0.3, 0.5, 0.6, 0.9)
FEW = ('25', '50', '100')


def cells_of(line):
    return [cell.strip() for cell in line.strip('|\n ').split('|')]


def text_of(scenario):
    """Return what stands between the marks of a scenario's page of tables."""
    text = (DOCS / f'tables/{scenario}.md').read_text()
    (block,) = re.findall('<!-- table -->\n(.*?)<!-- end -->', text, re.DOTALL)
    return block


def rows_of(scenario, place=0):
    """Return the rows of a scenario's first or second table, [{column: text}]."""
    tables = re.findall(r'(?:^\|.*\n)+', text_of(scenario), re.MULTILINE)
    header, _, *lines = map(cells_of, tables[place].splitlines())
    return [dict(zip(header, line)) for line in lines]


def numbers(cell):
    """Return (mean, low, high), or what there is of it."""
    return tuple(map(float, re.findall(r'-?\d+\.\d+', cell)))


def table(scenario):
    """Return {(lethality, method): {column: (mean, low, high)}}."""
    return {
        (float(row['lethality']), row['method'].strip('`')): {
            column: numbers(cell) for column, cell in row.items()
        }
        for row in rows_of(scenario)
    }


@for_each('path', sorted((DOCS / 'tables').glob('*.md')))
def test_tables_are_of_whole_studies_and_call_rows_as_a_study_does(path):
    scenario = read_scenario(SCENARIOS / path.name.replace('.md', '.yaml'))
    labels = team_labels(scenario)
    told = [(row['lethality'], row['method'].partition(', ')[2]) for row in rows_of(path.stem)]
    assert told == [
        (in_short(lethality), labels[team])
        for lethality in scenario.lethalities
        for _, team in scenario.contenders
    ]
    (said,) = re.findall(r'^After (\d+) robots: means of (\d+) trials', text_of(path.stem))
    assert said == (str(scenario.robots), str(scenario.trials))


def test_every_figure_is_shown():
    shown = re.findall(r'\]\(images/(\w+\.png)\)', (DOCS / 'results.md').read_text())
    others = {'benchmark', 'maps', 'page', 'page_curves', 'page_dark', 'page_early', 'page_kinds'}
    there = {path.name for path in (DOCS / 'images').iterdir() if path.stem not in others}
    assert sorted(shown) == sorted(there)


@for_each(
    'scenario, before, worse',
    [('paper', 107, (0.5, 0.6, 0.9)), ('calibrated', 74, LETHALITIES[2:])],
)
def test_where_the_printed_update_knows_less_than_nothing(scenario, before, worse):
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
def test_what_is_known_before_the_first_robot(name, nats):
    scenario = read_scenario(SCENARIOS / f'{name}.yaml')
    prior = scenario.belief(scenario.truth(0.5, 0))
    losses = []
    for number in range(scenario.trials):
        rng = np.random.default_rng([scenario.seed, number])
        world = World.random(scenario.field(), rng, **vars(scenario.world))
        losses.append(log_loss(prior.hazard, world.hazard) + log_loss(prior.target, world.target))
    assert round(np.mean(losses)) == nats
    assert f'{nats} nats' in (DOCS / 'results.md').read_text()


LEARNT = ('unknown_lethality', 'mismatched_learning', 'paper_learning', 'unknown')


def learnt(name):
    """Return three tables of a study that learns: at the end, of numbers, of costs, by keys."""
    tables = []
    for place, key in enumerate(('method', 'number', 'method')):
        tables.append(
            {
                (row['lethality'], row[key].strip('`')): {
                    column: numbers(cell) for column, cell in row.items()
                }
                for row in rows_of(name, place)
            }
        )
    return tables


@for_each('name', LEARNT)
def test_the_page_shows_full_studies_of_what_is_learnt(name):
    scenario = read_scenario(SCENARIOS / f'{name}.yaml')
    final, known, costs = learnt(name)
    lethalities = [in_short(lethality) for lethality in scenario.lethalities]
    assert set(final) == set(product(lethalities, scenario.methods))
    assert set(known) == set(product(lethalities, scenario.learn.priors))
    assert set(costs) == set(product(lethalities, (SAMPLED,)))


# The example


def survival(lethality=0.9):
    return np.array([0.95, 0.95 * (1 - lethality * 0.95)])


def printed_loss(hazards):
    """Return the hazards of a, b and c after a loss, by the formula of the page."""
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
    """Return the hazard of a, which is that of b and c, by enumeration."""
    s0, s1 = survival()
    states = list(product((0, 1), repeat=3))
    weights = [(1 - s0 ** (4 - sum(z)) * s1 ** sum(z)) ** losses for z in states]
    return sum(w for z, w in zip(states, weights) if z[0]) / sum(weights)


def test_the_example_is_right():
    text = (DOCS / 'results.md').read_text()
    _, w = printed_loss([0.5] * 3)
    assert 'w = {:.4f}, {:.4f}, {:.4f} and {:.4f}'.format(*w) in text
    assert f'= {survival()[1]:.5f}' in text
    lines = [cells_of(line) for line in text.splitlines() if re.match(r'\| \d \|', line)]
    hazards = [0.5] * 3
    for losses, line in enumerate(lines):
        assert line == [f'{losses}', *(f'{p:.4f}' for p in (*hazards, exact_hazard(losses)))]
        hazards, _ = printed_loss(hazards)
    assert len(lines) == 6


@pytest.mark.processes
def test_tables_are_brought_between_their_marks_and_figures_that_are_shown(tmp_path):
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


def test_what_it_costs_to_believe_that_hazards_stay():
    """Where they come and go, on the same evidence; no belief in the wrong kind does better."""
    each, differences = rows_of('changing_hazards', 1), rows_of('changing_hazards', 2)
    told = {(row['lethality'], row['believed']): row for row in each}
    text = (DOCS / 'results.md').read_text()
    for lethality in (0.1, 0.3, 0.5, 0.9):
        beliefs = [
            told[str(lethality), f'{kind} paths'] for kind in ('static, own', 'changing, static')
        ]
        ends = [
            ', '.join(f'{numbers(row[robots])[0]}' for robots in ('100', '200')) for row in beliefs
        ]
        assert f'| {lethality} | {ends[0]} | {ends[1]} |' in text
    for row in differences:
        mean, low, _ = numbers(row['200'])
        is_wrong = not row['believed'].startswith('changing')
        assert low > 10.0 if is_wrong else mean < 9.0, row


def test_what_the_belief_in_used_up_hazards_is_worth():
    told = {(row['lethality'], row['believed']): row for row in rows_of('used_up_hazards', 1)}
    text = (DOCS / 'results.md').read_text()
    for lethality in (0.1, 0.3, 0.5, 0.9):
        used_up, static = (
            ', '.join(f'{numbers(told[str(lethality), kind][robots])[0]}' for robots in FEW)
            for kind in ('used up', 'static')
        )
        assert f'| {lethality} | {used_up} | {static} |' in text
    for row in rows_of('used_up_hazards', 2):
        assert 1.0 < numbers(row['100'])[1] < numbers(row['100'])[0] < 10.0
        assert -10.0 < numbers(row['more lost'])[0] < numbers(row['more lost'])[2] < 0.0


def test_what_the_wrong_belief_costs_where_hazards_stay():
    text = (DOCS / 'results.md').read_text()
    rows = iter(numbers(row['log loss'])[0] for row in rows_of('static_hazards'))
    for lethality, *ends in zip((0.1, 0.3, 0.5, 0.9), rows, rows, rows):
        assert f'| {lethality} | {" | ".join(map(str, ends))} |' in text
    for row in rows_of('static_hazards', 2):
        mean, low, _ = numbers(row['100'])
        assert low > 0.0
        assert (2.0 < mean < 6.0) == (row['believed'] == 'changing')


@for_each('scenario, order', [('blobs', 'blobs'), ('rows', 'rows'), ('scattered', 'no order')])
def test_what_the_belief_in_clusters_is_worth(scenario, order):
    def told(row):
        few, more, most = (numbers(row[robots]) for robots in FEW)
        return f'{few[0]}, {more[0]}, {most[0]} [{most[1]}, {most[2]}]'

    same, own = map(told, rows_of(scenario, 2))
    assert f'| {order} | {same} | {own} |' in (DOCS / 'results.md').read_text()


def test_every_study_of_the_page_has_a_page_of_tables():
    linked = re.findall(r'\]\(tables/(\w+)\.md\)', (DOCS / 'results.md').read_text())
    assert sorted(linked) == sorted(each.stem for each in (DOCS / 'tables').glob('*.md'))
    for scenario in linked:
        assert '../results.md#' in (DOCS / f'tables/{scenario}.md').read_text()


def test_what_it_takes_to_declare_areas_free():
    (said,) = re.findall(
        r'\| lethality \| goal `area` .*\n\|.*\n((?:\|.*\n)+)', (DOCS / 'results.md').read_text()
    )
    rows = rows_of('areas', 1)
    for line, four in zip(map(cells_of, said.splitlines()), zip(*[iter(rows)] * 4)):
        for cell, at in zip(line[1:], (1, 0, 2, 3)):
            robots, lost, worlds = (
                numbers(four[at][of])[0] for of in ('robots', 'lost', 'worlds')
            )
            assert cell == f'{robots:.0f}, {lost:.0f} lost, ' + (
                f'{worlds:.2f}' if worlds else '0'
            )
    most = [max(numbers(row['wrongly'])[0] for row in rows[at:][:4]) for at in (0, 4, 8)]
    assert most == [0.026, 0.007, 0.003]
    more = [numbers(rows[at]['more robots']) for at in (1, 5, 9)]
    assert [each[0] for each in more] == [-2.7, -2.5, -3.8]
    assert all(low < 0 < high for _, low, high in more)


def test_what_a_goal_is_worth():
    text = (DOCS / 'results.md').read_text()
    (said,) = re.findall(r'\| lethality \| mission .*\n\|.*\n((?:\|.*\n)+)', text)
    rows = rows_of('lanes', 1)
    names = {'goal lane': 'goal `lane`', 'goal safest_lane': 'safest lane', 'goal map': 'map'}
    shown = {
        (row['lethality'], names[row['strategy']]): [
            ', '.join(each[of].split()[0] for each in rows[at:][:4])
            for of in ('free', 'believed', 'lost')
        ]
        for at, row in enumerate(rows)
        if row['robots'] == '10'
    }
    assert {(line[0], line[1]): line[2:] for line in map(cells_of, said.splitlines())} == shown
    more = {
        (row['lethality'], row['robots']): numbers(row['more free'])
        for row in rows
        if row['strategy'] == 'goal lane'
    }
    early = [more[lethality, robots] for lethality in ('0.3', '0.5', '0.9') for robots in FEW[:1]]
    early += [more[lethality, '10'] for lethality in ('0.3', '0.5', '0.9')]
    assert (min(early)[0], max(early)[0]) == (0.12, 0.23)
    assert more['0.1', '50'][0] < 0 < more['0.1', '10'][1]
    assert max(abs(numbers(r['free'])[0] - numbers(r['believed'])[0]) for r in rows) <= 0.051


def test_how_far_certificates_may_be_relied_on():
    text = (DOCS / 'results.md').read_text()
    (said,) = re.findall(r'\| study \| method \| asked .*\n\|.*\n((?:\|.*\n)+)', text)
    shown = [line.strip('| ').split(' | ') for line in said.splitlines()]
    told = [
        [
            f'`{name}`',
            row['method'].replace('_learning', ''),
            row['confidence'],
            row['missions'],
            row['robots'].split()[0],
            row['stated'].split()[0],
            row['free'],
            row['difference'],
        ]
        for name, place in (
            ('certificates', 1),
            ('certificates_learning', 3),
            ('certificates_clustered', 1),
        )
        for row in rows_of(name, place)
    ]
    assert shown == told
    for line in shown:
        free, difference = numbers(line[-2]), numbers(line[-1])
        assert difference[1] <= 0 <= difference[2]
        assert difference[0] >= -0.01
        asked = float(line[2])
        assert free[0] > asked if asked < 0.99 else abs(free[0] - asked) < 0.004
