# SPDX-License-Identifier: Apache-2.0
"""How figures look in print: colours that all tell apart, and files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

# How many markers a line has, which tell it from others without colour.
MARKERS = 8


@dataclass(frozen=True)
class Style:
    """How a line is drawn."""

    # As '#rrggbb'.
    colour: str
    # Matplotlib's line style.
    dash: str | tuple[int, tuple[float, ...]]
    # Plotly's.
    plotly_dash: str
    # Matplotlib's marker.
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


@dataclass(frozen=True)
class Scale:
    """The colours of a probability, which part at what was assumed before the mission."""

    # At 0, half way to the assumption, at it, half way from it to 1, and at 1, as '#rrggbb'.
    colours: tuple[str, str, str, str, str]

    def stops(self, prior: float) -> list[tuple[float, str]]:
        """Return where from 0 to 1 each colour stands, if `prior` was assumed."""
        middle = min(max(prior, NARROWEST), 1.0 - NARROWEST)
        places = (0.0, middle / 2, middle, (1.0 + middle) / 2, 1.0)
        return list(zip(places, self.colours))


# How much room each half of a scale has at least.
NARROWEST = 0.1

# Of the maps, on light paper and on a dark screen: what is unknown has the colour of neither.
MAPS = {
    'hazard': Scale(('#74add1', '#b5d7ea', '#f7f7f7', '#f09c7b', '#99000d')),
    'target': Scale(('#d3b878', '#e8dbb8', '#f7f7f7', '#7fbf7b', '#00441b')),
    'kappa': Scale(('#f0a94e', '#fad6a5', '#f7f7f7', '#a48cc4', '#40004b')),
}
DARK_MAPS = {
    'hazard': Scale(('#3a7fb5', '#315878', '#2e3238', '#a3523a', '#ffab8c')),
    'target': Scale(('#80602c', '#58492f', '#2e3238', '#3f7f4a', '#a5f3b0')),
    'kappa': Scale(('#a8702a', '#6b5230', '#2e3238', '#77609b', '#e3c8ff')),
}

# How many robots were lost in a cell: from none to the most.
COUNTS = {'light': ('#f7f7f7', '#e69f00', '#7a2e00'), 'dark': ('#2e3238', '#b06f00', '#ffd27a')}

# Of the hatching of cells that nobody visited: what is below, and the lines themselves.
UNVISITED = ('#ffffff80', '#505050')


DPI = 300
FORMATS = ('png', 'svg', 'pdf')

# Letters are embedded as outlines in SVG and as TrueType in PDF, where they stay text.
EMBEDDED = {'svg.fonttype': 'path', 'svg.hashsalt': 'kbnitp_ros', 'pdf.fonttype': 42}

# In inches: two columns of a journal.
WIDTH = 7.2

# No layout but that which a figure asks for.
AS_ASKED = {'figure.autolayout': False, 'figure.constrained_layout.use': False}

# Letters as they are in print at that width.
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

# Nothing that differs from one run to the next.
METADATA = {'png': {}, 'svg': {'Date': None}, 'pdf': {'CreationDate': None}}


def save(figure: Figure, path: Path, *formats: str) -> list[Path]:
    """Write a figure once for each format."""
    files = [path.with_suffix(f'.{each}') for each in formats]
    with rc_context({**EMBEDDED, **AS_ASKED}):
        for file, each in zip(files, formats):
            figure.savefig(file, dpi=DPI, metadata=METADATA[each])
            # It is laid out once, and so the same in each format, and drawn once for each.
            figure.set_layout_engine(None)
    return files
