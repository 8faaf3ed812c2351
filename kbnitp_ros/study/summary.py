# SPDX-License-Identifier: Apache-2.0
"""What a study comes to: where the methods stand, in a table for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter
import re
from typing import Any, NamedTuple

from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import in_short, team_labels
import numpy as np
from numpy.typing import NDArray
import pandas

ESCAPED = str.maketrans({each: f'\\{each}' for each in '&%$#_{}'})


class Cell(NamedTuple):
    """A value, of a mean a dict with its interval, and how it is shown in Markdown."""

    value: Any
    text: str


class Table:
    """A caption and a table of cells under it."""

    def __init__(self, caption: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
        self.caption = caption
        self._cells = pandas.DataFrame(rows, columns=heads, dtype=object)
        self._texts = self._cells.map(attrgetter('text'))

    def markdown(self) -> str:
        """Return it in Markdown."""
        heads = self._texts.columns
        head, *rows = (f'| {" | ".join(row)} |' for row in (heads, *self._texts.to_numpy()))
        return '\n'.join([self.caption, '', head, '|' + '---|' * len(heads), *rows, ''])

    def latex(self) -> str:
        """Return it as a ``table`` of LaTeX, which needs the package booktabs."""
        texts = self._texts.map(in_latex).rename(columns=in_latex)
        return str(texts.to_latex(index=False, caption=in_latex(self.caption)))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return it as a table of pandas; HEAD low and HEAD high are the interval of a mean."""
        rows = self._cells.map(attrgetter('value')).to_dict('records')
        known = [{head: value for head, value in row.items() if value is not None} for row in rows]
        return pandas.json_normalize(known, sep=' ').rename(
            columns=lambda name: name.removesuffix(' mean')
        )


def in_latex(text: str) -> str:
    """Return a line of Markdown in LaTeX."""
    return re.sub('`([^`]*)`', r'\\texttt{\1}', text.translate(ESCAPED))


# The total log loss: how far the belief is from the truth, both maps together.
LOG_LOSS = ('hazard_log_loss', 'target_log_loss')

SUMMARISED = {
    'log_loss': LOG_LOSS,
    'hazard_log_loss': LOG_LOSS[:1],
    'target_log_loss': LOG_LOSS[1:],
    'entropy': ('entropy',),
    'robots_lost': ('robots_lost',),
}

RESAMPLES = 2000

# Beyond these a summary would show how sums were rounded.
DECIMALS = 6


# Of a table: values, means over trials and lists of them, by name.
Row = dict[str, Any]


class Mean(NamedTuple):
    """A mean over trials and its 95 % interval; each shape (...)."""

    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def mean_of(samples: NDArray[np.float64]) -> Mean:
    """Return the mean over trials with its 95 % bootstrap interval."""
    return interval(samples.mean(axis=0), resampled_means(samples))


def after_robots(robots: Iterable[int], all_of_them: int) -> list[int]:
    """Return after how many robots missions are compared: these, as far as there are, and all."""
    return sorted({*(each for each in robots if each < all_of_them), all_of_them})


def means_after(
    series: NDArray[np.float64], robots: Sequence[int]
) -> list[dict[str, float | None]]:
    """Return the means of a series after so many robots, for JSON."""
    return [as_json(mean_of(series[:, after])) for after in robots]


def resampled_means(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the means over trials that are drawn again and again, with replacement."""
    trials = len(samples)
    resamples = RESAMPLES if trials > 1 else 0
    drawn = np.random.default_rng(0).multinomial(trials, np.full(trials, 1 / trials), resamples)
    return np.asarray(np.tensordot(drawn / trials, samples, 1), dtype=np.float64)


def interval(mean: NDArray[np.float64], resampled: NDArray[np.float64]) -> Mean:
    """Return a mean of the trials with the 95 % interval of what the resamples give."""
    if not len(resampled):
        return Mean(mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan))
    low, high = np.quantile(resampled, (0.025, 0.975), axis=0)
    return Mean(mean, low, high)


def summarise(results: Results) -> dict[str, Any]:
    """Return where every method stands after the last robot, as JSON can hold it."""
    scenario = results.scenario
    reference = scenario.methods[-1]
    labels = team_labels(scenario)
    rows = []
    for row, team, series in results.missions():
        lethality, method = row.values()
        row |= {**vars(team), 'label': labels[team]}
        for name, measures in SUMMARISED.items():
            row[name] = mean_of(series(*measures)[:, -1])
        believed, truth = results.final_maps(lethality, method, team)
        hazard_alone = truth[:, 0] & ~truth[:, 1]
        row['false_targets'] = mean_of((believed[:, 1] * hazard_alone).sum(axis=1))
        if method != reference:
            nearest = results.series(lethality, reference, *LOG_LOSS, team=team)
            row['difference'] = mean_of((nearest - series(*LOG_LOSS))[:, -1])
        rows.append(json_row(row))
    return {
        'trials': scenario.trials,
        'robots': scenario.robots,
        'reference': reference,
        'rows': rows,
    }


def as_json(mean: Mean) -> dict[str, float | None]:
    """Return the mean of one value and its interval, if it has one, as JSON can hold them."""
    return {
        name: None if np.isnan(value) else round(float(value), DECIMALS)
        for name, value in mean._asdict().items()
    }


def json_row(row: Row) -> Row:
    """Return a row as JSON can hold it."""
    return {
        name: as_json(value) if isinstance(value, Mean) else value for name, value in row.items()
    }


def table_of(summary: dict[str, Any]) -> Table:
    """Return a summary as a table for people."""
    columns = [*SUMMARISED, 'false_targets']
    caption = (
        f'After {summary["robots"]} robots: means of {summary["trials"]} trials with 95 % '
        'bootstrap intervals. Losses and entropy are in nats, summed over the cells. '
        'False targets: the number believed to be in cells with a hazard alone.'
    )
    if any('difference' in row for row in summary['rows']):
        columns.append('difference')
        caption += (
            f' Difference: the log loss of `{summary["reference"]}` less that of the method, '
            'trial by trial.'
        )
    rows = []
    for row in summary['rows']:
        method = [row['method'], *filter(None, [row['label']])]
        cells = [Cell(row[n], shown(row[n])) if n in row else Cell(None, '') for n in columns]
        contender = Cell(', '.join(method), ', '.join([f'`{method[0]}`', *method[1:]]))
        rows.append([lethality_cell(row), contender, *cells])
    heads = ['lethality', 'method', *(name.replace('_', ' ') for name in columns)]
    return Table(caption, heads, rows)


def lethality_cell(row: Row) -> Cell:
    """Return the lethality of the worlds of a row."""
    return Cell(row['lethality'], in_short(row['lethality']))


def shown(entry: dict[str, float | None], decimals: int = 1) -> str:
    """Return a mean and its interval, if it has one, for people."""
    mean, *ends = (f'{value:.{decimals}f}' for value in entry.values() if value is not None)
    return f'{mean} [{", ".join(ends)}]' if ends else mean
