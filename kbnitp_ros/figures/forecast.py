# SPDX-License-Identifier: Apache-2.0
"""How missions may go, robot by robot."""

from __future__ import annotations

from collections.abc import Sequence

from kbnitp_ros.core import Forecast
from kbnitp_ros.figures.files import LETTERS, WIDTH
from kbnitp_ros.figures.palette import SERIES
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

# Between which quantiles bands are drawn, and how much of their colour they keep.
BANDS = ((0.05, 0.95, 0.15), (0.25, 0.75, 0.3))


def forecast_figure(forecast: Forecast) -> Figure:
    """Draw the robots lost, what is known, and how many missions reached their goal."""
    panels = [
        ('robots lost', forecast.lost),
        ('entropy (nats)', forecast.entropy)
        if forecast.goal == 'map'
        else (f'probability that the {forecast.goal} is free', forecast.p_free),
    ]
    panels_and_goal = len(panels) + (forecast.confidence is not None)
    with rc_context(LETTERS):
        figure = Figure(figsize=(WIDTH, 2.6), layout='constrained')
        all_axes: Sequence[Axes] = figure.subplots(1, panels_and_goal)
        for axes, (label, series) in zip(all_axes, panels):
            draw_series(axes, series)
            axes.set_ylabel(label)
        if forecast.confidence is not None:
            axes = all_axes[-1]
            share = forecast.reached.mean(axis=0)
            axes.plot(share, color=SERIES[0].colour, drawstyle='steps-post')
            axes.set_ylim(0.0, 1.0)
            axes.set_ylabel(f'share of missions at {forecast.confidence:.4g}')
        for axes in all_axes:
            axes.set_xlabel('robots sent')
            axes.margins(x=0.02)
        all_axes[0].legend()
    return figure


def draw_series(axes: Axes, series: NDArray[np.float64]) -> None:
    """Draw the median of series, (worlds, robots + 1), and bands of quantiles about it."""
    colour, robots = SERIES[0].colour, range(series.shape[1])
    for low, high, alpha in BANDS:
        axes.fill_between(
            robots,
            *np.quantile(series, (low, high), axis=0, method='inverted_cdf'),
            color=colour,
            alpha=alpha,
            linewidth=0,
            label=f'{100 * low:.0f} to {100 * high:.0f} %',
        )
    median = np.quantile(series, 0.5, axis=0, method='inverted_cdf')
    axes.plot(median, color=colour, label='median')
