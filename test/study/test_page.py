# SPDX-License-Identifier: Apache-2.0
"""What docs/results.md says follows from its tables, and its example from arithmetic."""

from itertools import product
from math import prod
from pathlib import Path
import re

from kbnitp_ros.core import METHODS
from kbnitp_ros.study import page
import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / 'docs'
PAPER = METHODS[:3]
LETHALITIES = (0.01, 0.1, 0.3, 0.5, 0.6, 0.9)


def cells_of(line):
    return [cell.strip() for cell in line.strip('|\n ').split('|')]


def table(scenario):
    """Return {(lethality, method): {column: (mean, low, high)}}."""
    text = (DOCS / 'results.md').read_text()
    (block,) = re.findall(f'<!-- table {scenario} -->\n(.*?)<!-- end -->', text, re.DOTALL)
    header, _, *lines = [cells_of(line) for line in block.splitlines() if line.startswith('|')]
    rows = {}
    for lethality, method, *entries in lines:
        values = [tuple(map(float, re.findall(r'-?\d+\.\d+', entry))) for entry in entries]
        rows[float(lethality), method.strip('`')] = dict(zip(header[2:], values))
    return rows


@pytest.mark.parametrize('scenario', ['paper', 'calibrated', 'mismatched'])
def test_the_page_shows_full_studies(scenario):
    assert set(table(scenario)) == set(product(LETHALITIES, METHODS))
    for figure in page.FIGURES:
        assert (DOCS / 'images' / f'{scenario}_{figure}.png').exists()


def test_every_figure_is_shown():
    shown = set(re.findall(r'\]\(images/(\w+\.png)\)', (DOCS / 'results.md').read_text()))
    assert shown == {
        f'{scenario}_{figure}.png'
        for scenario in ('paper', 'calibrated', 'mismatched')
        for figure in page.FIGURES
    }


def test_what_is_read_of_entropy():
    final = {key: row['entropy'][0] for key, row in table('paper').items()}
    for lethality in LETHALITIES:
        itp, bnitp, kappa_bnitp = (final[lethality, method] for method in PAPER)
        assert (kappa_bnitp < itp) == (lethality <= 0.5)
        assert kappa_bnitp < bnitp
        if lethality <= 0.3:
            assert kappa_bnitp == min(final[lethality, method] for method in METHODS)


@pytest.mark.parametrize(
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


@pytest.mark.parametrize('scenario', ['paper', 'calibrated'])
def test_where_knowing_the_correlation_helps(scenario):
    rows = table(scenario)
    for lethality in LETHALITIES:
        with_kappa = rows[lethality, 'kappa_bnitp']['log loss']
        without = rows[lethality, 'relaxed_itp']['log loss']
        if lethality == 0.9:
            assert abs(with_kappa[0] - without[0]) < 1
        else:
            assert with_kappa[0] < without[0] - 5


def test_false_targets_at_high_lethality():
    rows = table('calibrated')
    exact, printed, without = (
        rows[0.9, method]['false targets']
        for method in ('kappa_bnitp', 'kappa_bnitp_published', 'relaxed_itp')
    )
    assert exact[1] > max(without[2], printed[2])
    assert exact[0] > 2 * without[0]


def test_the_luck_of_the_printed_update():
    for lethality in (0.01, 0.1):
        losses = {m: table('paper')[lethality, m]['log loss'][0] for m in METHODS}
        assert min(losses, key=losses.get) == 'kappa_bnitp_published'
    calibrated = table('calibrated')
    assert calibrated[0.01, 'kappa_bnitp_published']['difference'][0] == 0
    assert calibrated[0.1, 'kappa_bnitp_published']['difference'][2] < 0


def test_smoothing_against_the_methods_of_the_paper():
    rows = table('calibrated')
    for lethality, method in product(LETHALITIES[1:], PAPER):
        mean, _, high = rows[lethality, method]['difference']
        assert mean < 0
        assert (high < 0) == ((lethality, method) != (0.9, 'relaxed_itp'))
    better = [x for x in LETHALITIES if rows[x, 'kappa_bnitp']['difference'][2] < 0]
    assert better == [0.5]


def test_what_a_wrong_lethality_costs():
    wrong, right = table('mismatched'), table('calibrated')
    for method in METHODS:
        for lethality in LETHALITIES[:3]:
            assert wrong[lethality, method]['log loss'][1] > 74
        entropy = [wrong[lethality, method]['entropy'][0] for lethality in LETHALITIES]
        assert entropy[:3] == sorted(entropy[:3])
        cost = wrong[0.9, method]['log loss'][0] - right[0.9, method]['log loss'][0]
        assert 1.5 < cost < 8.5


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


def test_tables_and_figures_are_brought_between_their_marks(tmp_path):
    runs, docs = tmp_path / 'runs', tmp_path / 'docs'
    (runs / 'paper').mkdir(parents=True)
    (docs / 'images').mkdir(parents=True)
    for figure in page.FIGURES:
        (runs / 'paper' / f'{figure}.png').write_text(figure)
    (runs / 'paper' / 'summary.md').write_text('new\n')
    before = 'Words.\n<!-- table paper -->\nold\nold\n<!-- end -->\nMore words.\n'
    (docs / 'results.md').write_text(before)
    page.main(runs, docs)
    after = 'Words.\n<!-- table paper -->\nnew\n<!-- end -->\nMore words.\n'
    assert (docs / 'results.md').read_text() == after
    assert (docs / 'images' / 'paper_entropy.png').read_text() == 'entropy'
