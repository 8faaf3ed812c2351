# SPDX-License-Identifier: Apache-2.0
"""Figures are legible for every colour vision, without overlapping texts."""

from itertools import combinations

from colorspacious import deltaE
from kbnitp_ros.core import Belief, Grid
from kbnitp_ros.figures import draw_map, plot, save
from kbnitp_ros.styles import COUNTS, DARK_MAPS, MAPS, SERIES, stops
from laws import for_each
from legible import as_seen, VISIONS
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
import numpy as np
from PIL import Image
import pytest


def test_a_turned_field_is_drawn_where_it_lies():
    """The centre of each cell, wherever it is, has the colour of its value."""
    grid = Grid(6, 4, 8, 0.5, (20.0, -7.0), blocked=[15], yaw=0.6)
    values = np.random.default_rng(3).random(grid.cells)
    figure = Figure(dpi=200)
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots()
    draw_map(axes, grid, values, MAPS['hazard'], 'hazard')
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())
    column, row = axes.transData.transform(grid.centers(np.arange(grid.cells))).astype(int).T
    seen = picture[picture.shape[0] - 1 - row, column] / 255
    told = axes.images[0].cmap(values)
    shown = np.delete(np.arange(grid.cells), [grid.base, 15])
    assert seen[shown] == pytest.approx(told[shown], abs=0.01)
    assert seen[15, :3] == pytest.approx(0.6, abs=0.01)


def test_paths_from_all_bases_are_drawn_and_these():
    grid = Grid(6, 5, base=0, other_bases=(29,))
    axes = Figure().subplots(1, 3)
    plot(grid, Belief.prior(grid, 0.2, 0.3, 0.8), paths=([0, 1, 0], [29, 28, 29]), axes=axes)
    for panel in axes:
        (bases,) = (line for line in panel.lines if line.get_marker() == 's')
        assert bases.get_xydata().tolist() == [[0.5, 0.5], [5.5, 4.5]]


def test_figures_are_at_300_dots_per_inch_with_letters_embedded(tmp_path):
    figure = Figure(figsize=(2, 1))
    figure.subplots().set_title('a title')
    png, svg, pdf = save(figure, tmp_path / 'figure.png', 'png', 'svg', 'pdf')
    assert Image.open(png).size == (600, 300)
    assert '<text' not in svg.read_text()
    assert b'/FontFile2' in pdf.read_bytes()


def test_figures_are_drawn_without_latex_whatever_the_users_settings(tmp_path):
    grid = Grid(4, 3)
    with rc_context({'text.usetex': True}):
        figure = Figure()
        plot(grid, Belief.prior(grid, 0.2, 0.3, 0.8), axes=figure.subplots(1, 3))
        for file in save(figure, tmp_path / 'maps.png', 'png', 'svg'):
            assert file.stat().st_size > 1000


def test_no_two_styles_look_the_same():
    for one, other in combinations(SERIES, 2):
        assert one.dash != other.dash
        assert one.plotly_dash != other.plotly_dash
        assert one.marker != other.marker


# In CAM02-UCS: distinguishable at a glance, not only side by side.
APART = 15.0


@for_each('maps', [MAPS, DARK_MAPS])
def test_low_unknown_and_high_differ_for_every_colour_vision(maps):
    for scale in maps.values():
        low, _, unknown, _, high = map(to_rgb, scale)
        for vision in (None, *VISIONS):
            for one, other in combinations((low, unknown, high), 2):
                seen = [as_seen(colour, vision) for colour in (one, other)]
                assert deltaE(*seen, input_space='sRGB1') > APART, (scale, vision)


def test_the_prior_has_the_colour_of_the_paper():
    for maps, paper in ((MAPS, '#f7f7f7'), (DARK_MAPS, '#2e3238')):
        for scale in maps.values():
            for prior in (0.15, 0.5, 0.8):
                assert dict(stops(scale, prior))[prior] == paper
            places = [place for place, _ in stops(scale, 0.0)]
            assert places == sorted(set(places))
    assert [colours[0] for colours in COUNTS.values()] == ['#f7f7f7', '#2e3238']
