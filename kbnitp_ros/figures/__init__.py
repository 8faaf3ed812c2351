# SPDX-License-Identifier: Apache-2.0
"""How figures look: the field from above, colours, line styles and markers, sizes, files."""

from kbnitp_ros.plugins import extra

with extra('report'):
    from kbnitp_ros.figures.field import draw_map, draw_paths, extent, hatch, plot
    from kbnitp_ros.figures.files import FORMATS, LETTERS, save, WIDTH
    from kbnitp_ros.figures.palette import LOST, MAPS, RETURNED, SERIES, Style, UNVISITED

__all__ = [
    'FORMATS',
    'LETTERS',
    'LOST',
    'MAPS',
    'RETURNED',
    'SERIES',
    'UNVISITED',
    'WIDTH',
    'Style',
    'draw_map',
    'draw_paths',
    'extent',
    'hatch',
    'plot',
    'save',
]
