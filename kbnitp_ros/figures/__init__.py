# SPDX-License-Identifier: Apache-2.0
"""How figures look: the field from above, colours, line styles and markers, sizes, files."""

from kbnitp_ros.plugins import extra

with extra('report'):
    from kbnitp_ros.figures.field import draw_map, draw_paths, extent, forecast_figure, hatch, plot
    from kbnitp_ros.figures.files import (
        COUNTS,
        DARK_MAPS,
        FORMATS,
        LETTERS,
        LOST,
        MAPS,
        RETURNED,
        save,
        Scale,
        SERIES,
        Style,
        UNVISITED,
        WIDTH,
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
