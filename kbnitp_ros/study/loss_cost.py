# SPDX-License-Identifier: Apache-2.0
"""The cost of a lost robot: the robots lost, and the log loss that is reached with them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from kbnitp_ros.figures import Style
from kbnitp_ros.study.charts import LOG_LOSS_LABEL
from kbnitp_ros.study.panels import panels_figure
from kbnitp_ros.study.results import Results, Series
from kbnitp_ros.study.scenario import Contender, Strategy
from kbnitp_ros.study.summary import (
    interval,
    LOG_LOSS,
    Mean,
    mean_of,
    resampled_means,
    Row,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

# What is compared where two missions know as much.
EQUAL = ('log_loss', 'sent_at_least', 'sent', 'lost_at_least', 'lost', 'difference', 'fewer')


def trade(series: Series, team: Strategy) -> NDArray[np.float64]:
    """Return the robots lost and the total log loss, shape (trials, 2, robots + 1)."""
    return np.stack([series('robots_lost', team=team), series(*LOG_LOSS, team=team)], axis=1)


def at_equal_log_loss(
    least: NDArray[np.float64], this: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compare two missions at the lowest log loss that both reach."""
    lowest = [np.minimum.accumulate(log_loss) for _, log_loss in (least, this)]
    level = max(log_loss[-1] for log_loss in lowest)
    # From the last robot back, so that the first of several with the same log loss is taken.
    sent = [np.interp(level, low[::-1], np.arange(low.size)[::-1]) for low in lowest]
    lost = [np.interp(n, np.arange(of.size), of) for n, (of, _) in zip(sent, (least, this))]
    return np.array([level, *sent, *lost, lost[1] - lost[0], sent[0] - sent[1]])


def compare(least: NDArray[np.float64], this: NDArray[np.float64]) -> dict[str, Mean]:
    """Compare the mean missions of two sets of trials, paired by their worlds, by `EQUAL`."""
    resampled = [
        at_equal_log_loss(*means) for means in zip(resampled_means(least), resampled_means(this))
    ]
    found = at_equal_log_loss(least.mean(axis=0), this.mean(axis=0))
    compared = interval(found, np.reshape(resampled, (-1, found.size)))
    return {name: Mean(*values) for name, *values in zip(EQUAL, *compared)}


def at_equal_log_loss_more(series: Series, least: Strategy, this: Strategy) -> Mean:
    """Return how many more robots a strategy has lost at equal log loss."""
    return compare(trade(series, least), trade(series, this))['difference']


def equal_rows(results: Results) -> Iterator[Row]:
    """Yield what the least loss cost and each other come to at equal log loss: `EQUAL`."""
    least, *others = sorted(results.scenario.teams, key=lambda team: team.loss_cost)
    for row, team, series in results.missions(others):
        measured = compare(trade(series, least), trade(series, team))
        del measured['fewer']
        yield row | vars(team) | measured


def base_rows(results: Results) -> Iterator[Row]:
    """Yield by how much each second base lowers the log loss, and the robots at equal log loss."""
    one, *others = sorted(results.scenario.teams, key=lambda team: team.second_base)
    for row, two, series in results.missions(others):
        missions = trade(series, one), trade(series, two)
        equal = compare(*missions)
        yield row | {
            **vars(two),
            'value': mean_of(missions[0][:, 1, -1] - missions[1][:, 1, -1]),
            'log_loss': equal['log_loss'],
            'sent_from_one': equal['sent_at_least'],
            'sent': equal['sent'],
            'lost_from_one': equal['lost_at_least'],
            'lost': equal['lost'],
            'fewer': equal['fewer'],
        }


def loss_cost_chart(results: Results) -> Figure:
    """Draw log loss against robots lost, a panel a lethality."""

    def draw(
        axes: Axes, lethality: float | None, contender: Contender, style: Style, label: str
    ) -> None:
        (lost, log_loss), low, high = mean_of(
            trade(partial(results.series, lethality, contender.method), contender.team)
        )
        at_its_end = {'markevery': [-1], 'markersize': 5}
        axes.plot(lost, log_loss, **style.line(lost.size) | at_its_end, label=label)
        end = lost[-1], log_loss[-1]
        (left, bottom), (right, top) = (np.abs(each[:, -1] - end) for each in (low, high))
        axes.errorbar(
            *end,
            [[bottom], [top]],
            [[left], [right]],
            fmt='none',
            ecolor=style.colour,
            elinewidth=0.8,
        )

    return panels_figure(results.scenario, draw, 'robots lost', LOG_LOSS_LABEL)
