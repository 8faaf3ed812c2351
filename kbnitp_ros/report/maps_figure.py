# SPDX-License-Identifier: Apache-2.0
"""The picture of what a mission came to believe, beside the truth, and of where robots went."""

from __future__ import annotations

from collections.abc import Sequence

from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.figures import LOST, MAPS, RETURNED, Style, UNVISITED
from kbnitp_ros.report.mission import Mission
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
import numpy as np
from numpy.typing import NDArray

# Cells are told apart by lines where there are at most so many a side.
MOST_LINED = 20

# How dark a path is drawn if it is the only one; those of many robots let each other show through.
DARKEST = 0.9


def maps_figure(mission: Mission, note: str = '') -> Figure:
    """
    Return the picture of the last belief.

    Hazard, target and kappa as believed above, as they are below if that is on record; then where
    the robots went that returned, and where those were sent that were lost. Cells that nobody was
    sent into are hatched.
    """
    grid, belief, world = mission.grid, mission.moments[-1].belief, mission.world
    visited = mission.visited()
    rows = ('abcd', 'efgh') if world else ('abc', 'dh.')
    figure = Figure(figsize=(10.5, 5.4) if world else (8.0, 5.4), layout='constrained')
    axes = figure.subplot_mosaic([list(row) for row in rows], empty_sentinel='.')
    for name, panel in zip(MAPS, 'abc'):
        draw_map(axes[panel], grid, getattr(belief, name), MAPS[name], f'{name}, believed')
        hatch(axes[panel], grid, ~visited & grid.free)
    if world:
        kappa = np.where(world.hazard, world.target, np.nan).astype(np.float64)
        draw_map(axes['e'], grid, world.hazard.astype(float), MAPS['hazard'], 'hazard, true')
        draw_map(axes['f'], grid, world.target.astype(float), MAPS['target'], 'target, true')
        draw_map(axes['g'], grid, kappa, MAPS['kappa'], 'target where a hazard is')
    ended = mission.ended
    for panel, survived, style, what in (
        ('d', True, RETURNED, 'returned'),
        ('h', False, LOST, 'were lost'),
    ):
        draw_paths(axes[panel], grid, [each for each in ended if each.survived == survived], style)
        number = sum(each.survived == survived for each in ended)
        axes[panel].set_title(f'{robots(number)} {what}', fontsize='medium')
        hatch(axes[panel], grid, ~visited & grid.free)
    figure.suptitle(note or caption(mission), fontsize='medium')
    return figure


def caption(mission: Mission) -> str:
    """Return what the hatching means, if there is any."""
    unvisited = int((~mission.visited() & mission.grid.free).sum())
    return f'hatched: {unvisited} cells that no robot was sent into' if unvisited else ''


def robots(number: int) -> str:
    """Return a number of robots in words."""
    return '1 robot' if number == 1 else f'{number} robots'


def draw_map(
    axes: Axes, grid: Grid, values: NDArray[np.float64], colours: str, title: str
) -> None:
    """
    Draw one probability a cell as the field is seen from above, the base as a white square.

    Parameters
    ----------
    axes : Axes
        Where.
    grid : Grid
        The field.
    values : ndarray, shape (cells,)
        In [0, 1]; cells without a value are white, blocked ones grey.
    colours : str
        A matplotlib colour map.
    title : str
        Above the map.

    """
    image = np.where(grid.free, values, np.nan).reshape(grid.height, grid.width)
    drawn = axes.imshow(
        image, origin='lower', cmap=colours, vmin=0.0, vmax=1.0, extent=extent(grid)
    )
    axes.figure.colorbar(drawn, ax=axes, shrink=0.7)
    draw_field(axes, grid)
    axes.set_title(title, fontsize='medium')


def extent(grid: Grid) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of a grid in metres."""
    left, bottom = grid.origin
    right, top = left + grid.width * grid.resolution, bottom + grid.height * grid.resolution
    return left, right, bottom, top


def draw_field(axes: Axes, grid: Grid) -> None:
    """Draw base, blocked cells and, where there are few, the lines between cells."""
    left, right, bottom, top = extent(grid)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect('equal')
    axes.add_patch(PathPatch(outlines(grid, ~grid.free), facecolor='0.6', linewidth=0))
    if max(grid.width, grid.height) <= MOST_LINED:
        columns = left + np.arange(1, grid.width) * grid.resolution
        rows = bottom + np.arange(1, grid.height) * grid.resolution
        axes.vlines(columns, bottom, top, color='0.75', linewidth=0.4)
        axes.hlines(rows, left, right, color='0.75', linewidth=0.4)
    ((x, y),) = grid.centers([grid.base])
    axes.plot(x, y, 's', color='white', markeredgecolor='black', zorder=5)
    axes.set_xlabel('x (m)')
    axes.set_ylabel('y (m)')
    axes.locator_params(nbins=3)
    axes.tick_params(labelsize='small')


def outlines(grid: Grid, cells: NDArray[np.bool_]) -> Path:
    """Return the outlines of some cells as one path, which has one hatching."""
    corner = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]) - 0.5
    centers = grid.centers(np.flatnonzero(cells)).reshape(-1, 1, 2)
    codes = [Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY]
    vertices = (centers + corner * grid.resolution).reshape(-1, 2)
    return Path(vertices, codes * len(centers)) if len(centers) else Path(np.empty((0, 2)))


def hatch(axes: Axes, grid: Grid, cells: NDArray[np.bool_]) -> None:
    """Hatch some cells, with dark lines within light ones, which show on light and dark maps."""
    if cells.any():
        for colour, width in zip(UNVISITED, (1.4, 0.5)):
            axes.add_patch(
                PathPatch(
                    outlines(grid, cells),
                    facecolor='none',
                    edgecolor=colour,
                    hatch='////',
                    hatch_linewidth=width,
                    linewidth=0.0,
                )
            )


def draw_paths(axes: Axes, grid: Grid, observations: Sequence[Observation], style: Style) -> None:
    """
    Draw where robots went, or were sent.

    Of a lost robot a dot marks how far it is known to have come, if that is known.
    """
    draw_field(axes, grid)
    axes.add_collection(
        LineCollection(
            [grid.centers(each.path) for each in observations],
            colors=style.colour,
            linestyles=[style.dash],
            linewidths=1.0,
            alpha=max(0.08, DARKEST / max(1, len(observations)) ** 0.5),
        )
    )
    heard = [each.path[each.steps_survived] for each in observations if each.steps_survived]
    if heard:
        axes.plot(*grid.centers(heard).T, style.marker, color=style.colour, markersize=3)
