# SPDX-License-Identifier: Apache-2.0
"""The plots of a page, as Plotly draws them."""

from __future__ import annotations

from html import escape
from math import isnan

from kbnitp_ros.core import Grid
from kbnitp_ros.figures import extent, LOST, MAPS, RETURNED, SERIES
from kbnitp_ros.report.curves import Curves
from kbnitp_ros.report.mission import Mission
from kbnitp_ros.report.progress_figure import panels_of, quantiles_of
import numpy as np
from numpy.typing import NDArray
from plotly import graph_objects
from plotly.subplots import make_subplots

# Where the page puts what changes: the places of these traces in each believed map.
TRACES = ('cells', 'out', 'casing', 'walk', 'detected', 'nothing', 'end', 'heard', 'base')

# A trace stands for the path, and a marker for its end, of either fate; the page takes these.
WALKS = {
    'returned': {'color': RETURNED.colour, 'dash': RETURNED.plotly_dash, 'symbol': 'circle'},
    'lost': {'color': LOST.colour, 'dash': LOST.plotly_dash, 'symbol': 'x'},
}


def map_plot(grid: Grid, name: str, values: NDArray[np.float64] | None = None) -> str:
    """
    Return a map as Plotly's JSON.

    Parameters
    ----------
    grid : Grid
        The field.
    name : str
        hazard, target or kappa.
    values : ndarray, shape (cells,), optional
        What is drawn, NaN for nothing; without them there is room for what the page puts in.

    """
    left, right, bottom, top = extent(grid)
    half = grid.resolution / 2
    image = np.full(grid.cells, np.nan) if values is None else np.where(grid.free, values, np.nan)
    image = image.reshape(grid.height, grid.width)
    cells = graph_objects.Heatmap(
        # As rows, which whoever reads the page back can read as well.
        z=[[None if isnan(value) else value for value in row] for row in image.tolist()],
        x0=left + half,
        dx=grid.resolution,
        y0=bottom + half,
        dy=grid.resolution,
        zmin=0,
        zmax=1,
        colorscale=MAPS[name],
        hoverongaps=False,
        colorbar={'thickness': 10, 'len': 0.9, 'tickvals': [0, 0.5, 1]},
        hovertemplate='x %{x:.4g} m, y %{y:.4g} m: %{z:.3f}<extra></extra>',
    )
    lined = {'mode': 'lines', 'x': [], 'y': [], 'hoverinfo': 'skip'}
    marked = {'mode': 'markers', 'x': [], 'y': [], 'hoverinfo': 'skip'}
    edge = {'color': 'white', 'width': 1}
    ((x, y),) = grid.centers([grid.base])
    traces = [cells]
    if values is None:
        traces += [
            graph_objects.Scatter(**lined, line={'color': '#555555', 'width': 1, 'dash': 'dot'}),
            graph_objects.Scatter(**lined, line={'color': 'white', 'width': 6}),
            graph_objects.Scatter(**lined, line={'width': 3}),
            graph_objects.Scatter(
                **marked,
                marker={'symbol': 'diamond', 'size': 8, 'color': SERIES[2].colour, 'line': edge},
            ),
            graph_objects.Scatter(
                **marked, marker={'symbol': 'circle-open', 'size': 6, 'color': '#333333'}
            ),
            graph_objects.Scatter(**marked, marker={'size': 11, 'line': edge}),
            graph_objects.Scatter(**lined, line={'color': LOST.colour, 'width': 9}, opacity=0.5),
        ]
    base = {
        'symbol': 'square',
        'size': 10,
        'color': 'white',
        'line': {'color': 'black', 'width': 2},
    }
    traces.append(
        graph_objects.Scatter(x=[x], y=[y], mode='markers', marker=base, hoverinfo='skip')
    )
    figure = graph_objects.Figure(traces)
    axis = {'showgrid': False, 'zeroline': False, 'constrain': 'domain', 'ticks': 'outside'}
    axis |= {'nticks': 6, 'automargin': True}
    figure.update_layout(
        template='none',
        showlegend=False,
        dragmode=False,
        margin={'l': 40, 'r': 10, 't': 8, 'b': 36},
        xaxis={**axis, 'range': [left, right], 'title': {'text': 'x (m)', 'standoff': 4}},
        yaxis={
            **axis,
            'range': [bottom, top],
            'title': {'text': 'y (m)', 'standoff': 4},
            'scaleanchor': 'x',
        },
        plot_bgcolor='#999999' if values is None or np.isfinite(values).all() else '#ffffff',
        paper_bgcolor='rgba(0,0,0,0)',
    )
    return str(figure.to_json())


