# SPDX-License-Identifier: Apache-2.0
"""Pictures of a study: how the contenders' beliefs get sure, how true, how calibrated."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kbnitp_ros.figures import SERIES, Style, WIDTH
from kbnitp_ros.study.panels import labels_of, legend_above, panels_figure
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Contender, in_percent, Strategy
from kbnitp_ros.study.summary import LOG_LOSS, mean_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

# Predictions are compared with what is there in this many classes of equally many cells.
CLASSES = 10

# Contenders whose reliability is drawn beside each other, at most.
BESIDE = 5

# How much of its colour a band keeps, through which others show.
BAND = 0.15

LOG_LOSS_LABEL = 'log loss of hazard and target (nats)'


def entropy_chart(results: Results) -> Figure:
    """Draw the mean entropy after each deployment, a panel a lethality: the paper's figure."""
    return means_chart(results, ('entropy',), 'deployment', 'entropy H(Z) + H(X) (nats)')


def log_loss_chart(results: Results) -> Figure:
    """Draw the mean log loss after each deployment against the truth, a panel a lethality."""
    return means_chart(results, LOG_LOSS, 'deployment', LOG_LOSS_LABEL, 'log')


def means_chart(
    results: Results,
    measures: Sequence[str],
    across: str,
    up: str,
    scale: str = 'linear',
    points: Callable[[NDArray[np.float64], Strategy], NDArray[np.float64]] = lambda each, _: each,
) -> Figure:
    """Draw the mean of a sum of measures over trials with its intervals, from the prior on."""

    def draw(
        axes: Axes, lethality: float | None, contender: Contender, style: Style, label: str
    ) -> None:
        series = results.series(lethality, contender.method, *measures, team=contender.team)
        draw_mean(axes, points(series, contender.team), style, label)
        axes.margins(x=0.02)

    return panels_figure(results.scenario, draw, across, up, scale)


def draw_mean(axes: Axes, samples: NDArray[np.float64], style: Style, label: str) -> None:
    """Draw a line of the mean of samples, shape (trials, points), with its interval."""
    mean, low, high = mean_of(samples)
    axes.plot(mean, **style.line(mean.size), label=label)
    axes.fill_between(range(mean.size), low, high, color=style.colour, alpha=BAND, linewidth=0)


def reliability_chart(results: Results) -> Figure:
    """Draw how often a thing is there against how likely it was held, after the last robot."""
    scenario = results.scenario
    contenders, labels = scenario.contenders, labels_of(scenario)
    blocks = -(-len(contenders) // BESIDE)
    columns = -(-len(contenders) // blocks)
    side = WIDTH / max(3, columns)
    figure = Figure(
        figsize=(side * columns, blocks * (1.8 * side + 0.3) + 0.5), layout='constrained'
    )
    grid = figure.subplots(2 * blocks, columns, sharex=True, sharey=True, squeeze=False)
    # One row a contender, which has a panel a map.
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
    # Of many lethalities as many as can be told apart, spread evenly.
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
    """Return how likely things are held to be, and which part of them is there, by classes."""
    order = np.argsort(believed, axis=None, kind='stable')
    classes = np.array_split(order, min(CLASSES, order.size))
    held = np.array([believed.flat[cells].mean() for cells in classes])
    there = np.array([truth.flat[cells].mean() for cells in classes])
    return held, there
