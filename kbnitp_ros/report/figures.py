# SPDX-License-Identifier: Apache-2.0
"""Figures of a mission: its final belief, and its progress."""

from __future__ import annotations

from kbnitp_ros.figures import draw_map, draw_paths, hatch, LOST, MAPS, RETURNED, SERIES
from kbnitp_ros.files import counted
from kbnitp_ros.report.mission import Mission
from kbnitp_ros.report.tables import Curves
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np
from numpy.typing import NDArray

COLUMNS = 2


# Curves of a panel by name, one value for each moment.
Lines = dict[str, NDArray[np.float64]]


def mission_panels(curves: Curves) -> dict[str, Lines]:
    """Return the curves of each panel of a mission, by the panel's title with the unit."""
    log_loss = {'hazard map': curves.hazard_loss, 'target map': curves.target_loss}
    return {
        'entropy (nats)': {
            'H(Z) + H(X), all': curves.entropy,
            'H(Z), hazards': curves.hazard_entropy,
            'H(X), targets': curves.target_entropy,
            'H(Z, X), joint': curves.joint_entropy,
        },
        **({} if np.isnan(curves.hazard_loss).all() else {'log loss (nats)': log_loss}),
        'information so far (nats)': {
            'expected': np.nancumsum(curves.expected),
            'gained': np.nancumsum(curves.gained),
        },
        'robots': {'lost': curves.lost.astype(np.float64), 'out': curves.out.astype(np.float64)},
    }


def progress_figure(mission: Mission, curves: Curves) -> Figure:
    """Return the figure of entropy, log loss, information and losses after each deployment."""
    panels = mission_panels(curves)
    names = list(mission.moments[-1].state.numbers)
    rows = -(-(len(panels) + len(names)) // COLUMNS)
    height = 2.4 * rows + 0.3
    figure = Figure(figsize=(7.2, height))
    grid = figure.subplots(rows, COLUMNS, sharex=True, squeeze=False)
    figure.subplots_adjust(0.09, 0.55 / height, 0.97, 1.0 - 0.12 / height, wspace=0.24, hspace=0.2)
    places = iter(grid.flat)
    for (label, lines), axes in zip(panels.items(), places):
        for (name, values), style in zip(lines.items(), SERIES):
            axes.plot(values, **style.line(len(values)), label=name)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=np.nanmin([0.0, *map(np.nanmin, lines.values())]))
        axes.legend(fontsize='small', framealpha=0.8)
    for name, axes in zip(names, places):
        draw_number(axes, name, learnt_quantiles(mission, name), mission.numbers.get(name))
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


def learnt_quantiles(mission: Mission, name: str) -> NDArray[np.float64]:
    """Return the quantiles of a learnt number, shape (moments, 5); NaN if unknown."""
    return np.array(
        [
            each.state.numbers[name].quantiles if name in each.state.numbers else [np.nan] * 5
            for each in mission.moments
        ]
    )


def draw_number(
    axes: Axes, name: str, quantiles: NDArray[np.float64], truth: float | None
) -> None:
    """Draw the posterior of a learnt number at each moment, and its true value."""
    low, lower, middle, upper, high = quantiles.T
    moments = np.arange(middle.size)
    axes.fill_between(moments, low, high, color='0.85', linewidth=0, label='90 %')
    axes.fill_between(moments, lower, upper, color='0.65', linewidth=0, label='50 %')
    axes.plot(moments, middle, color='black', label='median')
    if truth is not None:
        axes.axhline(truth, color=SERIES[1].colour, linestyle=SERIES[1].dash, label='truth')
    axes.set_ylim(0, 1)
    # A name from a log must not be parsed as a formula.
    axes.set_ylabel(name.replace('_', ' '), parse_math=False)
    axes.legend(ncols=2, fontsize='small', framealpha=0.8)


def maps_figure(mission: Mission, note: str = '') -> Figure:
    """Return the figure of the last belief."""
    grid, belief, world = mission.grid, mission.moments[-1].belief, mission.world
    visited = mission.visited()
    rows = ('abcd', 'efgh') if world else ('abc', 'dh.')
    figure = Figure(figsize=(10.5, 5.4) if world else (8.0, 5.4))
    axes = figure.subplot_mosaic([list(row) for row in rows], empty_sentinel='.')
    figure.subplots_adjust(0.05, 0.09, 0.98, 0.9, wspace=0.32, hspace=0.2)
    assumed = mission.assumed
    for name, panel in zip(MAPS, 'abc'):
        said = f'{name}, believed'
        draw_map(axes[panel], grid, getattr(belief, name), MAPS[name], said, assumed[name])
        hatch(axes[panel], grid, ~visited & grid.free)
    if world:
        kappa = np.where(world.hazard, world.target, np.nan).astype(np.float64)
        draw_map(axes['e'], grid, world.hazard.astype(float), MAPS['hazard'], 'hazard, true')
        draw_map(axes['f'], grid, world.target.astype(float), MAPS['target'], 'target, true')
        draw_map(axes['g'], grid, kappa, MAPS['kappa'], 'target where a hazard is')
    ended = mission.ended
    for panel, survived, style, what in (
        ('d', True, RETURNED, 'returned'),
        ('h', False, LOST, 'lost'),
    ):
        draw_paths(axes[panel], grid, [each for each in ended if each.survived == survived], style)
        number = sum(each.survived == survived for each in ended)
        axes[panel].set_title(f'{counted(number, "robot")} {what}', fontsize='medium')
        hatch(axes[panel], grid, ~visited & grid.free)
    for panel_axes in axes.values() if world else ():
        panel_axes.label_outer()
    figure.suptitle(note or caption(mission), fontsize='medium')
    return figure


def caption(mission: Mission) -> str:
    """Return the caption of the hatching; empty without hatching."""
    unvisited = int((~mission.visited() & mission.grid.free).sum())
    cells = counted(unvisited, 'cell')
    return f'hatched: {cells} that no robot was sent into' if unvisited else ''
