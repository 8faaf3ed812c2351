# SPDX-License-Identifier: Apache-2.0
"""The plots of a page, in Plotly's format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from html import escape
from math import cos, isnan, pi, sin
from typing import Any

from kbnitp_ros.core import Grid
from kbnitp_ros.figures import extent, LOST, MAPS, RETURNED, SERIES
from kbnitp_ros.report.figures import learnt_quantiles, mission_panels
from kbnitp_ros.report.mission import Mission
from kbnitp_ros.report.tables import Curves
import numpy as np
from numpy.typing import NDArray
from plotly import graph_objects

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


def map_plot(
    grid: Grid,
    values: NDArray[np.float64] | None = None,
    most: float = 1.0,
    least: float = 0.0,
    lane: NDArray[np.intp] | None = None,
    north: float | None = None,
) -> str:
    """Return a map in Plotly's JSON; the page sets its colours."""
    # Directions of the arrows above the map, rad from the right, counterclockwise.
    directions = {'x': -grid.yaw, 'y': pi / 2 - grid.yaw} if grid.yaw else {}
    if north is not None:
        directions['N'] = north - grid.yaw
    place = (
        'along the rows %{x:.4g} m, across %{y:.4g} m'
        if grid.yaw
        else 'x %{x:.4g} m, y %{y:.4g} m'
    )
    along, across = (
        ('along the rows (m)', 'across the rows (m)') if grid.yaw else ('x (m)', 'y (m)')
    )
    grid = as_drawn(grid)
    left, right, bottom, top = extent(grid)
    image = np.full(grid.cells, np.nan) if values is None else np.where(grid.free, values, np.nan)
    cells = heatmap(grid, image)
    cells.update(
        zmin=least,
        zmax=most,
        colorbar={'thickness': 10, 'len': 0.9},
        hovertemplate=f'{place}: %{{z:.3f}}<extra></extra>',
    )
    lined = {'mode': 'lines', 'x': [], 'y': [], 'hoverinfo': 'skip'}
    marked = {'mode': 'markers', 'x': [], 'y': [], 'hoverinfo': 'skip'}
    edge = {'color': 'white', 'width': 1}
    traces = [cells]
    if values is None:
        traces += [
            graph_objects.Scatter(**lined, line={'color': '#767676', 'width': 1, 'dash': 'dot'}),
            graph_objects.Scatter(**lined, line={'color': 'white', 'width': 6}),
            graph_objects.Scatter(**lined, line={'width': 3}),
            graph_objects.Scatter(
                **marked,
                marker={'symbol': 'diamond', 'size': 8, 'color': SERIES[2].colour, 'line': edge},
            ),
            graph_objects.Scatter(
                **marked, marker={'symbol': 'circle-open', 'size': 6, 'color': '#767676'}
            ),
            graph_objects.Scatter(**marked, marker={'size': 11, 'line': edge}),
            graph_objects.Scatter(**lined, line={'color': LOST.colour, 'width': 9}, opacity=0.5),
        ]
    if lane is not None and lane.size:
        at = dict(zip('xy', grid.centers(lane).T.tolist()))
        for colour, width in (('white', 5), ('black', 2)):
            line = {'color': colour, 'width': width}
            traces.append(graph_objects.Scatter(**{**lined, **at}, line=line))
    blocked = heatmap(grid, np.where(grid.free, np.nan, 1.0))
    blocked.update(colorscale=[[0, OBSTACLE], [1, OBSTACLE]], showscale=False, hovertemplate=None)
    blocked.hoverinfo = 'skip'
    base = {
        'symbol': 'square',
        'size': 10,
        'color': 'white',
        'line': {'color': 'black', 'width': 2},
    }
    x, y = grid.centers(sorted(grid.bases)).T.tolist()
    traces += [
        blocked,
        graph_objects.Scatter(x=x, y=y, mode='markers', marker=base, hoverinfo='skip'),
    ]
    figure = graph_objects.Figure(traces)
    axis = {'showgrid': False, 'zeroline': False, 'constrain': 'domain', 'ticks': 'outside'}
    axis |= {'nticks': 6, 'automargin': True}
    figure.update_layout(
        template='none',
        showlegend=False,
        dragmode=False,
        margin={'l': 40, 'r': 10, 't': ABOVE if directions else 8, 'b': 36},
        xaxis={**axis, 'range': [left, right], 'title': {'text': along, 'standoff': 4}},
        yaxis={
            **axis,
            'range': [bottom, top],
            'title': {'text': across, 'standoff': 4},
            'scaleanchor': 'x',
        },
        plot_bgcolor='rgba(0,0,0,0)',
        paper_bgcolor='rgba(0,0,0,0)',
        annotations=[arrow(name, angle) for name, angle in directions.items()],
    )
    return str(figure.to_json())


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


