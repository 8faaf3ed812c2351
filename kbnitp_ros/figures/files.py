# SPDX-License-Identifier: Apache-2.0
"""Write figures at publication quality."""

from __future__ import annotations

from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

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
