#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""
Make the pages of results from tidy tables.

``python3 tools/results_page.py docs`` makes, from DOCS/tables/<scenario>.csv.gz, the table of
DOCS/tables/<scenario>.md and, from that of the scenario paper, the verdicts of DOCS/results.md.
``python3 tools/results_page.py docs RUNS`` first makes these tables, with the last robots only,
from the studies in RUNS/<scenario>/, RUNS/<scenario>-<choices>/ being others of the scenario,
and brings the figures that the pages show, as DOCS/images/<scenario>_<figure>.png.
"""

from __future__ import annotations

from pathlib import Path
import re
import sys
from typing import NamedTuple

from kbnitp_ros.study.results import after, bootstrap, markdown_table, mean_with_interval, Results
from kbnitp_ros.study.scenario_file import full_name, read_study
import numpy as np
import pandas
from pandas import DataFrame
from PIL import Image

# Of a figure in the page, in pixels, and how many colours it has there.
WIDTH, COLOURS = 1600, 128
FIGURE = re.compile(r'images/(\w+\.png)\)')

# Measures that the tables keep after the last robot, of a scenario as it is shipped and with other
# choices; before the first robot they keep the log loss.
KEPT = (
    'log_loss',
    'entropy',
    'robots_lost',
    'false_targets',
    'hazard_log_loss',
    'target_log_loss',
)
KEPT_OF_CHOICES = KEPT[:4]

ITP, BNITP, KAPPA, EXACT = 'relaxed_itp', 'relaxed_bnitp', 'kappa_bnitp_published', 'kappa_bnitp'
PRIOR = 'prior'
ENTROPY, LOG_LOSS, FALSE = 'entropy', 'log_loss', 'false_targets'
NAMES = {ITP: 'ITP', BNITP: 'BNITP', PRIOR: 'the prior'}


class Claim(NamedTuple):
    """A claim of the paper: a measure of κ-BNITP is below (-1) or above (1) that of others."""

    text: str
    shown: str
    lethality: float
    measure: str
    sign: int
    others: tuple[str, ...]


LOWEST, BEHIND = 'Fig. 4: κ-BNITP ends lowest', 'Fig. 4: κ-BNITP does not end lowest'
UNTESTED = 'nothing: only entropy is shown'
CLAIMS = (
    Claim('At 50 % lethality κ-BNITP has least entropy', LOWEST, 0.5, ENTROPY, -1, (ITP, BNITP)),
    Claim('At 60 % lethality, too', LOWEST, 0.6, ENTROPY, -1, (ITP, BNITP)),
    Claim('At 90 % it falls behind relaxed-ITP', BEHIND, 0.9, ENTROPY, 1, (ITP,)),
    Claim('At 30 % it falls behind', BEHIND, 0.3, ENTROPY, 1, (ITP,)),
    Claim('At 10 % it falls behind', BEHIND, 0.1, ENTROPY, 1, (ITP,)),
    Claim('At 1 % it falls behind', BEHIND, 0.01, ENTROPY, 1, (ITP,)),
    Claim('At 90 % it reports more false targets', 'a sentence', 0.9, FALSE, 1, (ITP, BNITP)),
    Claim('κ improves the map: lower log loss at 50 %', UNTESTED, 0.5, LOG_LOSS, -1, (BNITP,)),
    Claim('Entropy measures a map: log loss falls at 50 %', UNTESTED, 0.5, LOG_LOSS, -1, (PRIOR,)),
)  # fmt: skip

# The axis of the verdicts, and the values of the other choices of the scenario paper.
VISITS = 'max_visits'
VARIED = {
    'hazard': 'P(hazard)',
    'target': 'P(target)',
    'prior.kappa': 'believed κ',
    'ties': 'ties',
    'max_steps': 'steps',
}
CHOSEN = {'hazard': 0.5, 'target': 0.45, 'prior.kappa': 0.8, 'ties': 'first', 'max_steps': 18}


def condense(scenario: str, runs: Path) -> DataFrame:
    """Return the rows to keep of all studies of a scenario, with a column for each choice."""
    folders = [runs / scenario, *sorted(runs.glob(f'{scenario}-*'))]
    studies = {
        folder: read_study(folder / 'scenario.yaml')
        for folder in folders
        if (folder / 'table.csv').exists()
    }
    names = [VISITS, *CHOSEN] if scenario == 'paper' else studies[folders[0]].axes
    tables = []
    for folder, study in studies.items():
        table = Results.read(folder).to_dataframe()
        kept = KEPT if folder.name == scenario else KEPT_OF_CHOICES
        at_end = (table['robot'] == table['robot'].max()) & table['measure'].isin(kept)
        at_start = (table['robot'] == 0) & (table['measure'] == 'log_loss')
        given = {name: full_name(name).rpartition('.') for name in names if name not in study.axes}
        own = {
            name: (study.content[section] if section else study.content)[key]
            for name, (section, _, key) in given.items()
        }
        tables.append(table[at_start | at_end].assign(**own))
    table = pandas.concat(tables, ignore_index=True)
    keys = ['world', 'strategy', 'lethality', *names, 'robot', 'measure', 'value']
    return table[keys]


class Paper:
    """The missions of the scenario paper with its choices, and how claims fare in them."""

    def __init__(self, results: Results) -> None:
        self.results = results
        self.table = results.to_dataframe()
        self.visits = [int(each) for each in sorted(self.table[VISITS].unique())]
        self.is_chosen = (self.table[list(CHOSEN)] == list(CHOSEN.values())).all(axis=1)
        measures = {claim.measure for claim in CLAIMS}
        self.series = {measure: list(results.series(measure)) for measure in measures}

    def judge(self, claim: Claim, chosen: dict[str, object], worlds: int) -> tuple[int, str]:
        """Return 1 if a claim holds at some choices, -1 if the opposite does, and differences."""
        (series,) = (
            series
            for choices, series in self.series[claim.measure]
            if {**choices, **chosen, 'lethality': claim.lethality} == choices
        )
        sides, words = set(), []
        for other in claim.others:
            kappa = after(series[KAPPA], None)
            against = after(series[KAPPA], 0) if other == PRIOR else after(series[other], None)
            difference = (kappa - against).dropna()
            interval = bootstrap(difference[difference.index < worlds])
            is_apart = interval.low > 0.0 or interval.high < 0.0
            sides.add(claim.sign * int(np.sign(interval.mean)) if is_apart else 0)
            decimals = 2 if claim.measure == FALSE else 1
            words.append(f'{NAMES[other]}: {mean_with_interval(interval._asdict(), decimals)}')
        return sides.pop() if len(sides) == 1 else 0, '<br>'.join(words)

    def verdict(self, claim: Claim, chosen: dict[str, object], worlds: int) -> str:
        """Return the verdict on a claim over the numbers of visits."""
        sides = {
            visits: self.judge(claim, {**chosen, VISITS: visits}, worlds)[0]
            for visits in self.visits
        }
        held = [visits for visits, side in sides.items() if side == 1]
        if len(held) == len(sides):
            return 'reproduced'
        if held:
            return f'reproduced only with {" and ".join(map(a_cell, held))}'
        return 'not reproduced' + ': the opposite' * (set(sides.values()) == {-1})

    def verdicts(self) -> str:
        """Return the table of claims and verdicts."""
        worlds = self.table[self.is_chosen]['world'].nunique()
        rows = [
            {
                'claim of the paper': claim.text,
                'the paper shows': claim.shown,
                'measure': claim.measure.replace('_', ' '),
                **{
                    a_cell(visits): self.judge(claim, {**CHOSEN, VISITS: visits}, worlds)[1]
                    for visits in self.visits
                },
                'verdict': f'**{self.verdict(claim, CHOSEN, worlds)}**',
            }
            for claim in CLAIMS
        ]
        caption = (
            f'κ-BNITP as printed minus the others after 100 robots, paired by world: {worlds} '
            'worlds, 95 % intervals. Entropy and log loss in nats.'
        )
        return markdown_table(caption, DataFrame(rows))

    def sensitivity(self) -> str:
        """Return the table of verdicts with other choices; verdicts that turn say so."""
        every = self.table[list(CHOSEN)].drop_duplicates().to_dict('records')
        # With as many worlds, what turns is due to the choice.
        worlds = self.table[~self.is_chosen]['world'].nunique()
        rows = []
        for claim in CLAIMS:
            stated = self.verdict(claim, CHOSEN, worlds)
            row = {'claim': claim.text, f'as above, {worlds} worlds': stated}
            for chosen in every:
                own = {name: value for name, value in chosen.items() if value != CHOSEN[name]}
                if not own:
                    continue
                label = ', '.join(f'{VARIED[name]} {value}' for name, value in own.items())
                found = self.verdict(claim, chosen, worlds)
                row[label] = 'same' if found == stated else f'**turns: {found}**'
            rows.append(row)
        caption = (
            'Verdicts with other choices, each with one visit a cell and with three, in the same '
            'worlds. "Same" is as in the second column: fewer worlds decide less than the table '
            'above.'
        )
        return markdown_table(caption, DataFrame(rows))

    def default_method(self) -> str:
        """Return the log loss and the robots lost of the default method minus the printed one."""
        rows = {}
        for measure in ('log_loss', 'robots_lost'):
            for row in self.results.difference(EXACT, KAPPA, measure).to_dict('records'):
                if {**row, **CHOSEN} == row:
                    head = f'{measure.replace("_", " ")}, {a_cell(row[VISITS])}'
                    own = rows.setdefault(row['lethality'], {'lethality': row['lethality']})
                    own[head] = mean_with_interval(row)
        caption = f'`{EXACT}` minus `{KAPPA}` after 100 robots, in the same worlds.'
        return markdown_table(caption, DataFrame(rows.values()))


def a_cell(visits: int) -> str:
    """Return a number of visits in words."""
    return f'{visits} visit{"s" * (int(visits) > 1)} a cell'


def fill(page: Path, mark: str, text: str) -> None:
    """Put a text between a mark of a page and the next end."""
    begin, middle, rest = page.read_text().partition(f'<!-- {mark} -->\n')
    if not middle:
        raise ValueError(f'{page} has no <!-- {mark} -->')
    page.write_text(f'{begin}{middle}{text}<!-- end -->{rest.partition("<!-- end -->")[2]}')


def main(docs: Path, runs: Path | None = None) -> None:
    """Make all pages that have a tidy table."""
    pages = sorted((docs / 'tables').glob('*.md'))
    if runs is not None:
        bring_figures(docs, runs, [page.stem for page in pages])
        for page in pages:
            if (runs / page.stem / 'table.csv').exists():
                file = page.with_suffix('.csv.gz')
                options = {'method': 'gzip', 'mtime': 0}
                condense(page.stem, runs).to_csv(
                    file, index=False, float_format='%.5g', compression=options
                )
    for page in pages:
        file = page.with_suffix('.csv.gz')
        if file.exists():
            results = Results.read(file)
            if page.stem == 'paper':
                paper = Paper(results)
                fill(docs / 'results.md', 'verdicts', paper.verdicts())
                fill(docs / 'results.md', 'sensitivity', paper.sensitivity())
                fill(docs / 'results.md', 'default', paper.default_method())
                results = Results(paper.table[paper.is_chosen].drop(columns=list(CHOSEN)))
            fill(page, 'table', results.markdown())


def bring_figures(docs: Path, runs: Path, scenarios: list[str]) -> None:
    """Bring the figures that the pages show of studies in `runs`."""
    shown = [docs / 'results.md', *docs.glob('results/*.md')]
    for figure in FIGURE.findall(''.join(page.read_text() for page in shown)):
        # The name of a scenario may begin with another's.
        of = max(
            (each for each in scenarios if figure.startswith(f'{each}_')), key=len, default=''
        )
        drawn = runs / of / figure.removeprefix(f'{of}_')
        if of and drawn.exists():
            with Image.open(drawn) as image:
                image.thumbnail((WIDTH, 2 * WIDTH))
                # Refined, since the median cut alone turns the colours of lines into others.
                small = image.convert('RGB').quantize(COLOURS, kmeans=3)
                small.save(docs / 'images' / figure, optimize=True)


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:]))
