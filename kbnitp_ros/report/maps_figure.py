# SPDX-License-Identifier: Apache-2.0
"""The picture of what a mission came to believe, beside the truth, and of where robots went."""

from __future__ import annotations

from kbnitp_ros.figures import draw_map, draw_paths, hatch, LOST, MAPS, RETURNED
from kbnitp_ros.files import counted
from kbnitp_ros.report.mission import Mission
from matplotlib.figure import Figure
import numpy as np


def maps_figure(mission: Mission, note: str = '') -> Figure:
    """Return the picture of the last belief."""
    grid, belief, world = mission.grid, mission.moments[-1].belief, mission.world
    visited = mission.visited()
    rows = ('abcd', 'efgh') if world else ('abc', 'dh.')
    figure = Figure(figsize=(10.5, 5.4) if world else (8.0, 5.4), layout='constrained')
    axes = figure.subplot_mosaic([list(row) for row in rows], empty_sentinel='.')
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
    figure.suptitle(note or caption(mission), fontsize='medium')
    return figure


def caption(mission: Mission) -> str:
    """Return what the hatching means, if there is any."""
    unvisited = int((~mission.visited() & mission.grid.free).sum())
    cells = counted(unvisited, 'cell')
    return f'hatched: {cells} that no robot was sent into' if unvisited else ''
