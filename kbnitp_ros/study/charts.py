# SPDX-License-Identifier: Apache-2.0
"""The three plots of a study: curves by robot, paired differences, and final values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from kbnitp_ros.core.field.check import typed
from kbnitp_ros.figures import LETTERS, WIDTH
from kbnitp_ros.study.results import bootstrap, Results, Series, SUMMARISED
from kbnitp_ros.styles import SERIES, Style
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np
from numpy.typing import NDArray

# Maximum number of panels side by side.
COLUMNS = 4

# Opacity of the band of an interval.
BAND = 0.15

LABELS = {
    'entropy': 'entropy H(Z) + H(X) (nats)',
    'log_loss': 'log loss of hazard and target (nats)',
}


@typed
def study_figures(results: Results) -> dict[str, Figure]:
    """Return the figures of a study, by the names of their files."""
    with rc_context(LETTERS):
        figures = {
            # The figure of arXiv:2305.06929.
            'entropy': curves(results, 'entropy'),
            'log_loss': curves(results, 'log_loss', scale='log'),
            'final': final_values(results),
        }
        if len(results.strategies) > 1:
            figures['differences'] = differences(results, 'log_loss')
    return figures


@typed
def curves(results: Results, measure: str, scale: str = 'linear') -> Figure:
    """Draw the mean of a measure by robot, with 95 % intervals, a panel for each choice."""
    results.check_measure(measure)

    def draw(axes: Axes, series: Series) -> None:
        for strategy, values in series.items():
            draw_mean(axes, values.to_numpy(), style(results, strategy))

    return panels(results, measure, draw, LABELS.get(measure, in_text(measure)), scale)


@typed
def differences(results: Results, measure: str) -> Figure:
    """Draw the paired differences from the first strategy by robot, a panel for each choice."""
    results.check_measure(measure)
    first = results.strategies[0]

    def draw(axes: Axes, series: Series) -> None:
        axes.axhline(0.0, color='0.6', linewidth=0.8)
        for strategy, values in series.items():
            if strategy != first and first in series:
                paired = (values - series[first]).dropna().to_numpy()
                draw_mean(axes, paired, style(results, strategy))

    return panels(results, measure, draw, f'{in_text(measure)} minus {first}')


@typed
def final_values(results: Results) -> Figure:
    """Draw the means after the last robot with 95 % intervals, a panel for each measure."""
    measures = [each for each in SUMMARISED if each in results.measures]
    figure, grid = panel_grid(results, len(measures), min(3, len(measures)), sharey=False)
    for axes, measure in zip(grid, measures):
        means = results.means(measure)
        means['choice'] = [
            ', '.join(in_short(value) for value in row) for row in means[results.axes].to_numpy()
        ]
        names = list(dict.fromkeys(means['choice']))
        for place, strategy in enumerate(results.strategies):
            own = means[means['strategy'] == strategy]
            shift = 0.6 * ((place + 0.5) / len(results.strategies) - 0.5)
            mark = style(results, strategy)
            axes.errorbar(
                [names.index(choice) + shift for choice in own['choice']],
                own['mean'],
                [own['mean'] - own['low'], own['high'] - own['mean']],
                fmt=mark.marker,
                color=mark.colour,
                markersize=3,
                elinewidth=0.8,
            )
        axes.set_xticks(range(len(names)), names, rotation=90 if len(names) > 4 else 0)
        axes.set_title(in_text(measure))
        axes.grid(alpha=0.3)
    figure.supxlabel(', '.join(map(in_text, results.axes)))
    return figure


def panels(
    results: Results,
    measure: str,
    draw: Callable[[Axes, Series], None],
    label: str,
    scale: str = 'linear',
) -> Figure:
    """Return a figure with a panel for each combination of choices; all have the same axes."""
    every = list(results.series(measure))
    # Rows hold the lethalities of the same other choices, if there are several.
    lethalities = len({choices.get('lethality') for choices, _ in every})
    side = lethalities if lethalities > 1 else len(every)
    columns = -(-side // -(-side // COLUMNS))
    figure, grid = panel_grid(results, len(every), columns, sharey=True)
    for axes, (choices, series) in zip(grid, every):
        draw(axes, series)
        axes.set_title('\n'.join(f'{in_text(n)} {in_short(each)}' for n, each in choices.items()))
        axes.set_yscale(scale)
        axes.margins(x=0.02)
        axes.grid(alpha=0.3)
    if scale == 'log':
        low, high = grid[0].get_ylim()
        # A smaller span gets more tick labels.
        steps = (1, 2, 3, 5, 7) if high < 20.0 * low else (1, 2, 5) if high < 1e3 * low else (1,)
        grid[0].yaxis.set_major_locator(LogLocator(subs=steps))
        grid[0].yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        grid[0].yaxis.set_minor_locator(NullLocator())
    worlds = len(next(iter(every[0][1].values())))
    figure.supxlabel(f'robots (means of {worlds} worlds, 95 % intervals)')
    figure.supylabel(label)
    return figure


def panel_grid(
    results: Results, count: int, columns: int, sharey: bool
) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with panels, row by row, below the legend of all strategies."""
    # Widths in points: of the figure, and of the longest label with its line.
    widest = max(3.9 * len(strategy) + 30.0 for strategy in results.strategies)
    lines = -(-len(results.strategies) // max(1, int(72.0 * WIDTH / widest)))
    rows = -(-count // columns)
    height = (1.5 + 0.16 * len(results.axes)) * rows + 0.16 * lines + 0.6
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    grid = figure.subplots(rows, columns, sharex=sharey, sharey=sharey, squeeze=False).ravel()
    for axes in grid[count:]:
        axes.set_visible(False)
    for axes in grid[:count][-columns:]:
        axes.tick_params(labelbottom=True)
    for strategy in results.strategies:
        grid[0].plot([], [], **style(results, strategy).line(1), label=strategy)
    columns = -(-len(results.strategies) // lines)
    figure.legend(loc='outside upper center', ncols=columns, handlelength=3.0)
    return figure, list(grid[:count])


def draw_mean(axes: Axes, samples: NDArray[np.float64], line: Style) -> None:
    """Draw a line of the mean of samples, shape (worlds, robots + 1), with its interval."""
    mean, low, high = bootstrap(samples)
    axes.plot(mean, **line.line(mean.size))
    axes.fill_between(range(mean.size), low, high, color=line.colour, alpha=BAND, linewidth=0)


def style(results: Results, strategy: str) -> Style:
    """Return the style of a strategy; beyond six strategies colours return with other dashes."""
    place = results.strategies.index(strategy)
    colour, dash = (
        SERIES[place % len(SERIES)],
        SERIES[(place + place // len(SERIES)) % len(SERIES)],
    )
    return Style(colour.colour, dash.dash, dash.plotly_dash, dash.marker)


def in_text(name: str) -> str:
    """Return a name of the table in words."""
    return name.replace('_', ' ')


def in_short(value: Any) -> str:
    """Return a value of a choice in short."""
    return f'{value:.4g}' if isinstance(value, int | float) else str(value)
