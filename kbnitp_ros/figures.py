# SPDX-License-Identifier: Apache-2.0
"""Figures by Matplotlib: the field from above, a forecast, sizes and files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from kbnitp_ros.core import Belief, Grid, Observation, World
from kbnitp_ros.core.forecast import Forecast
from kbnitp_ros.plugins import extra
from kbnitp_ros.styles import extent, LOST, MAPS, RETURNED, Scale, SERIES, stops
import numpy as np
from numpy.typing import ArrayLike, NDArray

with extra('report'):
    from matplotlib import rc_context
    from matplotlib.axes import Axes
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline
    from matplotlib.text import Text
    from matplotlib.transforms import Affine2D, Transform

DPI = 300
FORMATS = ('png', 'svg', 'pdf')

# Letters are embedded as outlines in SVG and as TrueType in PDF, where they stay text.
EMBEDDED = {'svg.fonttype': 'path', 'svg.hashsalt': 'kbnitp_ros', 'pdf.fonttype': 42}

# Inches: two columns of a journal.
WIDTH = 7.2

# Each figure sets its layout, whatever the user's defaults are.
AS_ASKED = {'figure.autolayout': False, 'figure.constrained_layout.use': False}

# Font sizes, in points of the printed figure.
LETTERS = {
    'font.size': 8,
    'axes.titlesize': 8,
    'axes.labelsize': 8,
    'figure.labelsize': 8,
    'xtick.labelsize': 7,
    'ytick.labelsize': 7,
    'legend.fontsize': 7,
    'legend.frameon': False,
    'axes.linewidth': 0.6,
    'xtick.major.width': 0.6,
    'ytick.major.width': 0.6,
}

# Metadata without anything that differs between runs.
METADATA = {'png': {}, 'svg': {'Date': None}, 'pdf': {'CreationDate': None}}


def save(figure: Figure, path: Path, *formats: str, dpi: int = DPI) -> list[Path]:
    """Write a figure once for each format."""
    files = [path.with_suffix(f'.{each}') for each in formats]
    for text in figure.findobj(Text):
        text.set_usetex(False)
    with rc_context({**EMBEDDED, **AS_ASKED, 'text.usetex': False}):
        for file, each in zip(files, formats):
            figure.savefig(file, dpi=dpi, metadata=METADATA[each])
            # Keep the layout of the first format, so that all formats look the same.
            figure.set_layout_engine(None)
    return files


# Maximum side of a field, in cells, for which lines between cells are drawn.
MAX_LINED = 20


def plot(
    grid: Grid,
    belief: Belief,
    world: World | None = None,
    paths: Iterable[ArrayLike | Observation] = (),
    axes: Sequence[Axes] | None = None,
) -> NDArray[Any]:
    """Draw the hazard, target and kappa maps of a belief."""
    if belief.cells != grid.cells:
        raise ValueError(f'belief has {belief.cells} cells: the grid has {grid.cells}')
    if world is not None:
        world.check(grid)
    given = list(paths)
    walks = [
        grid.check_any_path(each.path if isinstance(each, Observation) else each) for each in given
    ]
    if axes is None:
        # Notebooks show only figures made by pyplot.
        from matplotlib import pyplot

        axes = pyplot.subplots(1, 3, figsize=(10.5, 3.2), layout='constrained')[1]
    if len(axes) != len(MAPS):
        raise ValueError(f'axes are {len(axes)}: there must be {len(MAPS)}')
    for panel, (name, scale) in zip(axes, MAPS.items()):
        draw_map(panel, grid, getattr(belief, name), scale, name)
    for each, walk in zip(given, walks):
        lost = isinstance(each, Observation) and not each.survived
        style = LOST if lost else RETURNED
        axes[0].plot(*grid.centers(walk).T, color=style.colour, linestyle=style.dash)
    if world is not None:
        hazards, targets = np.flatnonzero(world.hazard), np.flatnonzero(world.target)
        axes[0].plot(*grid.centers(hazards).T, 'x', color='black')
        axes[1].plot(*grid.centers(targets).T, 'o', color='black', markerfacecolor='none')
    return np.asarray(axes)


def draw_map(
    axes: Axes,
    grid: Grid,
    values: NDArray[np.float64],
    scale: Scale,
    title: str,
    prior: float = 0.5,
) -> None:
    """Draw one probability for each cell, seen from above, bases as white squares."""
    image = np.where(grid.free, values, np.nan).reshape(grid.height, grid.width)
    colours = LinearSegmentedColormap.from_list(title, stops(scale, prior))
    drawn = axes.imshow(
        image,
        origin='lower',
        cmap=colours,
        vmin=0.0,
        vmax=1.0,
        extent=extent(grid),
        transform=turned(axes, grid),
    )
    bar = axes.figure.colorbar(
        drawn, cax=axes.inset_axes((1.05, 0.15, 0.06, 0.7)), ticks=(0.0, 0.5, 1.0)
    )
    bar.ax.tick_params(labelsize='small')
    draw_field(axes, grid)
    axes.set_title(title, fontsize='medium')


def turned(axes: Axes, grid: Grid) -> Transform:
    """Return the axes' transform for a turned grid."""
    return Affine2D().rotate_around(*grid.origin, grid.yaw) + axes.transData


