# SPDX-License-Identifier: Apache-2.0
"""Figures of a study, and their panels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Literal

from kbnitp_ros.figures import WIDTH
from kbnitp_ros.study.results import (
    after_rounds,
    bootstrap_mean,
    LOG_LOSS,
    MEAN,
    of_number,
    Results,
    SD,
    trade,
)
from kbnitp_ros.study.scenario import (
    asks_for,
    Contender,
    in_percent,
    Scenario,
    Strategy,
    team_labels,
)
from kbnitp_ros.styles import SERIES, Style
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np
from numpy.typing import NDArray

# Maximum number of panels side by side.
COLUMNS = 4

Draw = Callable[[Axes, float | None, Contender, Style, str], None]


def contender_labels(scenario: Scenario) -> dict[Contender, str]:
    """Return a label for each contender, from the method and strategy fields that differ."""
    teams, are_named = team_labels(scenario), len(scenario.methods) > 1
    return {
        (method, team): ', '.join(filter(None, [method if are_named else '', teams[team]]))
        or method
        for method, team in scenario.contenders
    }


def group_contenders(contenders: Sequence[Contender]) -> list[list[Contender]]:
    """Return the contenders grouped by panel."""
    if len(contenders) <= len(SERIES):
        return [list(contenders)]
    for distinctions in (
        [method for method, _ in contenders],
        [team.allocation if team.agents > 1 else None for _, team in contenders],
    ):
        names = [name for name in dict.fromkeys(distinctions) if name is not None]
        if len(names) > 1:
            return [
                group
                for name in names
                for group in group_contenders(
                    [
                        each
                        for each, distinction in zip(contenders, distinctions)
                        if distinction in (name, None)
                    ]
                )
            ]
    first, *others = contenders
    groups = -(-len(others) // (len(SERIES) - 1))
    size = -(-len(others) // groups)
    return [[first, *others[slice(begin, begin + size)]] for begin in range(0, len(others), size)]


def panels_figure(
    scenario: Scenario, draw: Draw, across: str, up: str, scale: str = 'linear'
) -> Figure:
    """Return a figure with a panel for each lethality, and rows for groups of contenders."""
    labels, groups = contender_labels(scenario), group_contenders(scenario.contenders)
    lethalities = scenario.lethalities
    columns = columns_for(len(lethalities))
    height = 1.9 * -(-len(lethalities) // columns) + 0.4
    figure = Figure(figsize=(WIDTH, height * len(groups) + 0.4), layout='constrained')
    panels = []
    for part, group in zip(figure.subfigures(len(groups), 1, squeeze=False).flat, groups):
        row = panel_grid(part, len(lethalities), columns)
        for axes, lethality in zip(row, lethalities):
            for contender, style in zip(group, SERIES):
                draw(axes, lethality, contender, style, labels[contender])
            axes.set_title(f'lethality {in_percent(lethality)}')
            axes.set_yscale(scale)
        legend_above(part, row[0])
        panels += row
    # All panels show the same range, even without a shared axis.
    left, right = zip(*(axes.get_xlim() for axes in panels))
    low, high = zip(*(axes.get_ylim() for axes in panels))
    bottom, top = min(low), max(high)
    # A smaller span of a logarithmic axis gets more tick labels.
    steps = (1, 2, 3, 5, 7) if top < 20.0 * bottom else (1, 2, 5) if top < 1e3 * bottom else (1,)
    for axes in panels:
        axes.set_xlim(min(left), max(right))
        axes.set_ylim(bottom, top)
        if scale == 'log':
            axes.yaxis.set_major_locator(LogLocator(subs=steps))
            axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
            axes.yaxis.set_minor_locator(NullLocator())
    # A single method is not in the labels, so the axis names it.
    methods, teams = scenario.methods, scenario.teams
    method = f'{methods[0]}, ' if len(methods) == 1 < len(teams) else ''
    figure.supxlabel(f'{across} ({method}mean of {trials_in(scenario)}, 95 % intervals)')
    figure.supylabel(up)
    return figure


def trials_in(scenario: Scenario) -> str:
    """Return the number of trials of a study, in words."""
    return '1 trial' if scenario.trials == 1 else f'{scenario.trials} trials'


def columns_for(panels: int) -> int:
    """Return the number of panels side by side that fills the rows best."""
    rows = -(-panels // COLUMNS)
    return -(-panels // rows)


def panel_grid(
    part: FigureBase, panels: int, columns: int, sharey: Literal['none', 'all', 'row'] = 'all'
) -> list[Axes]:
    """Return panels that share their axes, row by row; only outer panels have tick labels."""
    rows = -(-panels // columns)
    grid = part.subplots(rows, columns, sharex=True, sharey=sharey, squeeze=False)
    used, unused = np.split(grid.ravel(), [panels])
    for axes in unused:
        axes.set_visible(False)
    for axes in used[slice(-columns, None)]:
        axes.tick_params(labelbottom=True)
    for axes in used:
        axes.grid(alpha=0.3)
    return list(used)


def legend_above(part: FigureBase, axes: Axes) -> None:
    """Draw a legend above the panels, in as many columns as fit."""
    handles, labels = axes.get_legend_handles_labels()
    # Widths in points: of the figure, and of each label with its line.
    room = 72.0 * WIDTH
    widths = [3.9 * len(label) + 30.0 for label in labels]
    columns = len(labels)
    if sum(widths) > room:
        rows = -(-len(labels) // max(1, int(room / max(widths))))
        columns = -(-len(labels) // rows)
    part.legend(handles, labels, loc='outside upper center', ncols=columns, handlelength=3.0)


# Number of classes of equal size in which predictions are compared with the truth.
CLASSES = 10

# Maximum number of contenders whose reliability is drawn side by side.
BESIDE = 5

# Opacity of the band of an interval.
BAND = 0.15

LOG_LOSS_LABEL = 'log loss of hazard and target (nats)'


def means_chart(
    results: Results,
    measures: Sequence[str],
    across: str,
    up: str,
    scale: str = 'linear',
    points: Callable[[NDArray[np.float64], Strategy], NDArray[np.float64]] = lambda each, _: each,
) -> Figure:
    """Draw the mean over trials of a sum of measures, with intervals, starting with the prior."""

    def draw(
        axes: Axes, lethality: float | None, contender: Contender, style: Style, label: str
    ) -> None:
        method, team = contender
        series = results.series(lethality, method, *measures, team=team)
        draw_mean(axes, points(series, team), style, label)
        axes.margins(x=0.02)

    return panels_figure(results.scenario, draw, across, up, scale)


def draw_mean(axes: Axes, samples: NDArray[np.float64], style: Style, label: str) -> None:
    """Draw a line of the mean of samples, shape (trials, points), with its interval."""
    mean, low, high = bootstrap_mean(samples)
    axes.plot(mean, **style.line(mean.size), label=label)
    axes.fill_between(range(mean.size), low, high, color=style.colour, alpha=BAND, linewidth=0)


def reliability_chart(results: Results) -> Figure:
    """Draw the true share of hazards and targets against the believed probability, at the end."""
    scenario = results.scenario
    contenders, labels = scenario.contenders, contender_labels(scenario)
    blocks = -(-len(contenders) // BESIDE)
    columns = -(-len(contenders) // blocks)
    side = WIDTH / max(3, columns)
    figure = Figure(
        figsize=(side * columns, blocks * (1.8 * side + 0.3) + 0.5), layout='constrained'
    )
    grid = figure.subplots(2 * blocks, columns, sharex=True, sharey=True, squeeze=False)
    # Shape (contenders, 2): a panel for each contender and map.
    panels = grid.reshape(blocks, 2, columns).swapaxes(1, 2).reshape(-1, 2)
    used, unused = np.split(panels, [len(contenders)])
    for axes in unused.flat:
        axes.set_visible(False)
    for contender, column in zip(contenders, used):
        column[0].set_title(labels[contender].replace(', ', '\n'), fontsize='small')
        draw_reliability(column, results, contender)
    for _, axes in used[slice(-columns, None)]:
        axes.tick_params(labelbottom=True)
    for row, name in zip(grid, ('hazard', 'target') * blocks):
        row[0].set_ylabel(f'share with a {name}')
    figure.supxlabel('probability believed after the last robot')
    legend_above(figure, grid[0, 0])
    return figure


def draw_reliability(panels: NDArray[np.object_], results: Results, contender: Contender) -> None:
    """Draw the reliability of a contender's maps of hazards and of targets."""
    lethalities = results.scenario.lethalities
    for axes in panels:
        axes.plot([0, 1], [0, 1], color='0.7', linewidth=0.8)
        axes.set_aspect('equal')
        axes.set_xticks([0.0, 0.5, 1.0])
        axes.set_yticks([0.0, 0.5, 1.0])
        axes.grid(alpha=0.3)
    # Draw at most as many lethalities, evenly spread, as there are line styles.
    few = np.unique(np.linspace(0, len(lethalities) - 1, len(SERIES)).round().astype(int))
    for lethality, style in zip([lethalities[place] for place in few], SERIES):
        believed, truth = results.final_maps(lethality, *contender)
        for axes, *cells in zip(panels, believed.swapaxes(0, 1), truth.swapaxes(0, 1)):
            held, there = reliability(*cells)
            name = f'lethality {in_percent(lethality)}'
            axes.plot(held, there, **style.line(held.size), label=name)


