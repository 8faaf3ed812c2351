# SPDX-License-Identifier: Apache-2.0
"""Colours and line styles of maps and curves, on pages and in figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kbnitp_ros.core import Grid

# Number of markers on a line; their shapes tell lines apart in black and white.
MARKERS = 8


@dataclass(frozen=True)
class Style:
    """Style of a line."""

    # As '#rrggbb'.
    colour: str
    # Matplotlib's line style.
    dash: str | tuple[int, tuple[float, ...]]
    # Plotly's line style.
    plotly_dash: str
    # Matplotlib's marker.
    marker: str

    def line(self, points: int) -> dict[str, Any]:
        """Return Matplotlib's keywords for a line with this number of points."""
        return {
            'color': self.colour,
            'linestyle': self.dash,
            'linewidth': 1.2,
            'marker': self.marker,
            'markersize': 3,
            'markevery': max(1, points // MARKERS),
        }


# Styles of the lines in a panel, in order.
SERIES = (
    Style('#0072b2', '-', 'solid', 'o'),
    Style('#d55e00', (0, (5.0, 1.5)), 'dash', 's'),
    Style('#009e73', (0, (5.0, 1.5, 1.0, 1.5)), 'dashdot', '^'),
    Style('#cc79a7', (0, (1.2, 1.2)), 'dot', 'D'),
    Style('#56b4e9', (0, (9.0, 2.0)), 'longdash', 'v'),
    Style('#e69f00', (0, (9.0, 2.0, 1.0, 2.0)), 'longdashdot', 'P'),
)

RETURNED, LOST = SERIES[0], SERIES[1]


# Colours of five probabilities, as '#rrggbb': 0, half way to the prior, the prior, half way to 1,
# and 1.
Scale = tuple[str, str, str, str, str]


def stops(scale: Scale, prior: float) -> list[tuple[float, str]]:
    """Return the position of each colour, from 0 to 1, with the third colour at the prior."""
    middle = min(max(prior, MIN_HALF), 1.0 - MIN_HALF)
    return list(zip((0.0, middle / 2, middle, (1.0 + middle) / 2, 1.0), scale))


# Minimum width of each half of a colour scale, as a probability.
MIN_HALF = 0.1

# Colours of the maps, on light paper and on a dark screen: the prior is a neutral grey.
MAPS: dict[str, Scale] = {
    'hazard': ('#74add1', '#b5d7ea', '#f7f7f7', '#f09c7b', '#99000d'),
    'target': ('#d3b878', '#e8dbb8', '#f7f7f7', '#7fbf7b', '#00441b'),
    'kappa': ('#f0a94e', '#fad6a5', '#f7f7f7', '#a48cc4', '#40004b'),
}
DARK_MAPS: dict[str, Scale] = {
    'hazard': ('#3a7fb5', '#315878', '#2e3238', '#a3523a', '#ffab8c'),
    'target': ('#80602c', '#58492f', '#2e3238', '#3f7f4a', '#a5f3b0'),
    'kappa': ('#a8702a', '#6b5230', '#2e3238', '#77609b', '#e3c8ff'),
}

# Colours of the number of robots lost in a cell, from none to the most.
COUNTS = {'light': ('#f7f7f7', '#e69f00', '#7a2e00'), 'dark': ('#2e3238', '#b06f00', '#ffd27a')}


def extent(grid: Grid) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of a grid in metres, before its rotation."""
    left, bottom = grid.origin
    right, top = left + grid.width * grid.resolution, bottom + grid.height * grid.resolution
    return left, right, bottom, top
