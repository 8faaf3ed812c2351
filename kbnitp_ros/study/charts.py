# SPDX-License-Identifier: Apache-2.0
"""Pictures of a study: how the contenders' beliefs get sure, how true, how calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kbnitp_ros.figures import save, SERIES
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Contender, in_percent
from kbnitp_ros.study.summary import LOG_LOSS, mean_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np
from numpy.typing import NDArray

# Predictions are compared with what is there in this many classes of equally many cells.
CLASSES = 10


def entropy_chart(path: Path, results: Results) -> None:
    """Draw the mean entropy after each deployment, a panel a lethality: the paper's figure."""
    _chart(path, results, ('entropy',), 'entropy H(Z) + H(X) (nats)', 'linear')


def log_loss_chart(path: Path, results: Results) -> None:
    """Draw the mean log loss after each deployment against the truth, a panel a lethality."""
    _chart(path, results, LOG_LOSS, 'log loss of hazard and target (nats)', 'log')


def _chart(
    path: Path, results: Results, measures: tuple[str, ...], label: str, scale: str
) -> None:
    scenario = results.scenario
    # No more lines in a panel than can be told apart: beyond that in panels of their own.
    contenders = scenario.contenders
    groups = [
        contenders[slice(begin, begin + len(SERIES))]
        for begin in range(0, len(contenders), len(SERIES))
    ]
    columns = min(3, len(scenario.lethalities))
    rows = -(-len(scenario.lethalities) // columns)
    height = 3 * rows * len(groups) + 0.6
    figure = Figure(figsize=(4 * columns, height), layout='constrained')
    shape = rows * len(groups), columns
    grid = figure.subplots(*shape, sharex=True, sharey=True, squeeze=False)
    for group, block in zip(groups, np.split(grid, len(groups))):
        for lethality, axes in zip(scenario.lethalities, block.flat):
            _panel(axes, results, lethality, group, measures, scale)
        for axes in list(block.flat)[slice(len(scenario.lethalities), None)]:
            axes.set_visible(False)
        if len(groups) > 1:
            block.flat[0].legend(fontsize='x-small')
    figure.supxlabel(f'deployment (mean of {scenario.trials} trials, 95 % band)')
    figure.supylabel(label)
    if len(groups) == 1:
        handles, labels = grid[0, 0].get_legend_handles_labels()
        # In points: a letter of a label, and its line.
        widest = 5.2 * max(map(len, labels)) + 40.0
        columns = max(1, min(5, len(labels), int(72.0 * figure.get_figwidth() / widest)))
        figure.legend(handles, labels, loc='outside upper center', ncols=columns)
    save(figure, path, 'png', 'pdf')


def _panel(
    axes: Axes,
    results: Results,
    lethality: float | None,
    contenders: Sequence[Contender],
    measures: tuple[str, ...],
    scale: str,
) -> None:
    """Draw one line a contender, each with a colour, a line style and a marker of its own."""
    for contender, style in zip(contenders, SERIES):
        method, team = contender
        mean, low, high = mean_of(results.series(lethality, method, *measures, team=team))
        axes.plot(
            mean,
            color=style.colour,
            linestyle=style.dash,
            marker=style.marker,
            markersize=3,
            markevery=max(1, len(mean) // 6),
            linewidth=1.2,
            label=str(contender),
        )
        axes.fill_between(range(len(mean)), low, high, color=style.colour, alpha=0.2, lw=0)
    axes.set_title(f'lethality {in_percent(lethality)}')
    axes.set_xlim(0, results.scenario.robots)
    axes.set_yscale(scale)
    if scale == 'log':
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.yaxis.set_minor_locator(NullLocator())
    axes.grid(alpha=0.3)


def reliability_chart(path: Path, results: Results) -> None:
    """
    Draw how often a thing is there against how likely it was held, after the last robot.

    One panel a contender and map, one line a lethality, over the cells of all trials. On the
    diagonal a belief means what it says.
    """
    contenders, lethalities = results.scenario.contenders, results.scenario.lethalities
    figure = Figure(figsize=(2.4 * len(contenders) + 1, 5.6), layout='constrained')
    grid = figure.subplots(2, len(contenders), sharex=True, sharey=True, squeeze=False)
    # Of many lethalities as many as can be told apart, spread evenly.
    few = np.unique(np.linspace(0, len(lethalities) - 1, len(SERIES)).round().astype(int))
    styles = [(lethalities[place], style) for place, style in zip(few, SERIES)]
    for contender, column in zip(contenders, grid.T):
        column[0].set_title(str(contender), fontsize='medium')
        for axes in column:
            axes.plot([0, 1], [0, 1], color='0.7', linewidth=1)
        for lethality, style in styles:
            believed, truth = results.final_maps(lethality, *contender)
            for axes, *cells in zip(column, believed.swapaxes(0, 1), truth.swapaxes(0, 1)):
                axes.plot(
                    *reliability(*cells),
                    color=style.colour,
                    linestyle=style.dash,
                    marker=style.marker,
                    markersize=3,
                    linewidth=1,
                    label=in_percent(lethality),
                )
    for axes, name in zip(grid[:, 0], ('hazards', 'targets')):
        axes.set_ylabel(f'{name} there')
    figure.supxlabel('probability believed after the last robot')
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=len(labels))
    save(figure, path, 'png', 'pdf')


def reliability(
    believed: NDArray[np.float64], truth: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Compare probabilities with how often what they are of is there.

    Parameters
    ----------
    believed : ndarray, shape (...)
        Probabilities.
    truth : ndarray of bool, shape (...)
        What is there.

    Returns
    -------
    held, there : ndarray, shape (classes,)
        The mean probability and the share that is there, in `CLASSES` classes of equally many
        cells from the least to the most likely; fewer if there are fewer cells.

    """
    order = np.argsort(believed, axis=None, kind='stable')
    classes = np.array_split(order, min(CLASSES, order.size))
    held = np.array([believed.flat[cells].mean() for cells in classes])
    there = np.array([truth.flat[cells].mean() for cells in classes])
    return held, there