def curve_plot(mission: Mission, curves: Curves, kept: NDArray[np.intp]) -> str:
    """Return all curves below each other as Plotly's JSON."""
    panels = panels_of(curves)
    names = list(mission.moments[-1].learnt)
    rows = len(panels) + len(names)
    figure = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=0.3 / rows)
    for row, panel in enumerate(panels, start=1):
        for (name, values), style in zip(panel.lines.items(), SERIES):
            figure.add_scatter(
                row=row,
                col=1,
                x=kept,
                y=values[kept],
                name=name,
                mode='lines',
                line={'color': style.colour, 'dash': style.plotly_dash},
                hovertemplate='%{y:.4g}',
                legend=f'legend{row}' if row > 1 else 'legend',
            )
        figure.update_yaxes(title_text=panel.label.replace(' (', '<br>('), row=row, col=1)
    for row, name in enumerate(names, start=len(panels) + 1):
        low, _, middle, _, high = quantiles_of(mission, name)[kept].T
        known = {'row': row, 'col': 1, 'x': kept, 'mode': 'lines', 'hovertemplate': '%{y:.3f}'}
        thin, legend = {'color': '#888888', 'width': 1}, f'legend{row}'
        figure.add_scatter(y=low, line=thin, name='5 %', showlegend=False, **known)
        figure.add_scatter(
            y=high,
            line=thin,
            name='5 to 95 %',
            fill='tonexty',
            legend=legend,
            fillcolor='rgba(136,136,136,0.3)',
            **known,
        )
        median = {'color': SERIES[0].colour}
        figure.add_scatter(y=middle, line=median, name='median', legend=legend, **known)
        title = escape(name).replace('_', '<br>')
        figure.update_yaxes(title_text=title, range=[0, 1], row=row, col=1)
    places = {
        f'legend{row}' if row > 1 else 'legend': {
            'orientation': 'h',
            'x': 0,
            'y': figure.layout[f'yaxis{row}' if row > 1 else 'yaxis'].domain[1],
            'yanchor': 'bottom',
            'bgcolor': 'rgba(0,0,0,0)',
        }
        for row in range(1, rows + 1)
    }
    figure.update_xaxes(title_text='reports taken in', row=rows, col=1)
    figure.update_yaxes(automargin=True, title_standoff=6)
    figure.update_layout(
        **places,
        template='none',
        height=190 * rows + 60,
        hovermode='x unified',
        dragmode=False,
        margin={'l': 60, 'r': 10, 't': 30, 'b': 40},
        paper_bgcolor='rgba(0,0,0,0)',
        plot_bgcolor='rgba(0,0,0,0)',
    )
    return str(figure.to_json())


def cell_plot() -> str:
    """Return the plot of how the belief in a cell went, without its values, as Plotly's JSON."""
    figure = graph_objects.Figure(
        [
            graph_objects.Scatter(
                x=[],
                y=[],
                name=name,
                mode='lines',
                line={'color': style.colour, 'dash': style.plotly_dash},
                hovertemplate='%{y:.3f}',
            )
            for name, style in zip(MAPS, SERIES)
        ]
    )
    figure.update_layout(
        template='none',
        height=220,
        hovermode='x unified',
        dragmode=False,
        legend={'orientation': 'h', 'x': 0, 'y': 1, 'yanchor': 'bottom'},
        margin={'l': 40, 'r': 10, 't': 30, 'b': 40},
        xaxis={'title': {'text': 'reports taken in'}},
        yaxis={'range': [0, 1.02]},
        paper_bgcolor='rgba(0,0,0,0)',
        plot_bgcolor='rgba(0,0,0,0)',
    )
    return str(figure.to_json())