def draw_field(axes: Axes, grid: Grid) -> None:
    """Draw bases, blocked cells and, where there are few, the lines between cells."""
    left, right, bottom, top = extent(grid)
    corners = grid.in_metres([(x, y) for x in (0, grid.width) for y in (0, grid.height)])
    axes.set_xlim(*np.sort(corners[:, 0])[[0, -1]])
    axes.set_ylim(*np.sort(corners[:, 1])[[0, -1]])
    axes.set_aspect('equal')
    axes.add_patch(PathPatch(outlines(grid, ~grid.free), facecolor='0.6', linewidth=0))
    if max(grid.width, grid.height) <= MAX_LINED:
        columns = left + np.arange(1, grid.width) * grid.resolution
        rows = bottom + np.arange(1, grid.height) * grid.resolution
        line: dict[str, Any] = {'color': '0.75', 'linewidth': 0.4}
        line['transform'] = turned(axes, grid)
        axes.vlines(columns, bottom, top, **line)
        axes.hlines(rows, left, right, **line)
    x, y = grid.centers(sorted(grid.bases)).T
    axes.plot(x, y, 's', color='white', markeredgecolor='black', zorder=5, linestyle='')
    axes.set_xlabel('x (m)')
    axes.set_ylabel('y (m)')
    axes.locator_params(nbins=3)
    axes.tick_params(labelsize='small')


def outlines(grid: Grid, cells: NDArray[np.bool_]) -> Outline:
    """Return the outlines of some cells as one path, so that one hatching covers all of them."""
    around = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
    row, col = np.divmod(np.flatnonzero(cells), grid.width)
    corners = np.stack([col, row], axis=-1).reshape(-1, 1, 2) + around
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    vertices = grid.in_metres(corners).reshape(-1, 2)
    return Outline(vertices, codes * len(corners)) if len(corners) else Outline(np.empty((0, 2)))


# Quantiles of the bands, and their opacities.
BANDS = ((0.05, 0.95, 0.15), (0.25, 0.75, 0.3))


def forecast_figure(forecast: Forecast) -> Figure:
    """Draw robots lost, entropy or P(goal is free), and the share of missions at a confidence."""
    panels = [
        ('robots lost', forecast.lost),
        ('entropy (nats)', forecast.entropy)
        if forecast.goal == 'map'
        else (f'probability that the {forecast.goal} is free', forecast.p_free),
    ]
    panels_and_goal = len(panels) + (forecast.confidence is not None)
    with rc_context(LETTERS):
        figure = Figure(figsize=(WIDTH, 2.6), layout='constrained')
        all_axes: Sequence[Axes] = figure.subplots(1, panels_and_goal)
        for axes, (label, series) in zip(all_axes, panels):
            draw_series(axes, series)
            axes.set_ylabel(label)
        if forecast.confidence is not None:
            axes = all_axes[-1]
            share = forecast.reached.mean(axis=0)
            axes.plot(share, color=SERIES[0].colour, drawstyle='steps-post')
            axes.set_ylim(0.0, 1.0)
            axes.set_ylabel(f'share of missions at {forecast.confidence:.4g}')
        for axes in all_axes:
            axes.set_xlabel('robots sent')
            axes.margins(x=0.02)
        all_axes[0].legend()
    return figure


def draw_series(axes: Axes, series: NDArray[np.float64]) -> None:
    """Draw the median of series, (worlds, robots + 1), with bands of quantiles."""
    colour, robots = SERIES[0].colour, range(series.shape[1])
    for low, high, alpha in BANDS:
        axes.fill_between(
            robots,
            *np.quantile(series, (low, high), axis=0, method='inverted_cdf'),
            color=colour,
            alpha=alpha,
            linewidth=0,
            label=f'{100 * low:.0f} to {100 * high:.0f} %',
        )
    median = np.quantile(series, 0.5, axis=0, method='inverted_cdf')
    axes.plot(median, color=colour, label='median')
