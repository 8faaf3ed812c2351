# SPDX-License-Identifier: Apache-2.0
"""Legibility of figures, by the boxes of texts and the colours of lines."""

from itertools import combinations

from colorspacious import cspace_convert, deltaE
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text

# Severity 100 of the models of Machado et al. (2009): protanopia, deuteranopia and tritanopia.
VISIONS = ('protanomaly', 'deuteranomaly', 'tritanomaly')

# In CAM02-UCS, where 1 is about the least noticeable difference.
LEAST = 10.0

# Maximum number of lines in a panel.
MAX_LINES = 6

# Pixels: boxes that touch do not overlap.
MARGIN = 1.0


def check_texts(figure):
    """Check that no two texts overlap, as rendered."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    hidden = hidden_texts(figure)
    boxes = [
        (text.get_text(), text.get_window_extent(renderer))
        for text in figure.findobj(Text)
        if text.get_visible() and text.get_text().strip() and text not in hidden
    ]
    assert boxes
    for (one, here), (other, there) in combinations(boxes, 2):
        apart = (
            here.x1 - MARGIN <= there.x0
            or there.x1 - MARGIN <= here.x0
            or here.y1 - MARGIN <= there.y0
            or there.y1 - MARGIN <= here.y0
        )
        assert apart, f'{one!r} and {other!r} overlap at {here.x0:.0f}, {here.y0:.0f}'


def hidden_texts(figure):
    """Return texts that are not drawn: of hidden axes, and of ticks outside the limits."""
    hidden = set()
    for axes in figure.axes:
        if not axes.get_visible():
            hidden.update(axes.findobj(Text))
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not low - 1e-9 <= tick.get_loc() <= high + 1e-9 or not tick.get_visible():
                    hidden.update((tick.label1, tick.label2))
    return hidden


def check_lines(figure):
    """Check that a panel has few lines, and that any two differ in colour or style."""
    for axes in figure.axes:
        lines = [line for line in axes.lines if len(line.get_xdata()) > 1]
        # A line without a label is a reference, such as a diagonal.
        named = [line.get_label() for line in lines if not line.get_label().startswith('_')]
        assert len(named) <= MAX_LINES, named
        for one, other in combinations(lines, 2):
            if dash_pattern(one) != dash_pattern(other):
                continue
            for vision in (None, *VISIONS):
                seen = [as_seen(to_rgb(line.get_color()), vision) for line in (one, other)]
                assert deltaE(*seen, input_space='sRGB1') >= LEAST, (
                    f'{one.get_label()} and {other.get_label()} look alike, {vision}'
                )


def dash_pattern(line):
    return line._unscaled_dash_pattern


def as_seen(colour, vision):
    """Return a colour as seen with a colour vision; sRGB values from 0 to 1."""
    if vision is None:
        return colour
    space = {'name': 'sRGB1+CVD', 'cvd_type': vision, 'severity': 100}
    return cspace_convert(colour, space, 'sRGB1').clip(0, 1)
