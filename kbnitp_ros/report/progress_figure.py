# SPDX-License-Identifier: Apache-2.0
"""The picture of how a mission got there."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.figures import SERIES
from kbnitp_ros.report.curves import Curves
from kbnitp_ros.report.mission import Mission
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np
from numpy.typing import NDArray

COLUMNS = 2


@dataclass(frozen=True, eq=False)
class Panel:
    """A part of the picture."""

    # What is drawn, and its unit.
    label: str
    # By their names, one value a moment.
    lines: dict[str, NDArray[np.float64]]


def panels_of(curves: Curves) -> list[Panel]:
    """Return what there is to draw of a mission."""
    panels = [
        Panel(
            'entropy (nats)',
            {
                'H(Z) + H(X), all': curves.entropy,
                'H(Z), hazards': curves.hazard_entropy,
                'H(X), targets': curves.target_entropy,
                'H(Z, X), joint': curves.joint_entropy,
            },
        )
    ]
    if not np.isnan(curves.hazard_loss).all():
        panels.append(
            Panel(
                'log loss (nats)',
                {'hazard map': curves.hazard_loss, 'target map': curves.target_loss},
            )
        )
    panels.append(
        Panel(
            'information so far (nats)',
            {
                'expected': np.nancumsum(curves.expected),
                'gained': np.nancumsum(curves.gained),
            },
        )
    )
    panels.append(
        Panel(
            'robots',
            {'lost': curves.lost.astype(np.float64), 'out': curves.out.astype(np.float64)},
        )
    )
    return panels


def progress_figure(mission: Mission, curves: Curves) -> Figure:
    """Return the picture of entropy, log loss, information and losses after each deployment."""
    panels = panels_of(curves)
    names = list(mission.moments[-1].learnt)
    rows = -(-(len(panels) + len(names)) // COLUMNS)
    figure = Figure(figsize=(7.2, 2.4 * rows + 0.3), layout='constrained')
    grid = figure.subplots(rows, COLUMNS, sharex=True, squeeze=False)
    places = iter(grid.flat)
    for panel, axes in zip(panels, places):
        draw_panel(axes, panel)
    for name, axes in zip(names, places):
        draw_number(axes, name, quantiles_of(mission, name), mission.numbers.get(name))
    for axes in places:
        axes.set_visible(False)
    for axes in grid.flat:
        # The last row may not be full.
        axes.tick_params(labelbottom=True)
        axes.set_xlim(0, max(1, len(mission.moments) - 1))
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        axes.grid(alpha=0.3)
    figure.supxlabel('reports taken in')
    return figure


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw some lines, each with a colour, a line style and a marker of its own."""
    for (name, values), style in zip(panel.lines.items(), SERIES):
        axes.plot(values, **style.line(len(values)), label=name)
    axes.set_ylabel(panel.label)
    lowest = np.nanmin([0.0, *(np.nanmin(values) for values in panel.lines.values())])
    axes.set_ylim(bottom=lowest)
    axes.legend(fontsize='small', framealpha=0.8)


def quantiles_of(mission: Mission, name: str) -> NDArray[np.float64]:
    """Return the quantiles of a number that was learnt, shape (moments, 5); NaN if unknown."""
    return np.array(
        [
            each.learnt[name].quantiles if name in each.learnt else [np.nan] * 5
            for each in mission.moments
        ]
    )


def draw_number(
    axes: Axes, name: str, quantiles: NDArray[np.float64], truth: float | None
) -> None:
    """Draw what was known of a number at each moment, and what it is, from 0 to 1."""
    low, lower, middle, upper, high = quantiles.T
    moments = np.arange(middle.size)
    axes.fill_between(moments, low, high, color='0.85', linewidth=0, label='90 %')
    axes.fill_between(moments, lower, upper, color='0.65', linewidth=0, label='50 %')
    axes.plot(moments, middle, color='black', label='median')
    if truth is not None:
        axes.axhline(truth, color=SERIES[1].colour, linestyle=SERIES[1].dash, label='truth')
    axes.set_ylim(0, 1)
    # A name out of a log is no formula, whatever stands in it.
    axes.set_ylabel(name.replace('_', ' '), parse_math=False)
    axes.legend(ncols=2, fontsize='small', framealpha=0.8)
