# SPDX-License-Identifier: Apache-2.0
"""The results of a study: one tidy table, with paired intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from gzip import BadGzipFile
from pathlib import Path
import re
from typing import Any, NamedTuple

from kbnitp_ros.core.field.check import as_floats, generator, in_short, whole_number
from kbnitp_ros.files import as_file, naming, nearest
from kbnitp_ros.study.scenario_file import Study
from kbnitp_ros.study.trial import list_trials, Trial
import numpy as np
from numpy.typing import NDArray
import pandas
from pandas import DataFrame

# Columns of the table besides the choices.
KEYS = ('world', 'strategy', 'robot', 'measure', 'value')

# Measures of the summary, as far as a study has them.
SUMMARISED = (
    'log_loss',
    'hazard_log_loss',
    'target_log_loss',
    'entropy',
    'robots_lost',
    'false_targets',
    'p_free',
    'free',
    'declared',
)

# Decimals of means of measures that are not in nats or robots.
DECIMALS = {'p_free': 3, 'free': 3, 'declared': 3}

RESAMPLES = 2000

# Series of a measure, (worlds, robots + 1), by strategy.
Series = dict[str, DataFrame]


class Interval(NamedTuple):
    """A mean over worlds with its 95 % interval; all three fields have the same shape."""

    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def bootstrap(samples: Any, rng: np.random.Generator | None = None) -> Interval:
    """Return the mean over worlds (the first axis) with its 95 % interval; `rng` resamples."""
    values = as_floats('samples', samples)
    if not values.ndim:
        raise ValueError(f'samples is {in_short(samples)}: it must have a value for each world')
    worlds = len(values)
    if worlds < 2:
        mean = values.mean(axis=0)
        return Interval(mean, mean * np.nan, mean * np.nan)
    drawn = first_resamples(worlds) if rng is None else resamples(worlds, rng)
    resampled = np.tensordot(drawn, values, 1)
    low, high = np.quantile(resampled, (0.025, 0.975), axis=0)
    return Interval(values.mean(axis=0), low, high)


def resamples(worlds: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the share of each world in each resample, shape (resamples, worlds)."""
    drawn = generator(rng).multinomial(worlds, np.full(worlds, 1.0 / worlds), RESAMPLES)
    return np.asarray(drawn / worlds, np.float64)


@lru_cache
def first_resamples(worlds: int) -> NDArray[np.float64]:
    """Return the resamples of a new generator, which all tables and figures share."""
    return resamples(worlds, np.random.default_rng(0))


# Name of the table in the folder of a study.
TABLE = 'table.csv'


