# SPDX-License-Identifier: Apache-2.0
"""
Colours that every kind of colour vision tells apart, each with a line style and a marker.

The colours of lines are those of Okabe and Ito (Color Universal Design, 2008). Maps go from light
to dark, so that their order shows without any hue.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

# How many markers a line has, which tell it from others without colour.
MARKERS = 8


@dataclass(frozen=True)
class Style:
    """
    How a line is drawn.

    Attributes
    ----------
    colour : str
        As '#rrggbb'.
    dash : str or tuple
        Matplotlib's line style.
    plotly_dash : str
        Plotly's.
    marker : str
        Matplotlib's marker.

    """

    colour: str
    dash: str | tuple[int, tuple[float, ...]]
    plotly_dash: str
    marker: str

    def line(self, points: int) -> dict[str, Any]:
        """Return what Matplotlib is told to draw a line of so many points, by its keywords."""
        return {
            'color': self.colour,
            'linestyle': self.dash,
            'linewidth': 1.2,
            'marker': self.marker,
            'markersize': 3,
            'markevery': max(1, points // MARKERS),
        }


# At most as many lines are in a panel.
SERIES = (
    Style('#0072b2', '-', 'solid', 'o'),
    Style('#d55e00', (0, (5.0, 1.5)), 'dash', 's'),
    Style('#009e73', (0, (5.0, 1.5, 1.0, 1.5)), 'dashdot', '^'),
    Style('#cc79a7', (0, (1.2, 1.2)), 'dot', 'D'),
    Style('#56b4e9', (0, (9.0, 2.0)), 'longdash', 'v'),
    Style('#e69f00', (0, (9.0, 2.0, 1.0, 2.0)), 'longdashdot', 'P'),
)

RETURNED, LOST = SERIES[0], SERIES[1]

# Names that both Matplotlib and Plotly know.
MAPS = {'hazard': 'Reds', 'target': 'Greens', 'kappa': 'Purples'}

# Of the hatching of cells that nobody visited: what is below, and the lines themselves.
UNVISITED = ('#ffffff80', '#505050')