def reliability(
    believed: NDArray[np.float64], truth: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean prediction and the true share in each class."""
    order = np.argsort(believed, axis=None, kind='stable')
    classes = np.array_split(order, min(CLASSES, order.size))
    held = np.array([believed.flat[cells].mean() for cells in classes])
    there = np.array([truth.flat[cells].mean() for cells in classes])
    return held, there


def teams_chart(results: Results) -> Figure:
    """Draw the mean log loss after each round, with a panel for each lethality."""
    return means_chart(
        results,
        LOG_LOSS,
        'round',
        LOG_LOSS_LABEL,
        'log',
        lambda series, team: after_rounds(series, team.agents),
    )


def loss_cost_chart(results: Results) -> Figure:
    """Draw log loss against robots lost, with a panel for each lethality."""

    def draw(
        axes: Axes, lethality: float | None, contender: Contender, style: Style, label: str
    ) -> None:
        method, team = contender
        (lost, log_loss), low, high = bootstrap_mean(
            trade(partial(results.series, lethality, method), team)
        )
        at_its_end = {'markevery': [-1], 'markersize': 5}
        axes.plot(lost, log_loss, **style.line(lost.size) | at_its_end, label=label)
        end = lost[-1], log_loss[-1]
        (left, bottom), (right, top) = (np.abs(each[:, -1] - end) for each in (low, high))
        axes.errorbar(
            *end,
            [[bottom], [top]],
            [[left], [right]],
            fmt='none',
            ecolor=style.colour,
            elinewidth=0.8,
        )

    return panels_figure(results.scenario, draw, 'robots lost', LOG_LOSS_LABEL)


def numbers_chart(results: Results) -> Figure:
    """Draw the error of learnt numbers after each deployment, by number and lethality."""
    scenario, names = results.scenario, list(results.scenario.learn.priors)
    shown_in = list(product(names, scenario.lethalities))
    # With several lethalities each number has a row of panels.
    are_rows = len(scenario.lethalities) > 1
    columns = len(scenario.lethalities) if are_rows else columns_for(len(names))
    rows = -(-len(shown_in) // columns)
    figure = Figure(figsize=(WIDTH, 1.7 * rows + 0.6), layout='constrained')
    panels = panel_grid(figure, len(shown_in), columns, sharey='row' if are_rows else 'none')
    for place, ((name, lethality), axes) in enumerate(zip(shown_in, panels)):
        draw_known(axes, *of_number(results, lethality, name))
        if not are_rows:
            axes.set_title(name.replace('_', ' '))
        elif place % columns == 0:
            axes.set_ylabel(name.replace('_', ' '))
        if are_rows and place < columns:
            axes.set_title(f'lethality {in_percent(lethality)}')
    figure.supxlabel(f'deployment (root mean squares of {trials_in(scenario)})')
    legend_above(figure, panels[0])
    return figure


def draw_known(axes: Axes, known: NDArray[np.float64], truth: NDArray[np.float64]) -> None:
    """Draw the error of a number's posterior mean, and the posterior standard deviation."""
    error = np.sqrt(((known[:, :, MEAN] - truth) ** 2).mean(axis=0))
    spread = np.sqrt((known[:, :, SD] ** 2).mean(axis=0))
    lines = {'error of the mean': error, 'standard deviation believed': spread}
    for (label, values), style in zip(lines.items(), SERIES):
        axes.plot(values, **style.line(values.size), label=label)
    axes.margins(x=0.02)
    axes.set_ylim(bottom=0.0)


def decision_chart(results: Results) -> Figure:
    """Draw the share of worlds with a free lane, or the share of the area declared free."""
    measure, up = (
        ('declared', 'part of the area declared free')
        if asks_for(results.scenario, 'area')
        else ('free', 'share of worlds in which it is free')
    )
    return means_chart(results, (measure,), 'deployment', up)