class Results:
    """
    The results of a study: a tidy table.

    It has a row for each value, with the columns world, strategy, robot, measure and value. Any
    other column, such as the lethality, is an axis of choices. Robot 0 is the prior.
    """

    def __init__(self, table: DataFrame) -> None:
        if not isinstance(table, DataFrame):
            raise TypeError(f'table is {in_short(table)}: it must be a DataFrame')
        missing = [name for name in KEYS if name not in table]
        if missing:
            raise ValueError(f'the table has no column {missing[0]}: it needs {", ".join(KEYS)}')
        for name, kinds, wanted in (('robot', 'iu', 'whole numbers'), ('value', 'iuf', 'numbers')):
            if (kind := table[name].dtype).kind not in kinds:
                raise ValueError(f'the column {name} is of {kind}: it must be of {wanted}')
        # Names may be numbers.
        numbers = [name for name in ('strategy', 'measure') if table[name].dtype.kind in 'iuf']
        table = table.astype(dict.fromkeys(numbers, str))
        # Categories in the order of the table, which is that of the scenario.
        texts = table.select_dtypes(['object', 'category'])
        categories = {
            name: pandas.Categorical(of, list(of.unique())) for name, of in texts.items()
        }
        self._table = table.assign(
            **{name: each.rename_categories(str) for name, each in categories.items()}
        )
        self.axes = [name for name in table if name not in KEYS]
        self.strategies = list(self._table['strategy'].cat.categories)
        self.measures = list(self._table['measure'].cat.categories)

    def __repr__(self) -> str:
        worlds, robots = self._table['world'].nunique(), self._table['robot'].max()
        return f'Results({worlds} worlds of {robots} robots: {", ".join(self.strategies)})'

    @classmethod
    def read(cls, path: str | Path) -> Results:
        """Read the table of a study's folder, or a CSV file (also .gz)."""
        path = as_file('path', path)
        file = path / TABLE if path.is_dir() else path
        if not file.exists():
            raise ValueError(f'{path} has no {TABLE}: run the study again, which completes it')
        try:
            with naming(file):
                return cls(read_table(file))
        except (ValueError, EOFError, BadGzipFile) as error:
            words = ' '.join(str(error).split())
            raise ValueError(f'{file} is not the table of a study: {words}') from error

    @classmethod
    def of(cls, study: Study, outcomes: Mapping[Trial, DataFrame]) -> Results:
        """Return the results of all trials of a study."""
        wide = pandas.concat(
            {
                (
                    trial.number,
                    study.scenarios[trial.choices].contenders[trial.method, trial.team],
                    *(
                        'null' if each is None else each
                        for each in (trial.lethality, *trial.choices)
                    ),
                ): outcomes[trial]
                for trial in list_trials(study)
            },
            names=['world', 'strategy', 'lethality', *study.axes, 'robot'],
        )
        keys = wide.index.to_frame(index=False).astype({'strategy': 'category'})
        values = wide.to_numpy()
        row, place = np.nonzero(~np.isnan(values))
        measure = pandas.Categorical.from_codes(place, wide.columns)
        table = keys.iloc[row].assign(measure=measure, value=values[row, place])
        return cls(table.reset_index(drop=True))

    def to_dataframe(self) -> DataFrame:
        """Return the tidy table."""
        texts = self._table.select_dtypes('category')
        return self._table.astype(dict.fromkeys(texts, object))

    def write(self, folder: Path) -> list[Path]:
        """Write the table as CSV, with the exact values."""
        file = as_file('folder', folder) / TABLE
        with naming(file):
            self._table.to_csv(file, index=False)
        return [file]

    def check_measure(self, measure: str) -> None:
        """Check that the table has a measure."""
        if not isinstance(measure, str) or measure not in self.measures:
            meant = nearest(str(measure), self.measures)
            raise ValueError(f'measure is {in_short(measure)}: {meant}see .measures')

    def series(self, measure: str) -> Iterator[tuple[dict[str, Any], Series]]:
        """Yield, for each combination of choices, a measure of each strategy, worlds x robots."""
        self.check_measure(measure)
        rows = self._table[self._table['measure'] == measure]
        for choices, group in by(rows, self.axes):
            yield (
                choices,
                {
                    named['strategy']: of.pivot(index='world', columns='robot', values='value')
                    for named, of in by(group, ['strategy'])
                },
            )

    def means(
        self,
        *measures: str,
        robot: int | None = None,
        rng: np.random.Generator | None = None,
    ) -> DataFrame:
        """Return the means over worlds after a robot, by default the last, with 95 % intervals."""
        return DataFrame(
            {**choices, 'strategy': strategy, 'measure': measure}
            | bootstrap(after(values, robot), rng)._asdict()
            for measure in measures or [each for each in SUMMARISED if each in self.measures]
            for choices, series in self.series(measure)
            for strategy, values in series.items()
        )

    def difference(
        self,
        strategy: str,
        other: str,
        measure: str = 'log_loss',
        robot: int | None = None,
        rng: np.random.Generator | None = None,
    ) -> DataFrame:
        """
        Return a measure of a strategy minus that of another one, paired by world.

        A row for each combination of choices has mean, low and high (95 %) and worlds. `robot` is
        the number of robots, by default all; `rng` draws the resamples, by default with seed 0.
        """
        for name in (strategy, other):
            if not isinstance(name, str) or name not in self.strategies:
                known = ', '.join(self.strategies)
                raise ValueError(f'strategy {in_short(name)} is unknown: the table has {known}')
        rows = []
        for choices, series in self.series(measure):
            if strategy in series and other in series:
                paired = (after(series[strategy], robot) - after(series[other], robot)).dropna()
                interval = bootstrap(paired, rng)._asdict()
                rows.append({**choices, **interval, 'worlds': len(paired)})
        return DataFrame(rows)

    def summary(self, rng: np.random.Generator | None = None) -> DataFrame:
        """Return the table to print: means after the last robot, in words, with intervals."""
        keys = [*self.axes, 'strategy']
        means = self.means(rng=rng)
        means['text'] = [
            mean_with_interval(row, DECIMALS.get(row['measure'], 1)) for _, row in means.iterrows()
        ]
        rows = []
        for named, own in by(means, keys):
            texts = {
                each.replace('_', ' '): text for each, text in zip(own['measure'], own['text'])
            }
            rows.append({**named, **texts})
        table = DataFrame(rows)
        first, *others = self.strategies
        if others:
            apart = [
                self.difference(each, first, rng=rng).assign(strategy=each) for each in others
            ]
            paired = pandas.concat(apart)
            paired['difference'] = [mean_with_interval(row) for _, row in paired.iterrows()]
            table = table.merge(paired[[*keys, 'difference']], 'left', keys).fillna('')
        return table

    def caption(self) -> str:
        """Return the caption of the summary."""
        worlds, robots = self._table['world'].nunique(), self._table['robot'].max()
        text = (
            f'After {robots} robots: means of {worlds} worlds with 95 % bootstrap intervals. '
            'Losses and entropy are in nats, summed over the cells. False targets: the number '
            'believed to be in cells with a hazard and no target.'
        )
        if len(self.strategies) > 1:
            text += (
                f' Difference: the log loss minus that of `{self.strategies[0]}`, paired by world.'
            )
        return text

    def markdown(self) -> str:
        """Return the summary in Markdown."""
        return markdown_table(self.caption(), self.summary())

    def latex(self) -> str:
        """Return the summary as a ``table`` of LaTeX, which needs the package booktabs."""
        return latex_table(self.caption(), self.summary())