def heatmap(grid: Grid, image: NDArray[np.float64]) -> graph_objects.Heatmap:
    """Return a heatmap of the values of cells, NaN for no value, at the place of the field."""
    left, _, bottom, _ = extent(grid)
    half = grid.resolution / 2
    return graph_objects.Heatmap(
        # Lists of rows: Plotly writes arrays in base64, which few other programs read.
        z=[
            [None if isnan(value) else value for value in row]
            for row in image.reshape(grid.height, grid.width).tolist()
        ],
        x0=left + half,
        dx=grid.resolution,
        y0=bottom + half,
        dy=grid.resolution,
        hoverongaps=False,
    )


def curve_plots(
    mission: Mission, curves: Curves, kept: NDArray[np.intp]
) -> Iterator[tuple[str, str]]:
    """Yield the title of each panel of curves, and the panel in Plotly's JSON."""
    for label, lines in mission_panels(curves).items():
        shown = {name: (kept, values[kept]) for name, values in lines.items()}
        yield label, lines_plot(label, shown)
    for name in mission.moments[-1].state.numbers:
        low, _, middle, _, high = learnt_quantiles(mission, name)[kept].T
        known = {'x': kept, 'mode': 'lines', 'hovertemplate': '%{y:.3f}'}
        thin = {'color': '#888888', 'width': 1}
        figure = graph_objects.Figure()
        figure.add_scatter(y=low, line=thin, name='5 %', showlegend=False, **known)
        figure.add_scatter(
            y=high,
            line=thin,
            name='5 to 95 %',
            fill='tonexty',
            fillcolor='rgba(136,136,136,0.3)',
            **known,
        )
        figure.add_scatter(y=middle, line={'color': SERIES[0].colour}, name='median', **known)
        if name in mission.numbers:
            true = {'color': SERIES[1].colour, 'dash': SERIES[1].plotly_dash}
            level = np.full(kept.size, mission.numbers[name])
            figure.add_scatter(y=level, line=true, name='truth', **known)
        label = name.replace('_', ' ')
        figure.update_yaxes(range=[0, 1])
        yield label, finished(figure, escape(label))


def lines_plot(
    label: str,
    lines: Mapping[str, tuple[NDArray[np.intp], NDArray[np.float64]]],
) -> str:
    """Return a panel of lines, each with moments and values, in Plotly's JSON."""
    figure = graph_objects.Figure()
    for (name, (moments, values)), style in zip(lines.items(), SERIES):
        figure.add_scatter(
            x=moments,
            y=values,
            name=name,
            mode='lines',
            line={'color': style.colour, 'dash': style.plotly_dash},
            hovertemplate='%{y:.4g}',
        )
    return finished(figure, escape(label))


def finished(figure: graph_objects.Figure, label: str, height: int = PANEL) -> str:
    """Return a panel of curves in Plotly's JSON."""
    figure.update_xaxes(title_text='reports taken in', automargin=True)
    figure.update_yaxes(title_text=label, automargin=True, title_standoff=6)
    figure.update_layout(
        template='none',
        height=height,
        hovermode='x unified',
        dragmode=False,
        showlegend=True,
        legend={'orientation': 'h', 'x': 0, 'y': 1, 'yanchor': 'bottom'},
        margin={'l': 50, 'r': 10, 't': 40, 'b': 40},
        paper_bgcolor='rgba(0,0,0,0)',
        plot_bgcolor='rgba(0,0,0,0)',
    )
    return str(figure.to_json())


def cell_plot() -> str:
    """Return the plot of the belief in a cell over time, without its values, in Plotly's JSON."""
    figure = graph_objects.Figure()
    for name, style in zip(MAPS, SERIES):
        line = {'color': style.colour, 'dash': style.plotly_dash}
        figure.add_scatter(
            x=[], y=[], name=name, mode='lines', line=line, hovertemplate='%{y:.3f}'
        )
    figure.update_yaxes(range=[0, 1.02])
    return finished(figure, '', 220)
