# SPDX-License-Identifier: Apache-2.0
"""The plots of a page, in Plotly's format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from html import escape
import json
from math import cos, isnan, pi, sin
from typing import Any

from kbnitp_ros.core import Grid
from kbnitp_ros.report.mission import Mission
from kbnitp_ros.report.tables import Curves
from kbnitp_ros.styles import extent, LOST, MAPS, RETURNED, SERIES, Style
import numpy as np
from numpy.typing import NDArray

# Names of the traces that the page updates, in their order on the map.
TRACES = ('cells', 'out', 'casing', 'walk', 'detected', 'nothing', 'end', 'likely')

# Styles of a path and of its end, by outcome; the page fills the traces.
WALKS = {
    'returned': {'color': RETURNED.colour, 'dash': RETURNED.plotly_dash, 'symbol': 'circle'},
    'lost': {'color': LOST.colour, 'dash': LOST.plotly_dash, 'symbol': 'x'},
}

# Colour of cells that no robot can enter, on light paper as well as on a dark screen.
OBSTACLE = '#808080'

# Pixels: length of the arrows above a map, and space for them.
ARROW, ABOVE = 20, 64

# Height of a panel of curves, in pixels.
PANEL = 280


# Curves of a panel by name, one value for each moment.
Lines = dict[str, NDArray[np.float64]]


def mission_panels(curves: Curves) -> dict[str, Lines]:
    """Return the curves of each panel of a mission, by the panel's title with the unit."""
    log_loss = {'hazard map': curves.hazard_loss, 'target map': curves.target_loss}
    return {
        'entropy (nats)': {
            'H(Z) + H(X), all': curves.entropy,
            'H(Z), hazards': curves.hazard_entropy,
            'H(X), targets': curves.target_entropy,
            'H(Z, X), joint': curves.joint_entropy,
        },
        **({} if np.isnan(curves.hazard_loss).all() else {'log loss (nats)': log_loss}),
        'information so far (nats)': {
            'expected': np.nancumsum(curves.expected),
            'gained': np.nancumsum(curves.gained),
        },
        'robots': {'lost': curves.lost.astype(np.float64), 'out': curves.out.astype(np.float64)},
    }


def learnt_quantiles(mission: Mission, name: str) -> NDArray[np.float64]:
    """Return the quantiles of a learnt number, shape (moments, 5); NaN if unknown."""
    return np.array(
        [
            each.state.numbers[name].quantiles if name in each.state.numbers else [np.nan] * 5
            for each in mission.moments
        ]
    )


def map_plot(grid: Grid, north: float | None = None) -> str:
    """Return a map in Plotly's JSON; the page sets its values and colours."""
    # Directions of the arrows above the map, rad from the right, counterclockwise.
    directions = {'x': -grid.yaw, 'y': pi / 2 - grid.yaw} if grid.yaw else {}
    if north is not None:
        directions['N'] = north - grid.yaw
    titles = ('along the rows (m)', 'across the rows (m)') if grid.yaw else ('x (m)', 'y (m)')
    grid = as_drawn(grid)
    left, right, bottom, top = extent(grid)
    edge = {'color': 'white', 'width': 1}
    base = {'symbol': 'square', 'size': 10, 'color': 'white'}
    detected = {'symbol': 'diamond', 'size': 8, 'color': SERIES[2].colour, 'line': edge}
    obstacle = {'colorscale': [[0, OBSTACLE], [1, OBSTACLE]], 'showscale': False}
    traces = [
        heatmap(grid, np.full(grid.cells, np.nan)) | {'zmin': 0.0},
        scatter('lines', line={'color': '#767676', 'width': 1, 'dash': 'dot'}),
        scatter('lines', line={'color': 'white', 'width': 6}),
        scatter('lines', line={'width': 3}),
        scatter('markers', marker=detected),
        scatter('markers', marker={'symbol': 'circle-open', 'size': 6, 'color': '#767676'}),
        scatter('markers', marker={'size': 11, 'line': edge}),
        scatter('lines', line={'color': LOST.colour, 'width': 9}, opacity=0.5),
        heatmap(grid, np.where(grid.free, np.nan, 1.0)) | obstacle | {'hoverinfo': 'skip'},
        scatter(
            'markers',
            *grid.centers(sorted(grid.bases)).T.tolist(),
            marker=base | {'line': {'color': 'black', 'width': 2}},
        ),
    ]
    axis = {'showgrid': False, 'zeroline': False, 'constrain': 'domain', 'ticks': 'outside'}
    axis |= {'nticks': 6, 'automargin': True}
    x, y = (
        axis | {'range': limits, 'title': {'text': title, 'standoff': 4}}
        for limits, title in zip(([left, right], [bottom, top]), titles)
    )
    return figure(
        traces,
        showlegend=False,
        margin={'l': 40, 'r': 10, 't': ABOVE if directions else 8, 'b': 36},
        xaxis=x,
        yaxis=y | {'scaleanchor': 'x'},
        annotations=[arrow(name, angle) for name, angle in directions.items()],
    )