def read_table(file: Path) -> DataFrame:
    """Read a table from CSV, checked to have one value of each kind."""
    table = pandas.read_csv(file, keep_default_na=False, float_precision='round_trip')
    if not isinstance(table.index, pandas.RangeIndex):
        raise ValueError('its rows have more values than its header')
    twice = table.duplicated([name for name in table if name != 'value'])
    if twice.any():
        raise ValueError(f'row {twice.argmax() + 1} has a value that an earlier row has')
    return table


def by(rows: DataFrame, names: Sequence[str]) -> Iterator[tuple[dict[str, Any], DataFrame]]:
    """Yield the rows of each combination of values, in the order of the table."""
    if not names:
        yield {}, rows
        return
    for values, group in rows.groupby(list(names), sort=False, observed=True):
        yield dict(zip(names, values)), group


def after(series: DataFrame, robot: int | None) -> pandas.Series[float]:
    """Return a measure after a number of robots, by default all."""
    robots = series.columns.max()
    if robot is not None and whole_number('robot', robot, 0) not in series:
        raise ValueError(f'robot is {robot}: it must be one of the table, such as {robots}')
    return series[robots if robot is None else robot]


def mean_with_interval(row: Mapping[str, Any], decimals: int = 1) -> str:
    """Return a mean with its interval, if it has one."""
    mean, *ends = (f'{row[name]:.{decimals}f}' for name in ('mean', 'low', 'high'))
    return mean if ends == ['nan', 'nan'] else f'{mean} [{", ".join(ends)}]'


def markdown_table(caption: str, table: DataFrame) -> str:
    """Return a table in Markdown."""
    rows = ([str(each) for each in row] for row in table.itertuples(index=False))
    head, *lines = (f'| {" | ".join(row)} |' for row in (list(table), *rows))
    return '\n'.join([caption, '', head, '|' + '---|' * len(table.columns), *lines, ''])


def latex_table(caption: str, table: DataFrame) -> str:
    """Return a table in LaTeX."""
    texts = table.astype(str).map(in_latex).rename(columns=in_latex)
    return str(texts.to_latex(index=False, caption=in_latex(caption)))


ESCAPED = str.maketrans({each: f'\\{each}' for each in '&%$#_{}'})


def in_latex(text: str) -> str:
    """Return a line of Markdown in LaTeX."""
    return re.sub('`([^`]*)`', r'\\texttt{\1}', text.translate(ESCAPED))
