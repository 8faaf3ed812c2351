# SPDX-License-Identifier: Apache-2.0
"""The results of a study, and their summary in tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from itertools import product
from operator import attrgetter
import re
from typing import Any, NamedTuple, TYPE_CHECKING

from kbnitp_ros.study.scenario import (
    ALONE,
    in_short,
    LEARNING,
    NUMBERS,
    Scenario,
    Strategy,
    team_labels,
)
from kbnitp_ros.study.trial import LEARNT, list_trials, measure_names, MissionResult, Trial
import numpy as np
from numpy.typing import NDArray
import pandas
import pyarrow as pa

if TYPE_CHECKING:
    from pandas import DataFrame


# Function that returns the sum of named measures in the missions of `team`, (trials, robots + 1).
Series = Callable[..., NDArray[np.float64]]

# Maximum bytes of the mission in each worker, and of all results.
MAX_MISSION_BYTES = 1 << 30
MAX_BYTES = 1 << 32


def check_memory(scenario: Scenario) -> None:
    """Check that a study fits in memory."""
    number = 8
    cells, deployments = scenario.field().cells, scenario.robots + 1
    missions = len(scenario.lethalities) * len(scenario.contenders) * scenario.trials
    # A mission keeps all beliefs; an outcome keeps the last maps, the truth and the measures.
    mission = 4 * number * cells * deployments
    outcome = 2 * (number + 1) * cells + len(measure_names(scenario)) * number * deployments
    for what, bytes_taken, most in (
        ('a mission', mission, MAX_MISSION_BYTES),
        (f'{missions} missions', 2 * missions * outcome, MAX_BYTES),
    ):
        if bytes_taken > most:
            raise ValueError(
                f'{what} of {scenario.robots} robots on {cells} cells takes about '
                f'{bytes_taken / 1e9:.1f} GB, and {most / 1e9:.1f} GB are allowed: lower '
                'grid.width, grid.height, robots or trials'
            )


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """The outcomes of all trials of a scenario, in any order."""

    scenario: Scenario
    outcomes: Mapping[Trial, MissionResult]

    def __repr__(self) -> str:
        methods = ', '.join(self.scenario.methods)
        return (
            f'Results({len(self.outcomes)} missions of {self.scenario.robots} robots: {methods})'
        )

    def table(self) -> pa.Table:
        """Return one row for each deployment of each trial."""
        trials = list_trials(self.scenario)
        rows = self.scenario.robots + 1
        measures = np.concatenate([self.outcomes[trial].measures for trial in trials])
        columns = {
            'trial': np.repeat([trial.number for trial in trials], rows),
            'method': np.repeat([trial.method for trial in trials], rows),
            'lethality': np.repeat([trial.lethality for trial in trials], rows),
            'deployment': np.tile(np.arange(rows), len(trials)),
            **{
                field.name: np.repeat([getattr(trial.team, field.name) for trial in trials], rows)
                for field in fields(Strategy)
            },
            **dict(zip(measure_names(self.scenario), measures.T)),
        }
        columns['lethality'] = pa.array(columns['lethality'].tolist(), pa.float64())
        columns['robots_lost'] = columns['robots_lost'].astype(np.int64)
        return pa.table(columns)

    def to_dataframe(self) -> DataFrame:
        """Return `table` as a pandas DataFrame."""
        return self.table().to_pandas()

    def series(
        self, lethality: float | None, method: str, *measures: str, team: Strategy = ALONE
    ) -> NDArray[np.float64]:
        """Return the sum of some measures, shape (trials, robots + 1)."""
        places = [measure_names(self.scenario).index(measure) for measure in measures]
        outcomes = self._missions(lethality, method, team)
        return np.stack([outcome.measures[:, places].sum(axis=1) for outcome in outcomes])

    def missions(
        self, teams: Sequence[Strategy] | None = None
    ) -> Iterator[tuple[dict[str, Any], Strategy, Series]]:
        """Yield lethality and method, the team, and the `Series` function of its missions."""
        scenario = self.scenario
        for lethality, method, team in product(
            scenario.lethalities, scenario.methods, scenario.teams if teams is None else teams
        ):
            series = partial(self.series, lethality, method, team=team)
            yield {'lethality': lethality, 'method': method}, team, series

    def final_maps(
        self, lethality: float | None, method: str, team: Strategy = ALONE
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the hazard and target maps at the end, and the truth, each (trials, 2, cells)."""
        outcomes = self._missions(lethality, method, team)
        believed = np.stack([outcome.believed for outcome in outcomes])
        return believed, np.stack([outcome.truth for outcome in outcomes])

    def learnt(
        self, lethality: float | None, team: Strategy = ALONE
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the statistics `LEARNT` of all numbers in each mission, and the true numbers."""
        outcomes = self._missions(lethality, LEARNING, team)
        known = np.stack([outcome.learnt for outcome in outcomes])
        return known, np.stack([outcome.numbers for outcome in outcomes])

    def _missions(
        self, lethality: float | None, method: str, team: Strategy
    ) -> list[MissionResult]:
        numbers = range(self.scenario.trials)
        return [self.outcomes[Trial(lethality, method, number, team)] for number in numbers]


ESCAPED = str.maketrans({each: f'\\{each}' for each in '&%$#_{}'})


class Cell(NamedTuple):
    """A table cell: a value, or a mean with its interval as a dict, and its text in Markdown."""

    value: Any
    text: str


class Table:
    """A table of cells with a caption."""

    def __init__(self, caption: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
        self.caption = caption
        self._cells = pandas.DataFrame(rows, columns=heads, dtype=object)
        self._texts = self._cells.map(attrgetter('text'))

    def markdown(self) -> str:
        """Return the table in Markdown."""
        heads = self._texts.columns
        head, *rows = (f'| {" | ".join(row)} |' for row in (heads, *self._texts.to_numpy()))
        return '\n'.join([self.caption, '', head, '|' + '---|' * len(heads), *rows, ''])

    def latex(self) -> str:
        """Return the table as a ``table`` of LaTeX, which needs the package booktabs."""
        texts = self._texts.map(in_latex).rename(columns=in_latex)
        return str(texts.to_latex(index=False, caption=in_latex(self.caption)))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the table for pandas; the interval of a mean `x` is in `x low` and `x high`."""
        rows = self._cells.map(attrgetter('value')).to_dict('records')
        known = [{head: value for head, value in row.items() if value is not None} for row in rows]
        return pandas.json_normalize(known, sep=' ').rename(
            columns=lambda name: name.removesuffix(' mean')
        )


def in_latex(text: str) -> str:
    """Return a line of Markdown in LaTeX."""
    return re.sub('`([^`]*)`', r'\\texttt{\1}', text.translate(ESCAPED))


# Measures whose sum is the total log loss.
LOG_LOSS = ('hazard_log_loss', 'target_log_loss')

SUMMARISED = {
    'log_loss': LOG_LOSS,
    'hazard_log_loss': LOG_LOSS[:1],
    'target_log_loss': LOG_LOSS[1:],
    'entropy': ('entropy',),
    'robots_lost': ('robots_lost',),
}

RESAMPLES = 2000

# Decimals of a summary; further decimals depend on the rounding of sums.
DECIMALS = 6


# Row of a table, by column: a value, a mean over trials, or a list of either.
Row = dict[str, Any]


class Mean(NamedTuple):
    """A mean over trials with its 95 % interval; all three fields have the same shape."""

    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def bootstrap_mean(samples: NDArray[np.float64]) -> Mean:
    """Return the mean over trials with its 95 % bootstrap interval."""
    return interval(samples.mean(axis=0), resampled_means(samples))


def after_robots(robots: Iterable[int], all_of_them: int) -> list[int]:
    """Return the numbers of robots below `all_of_them`, and `all_of_them`, ascending."""
    return sorted({*(each for each in robots if each < all_of_them), all_of_them})


def means_after(
    series: NDArray[np.float64], robots: Sequence[int]
) -> list[dict[str, float | None]]:
    """Return the means of a series after each number of robots, as JSON values."""
    return [as_json(bootstrap_mean(series[:, after])) for after in robots]


def resampled_means(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the means of bootstrap resamples of the trials."""
    trials = len(samples)
    resamples = RESAMPLES if trials > 1 else 0
    drawn = np.random.default_rng(0).multinomial(trials, np.full(trials, 1 / trials), resamples)
    return np.asarray(np.tensordot(drawn / trials, samples, 1), dtype=np.float64)


def interval(mean: NDArray[np.float64], resampled: NDArray[np.float64]) -> Mean:
    """Return a mean with the 95 % interval of its resamples."""
    if not len(resampled):
        return Mean(mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan))
    low, high = np.quantile(resampled, (0.025, 0.975), axis=0)
    return Mean(mean, low, high)


def summarise(results: Results) -> dict[str, Any]:
    """Summarize every method after the last robot, as JSON values."""
    scenario = results.scenario
    reference = scenario.methods[-1]
    labels = team_labels(scenario)
    rows = []
    for row, team, series in results.missions():
        lethality, method = row.values()
        row |= {**vars(team), 'label': labels[team]}
        for name, measures in SUMMARISED.items():
            row[name] = bootstrap_mean(series(*measures)[:, -1])
        believed, truth = results.final_maps(lethality, method, team)
        hazard_alone = truth[:, 0] & ~truth[:, 1]
        row['false_targets'] = bootstrap_mean((believed[:, 1] * hazard_alone).sum(axis=1))
        if method != reference:
            nearest = results.series(lethality, reference, *LOG_LOSS, team=team)
            row['difference'] = bootstrap_mean((nearest - series(*LOG_LOSS))[:, -1])
        rows.append(json_row(row))
    return {
        'trials': scenario.trials,
        'robots': scenario.robots,
        'reference': reference,
        'rows': rows,
    }


def as_json(mean: Mean) -> dict[str, float | None]:
    """Return a mean and its interval as JSON values."""
    return {
        name: None if np.isnan(value) else round(float(value), DECIMALS)
        for name, value in mean._asdict().items()
    }


def json_row(row: Row) -> Row:
    """Return a row as JSON values."""
    return {
        name: as_json(value) if isinstance(value, Mean) else value for name, value in row.items()
    }


def summary_table(summary: dict[str, Any]) -> Table:
    """Return a summary as a table."""
    columns = [*SUMMARISED, 'false_targets']
    caption = (
        f'After {summary["robots"]} robots: means of {summary["trials"]} trials with 95 % '
        'bootstrap intervals. Losses and entropy are in nats, summed over the cells. '
        'False targets: the number believed to be in cells with a hazard and no target.'
    )
    if any('difference' in row for row in summary['rows']):
        columns.append('difference')
        caption += (
            f' Difference: the log loss of `{summary["reference"]}` minus the log loss of the '
            'method, paired by world.'
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
    """Return the table cell of a row's lethality."""
    return Cell(row['lethality'], in_short(row['lethality']))


def shown(entry: dict[str, float | None], decimals: int = 1) -> str:
    """Format a mean, with its interval if it has one."""
    mean, *ends = (f'{value:.{decimals}f}' for value in entry.values() if value is not None)
    return f'{mean} [{", ".join(ends)}]' if ends else mean


def after_rounds(series: NDArray[np.float64], agents: int) -> NDArray[np.float64]:
    """Return a series before the first round and after each round, (trials, rounds + 1)."""
    robots = series.shape[1] - 1
    return series[:, [*range(0, robots, agents), robots]]


def trade(series: Series, team: Strategy) -> NDArray[np.float64]:
    """Return the robots lost and the total log loss of a team, (trials, 2, robots + 1)."""
    return np.stack([series('robots_lost', team=team), series(*LOG_LOSS, team=team)], axis=1)


MEAN, SD, LOW, HIGH = (LEARNT.index(name) for name in ('mean', 'sd', 0.05, 0.95))


def of_number(
    results: Results, lethality: float | None, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a number's statistics `LEARNT`, (trials, robots + 1, learnt), and its true values."""
    known, truth = results.learnt(lethality, results.scenario.teams[0])
    place = NUMBERS.index(name)
    return known[:, :, place], truth[:, place, None]
