# SPDX-License-Identifier: Apache-2.0
"""How figures look: the field from above, colours, line styles and markers, sizes, files."""

from kbnitp_ros.plugins import extra

with extra('report'):
    from kbnitp_ros.figures.field import draw_map, draw_paths, extent, hatch, plot
    from kbnitp_ros.figures.files import FORMATS, LETTERS, save, WIDTH
    from kbnitp_ros.figures.forecast import forecast_figure
    from kbnitp_ros.figures.palette import (
        COUNTS,
        DARK_MAPS,
        LOST,
        MAPS,
        RETURNED,
        Scale,
        SERIES,
        Style,
        UNVISITED,
    )

__all__ = [
    'COUNTS',
    'DARK_MAPS',
    'FORMATS',
    'LETTERS',
    'LOST',
    'MAPS',
    'RETURNED',
    'SERIES',
    'UNVISITED',
    'WIDTH',
    'Scale',
    'Style',
    'draw_map',
    'draw_paths',
    'extent',
    'forecast_figure',
    'hatch',
    'plot',
    'save',
]