def figure(data: list[dict[str, Any]], **layout: Any) -> str:
    """Return a figure in Plotly's JSON."""
    clear = {f'{part}_bgcolor': 'rgba(0,0,0,0)' for part in ('paper', 'plot')}
    return json.dumps({'data': data, 'layout': {'dragmode': False, **clear, **layout}})


def scatter(mode: str, x: Any = (), y: Any = (), **style: Any) -> dict[str, Any]:
    """Return lines or markers."""
    return {'type': 'scatter', 'mode': mode, 'x': x, 'y': y, 'hoverinfo': 'skip', **style}


def as_drawn(grid: Grid) -> Grid:
    """Return a grid as a page draws it: without its rotation."""
    return replace(grid, origin=(0.0, 0.0), yaw=0.0) if grid.yaw else grid


def arrow(name: str, angle: float) -> dict[str, Any]:
    """Return an arrow above the left edge of a map, with a label at its head."""
    at = {
        'xref': 'paper',
        'yref': 'paper',
        'x': 0,
        'y': 1,
        'xshift': ABOVE / 2,
        'yshift': ABOVE / 2,
    }
    head = {'ax': ARROW * cos(angle), 'ay': -ARROW * sin(angle), 'arrowside': 'start'}
    return {**at, **head, 'text': name, 'arrowcolor': OBSTACLE, 'arrowhead': 2}


def heatmap(grid: Grid, image: NDArray[np.float64]) -> dict[str, Any]:
    """Return a heatmap of the values of cells, NaN for no value, at the place of the field."""
    left, _, bottom, _ = extent(grid)
    half = grid.resolution / 2
    return {
        'type': 'heatmap',
        'z': [known(row) for row in image.reshape(grid.height, grid.width)],
        'x0': left + half,
        'dx': grid.resolution,
        'y0': bottom + half,
        'dy': grid.resolution,
        'hoverongaps': False,
    }


def known(values: NDArray[np.float64]) -> list[float | None]:
    """Return numbers for JSON, None for NaN."""
    return [None if isnan(value) else value for value in values.tolist()]


def curve_plots(
    mission: Mission, curves: Curves, kept: NDArray[np.intp]
) -> Iterator[tuple[str, str]]:
    """Yield the title of each panel of curves, and the panel in Plotly's JSON."""
    for label, lines in mission_panels(curves).items():
        shown = [
            line(kept, name, values[kept], line_style(style))
            for (name, values), style in zip(lines.items(), SERIES)
        ]
        yield label, finished(shown, label)
    for name in mission.moments[-1].state.numbers:
        low, _, middle, _, high = learnt_quantiles(mission, name)[kept].T
        thin = {'color': '#888888', 'width': 1}
        curve = partial(line, kept)
        level = np.full(kept.size, mission.numbers.get(name, np.nan))
        lines_of = [
            curve('5 %', low, thin) | {'showlegend': False},
            curve('5 to 95 %', high, thin)
            | {'fill': 'tonexty', 'fillcolor': 'rgba(136,136,136,0.3)'},
            curve('median', middle, {'color': SERIES[0].colour}),
            *([curve('truth', level, line_style(SERIES[1]))] if name in mission.numbers else []),
        ]
        label = name.replace('_', ' ')
        yield label, finished(lines_of, label, most=1.0)


def line(
    moments: NDArray[np.intp], name: str, values: NDArray[np.float64], style: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a curve over moments."""
    how = {'name': name, 'line': style, 'hovertemplate': '%{y:.4g}', 'hoverinfo': 'all'}
    return scatter('lines', moments.tolist(), known(values), **how)


def line_style(style: Style) -> dict[str, str]:
    """Return a line's style in Plotly's format."""
    return {'color': style.colour, 'dash': style.plotly_dash}


def finished(
    data: list[dict[str, Any]], label: str, height: int = PANEL, most: float | None = None
) -> str:
    """Return a panel of curves in Plotly's JSON."""
    y = {'title': {'text': escape(label), 'standoff': 6}, 'automargin': True}
    return figure(
        data,
        xaxis={'title': {'text': 'reports taken in'}, 'automargin': True},
        yaxis=y if most is None else y | {'range': [0, most]},
        height=height,
        hovermode='x unified',
        showlegend=True,
        legend={'orientation': 'h', 'x': 0, 'y': 1, 'yanchor': 'bottom'},
        margin={'l': 50, 'r': 10, 't': 40, 'b': 40},
    )


def cell_plot() -> str:
    """Return the plot of the belief in a cell over time, without its values, in Plotly's JSON."""
    empty = np.empty(0)
    data = [
        line(empty.astype(np.intp), name, empty, line_style(style))
        for name, style in zip(MAPS, SERIES)
    ]
    return finished(data, '', 220, 1.02)
