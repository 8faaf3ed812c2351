# SPDX-License-Identifier: Apache-2.0
"""What a robot is worth: the robots lost, and the log loss that is reached with them."""

from __future__ import annotations

from itertools import product
from typing import Any

from kbnitp_ros.figures import Style
from kbnitp_ros.study.charts import LOG_LOSS_LABEL
from kbnitp_ros.study.panels import panels_figure
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import Contender, in_short, Strategy
from kbnitp_ros.study.summary import (
    as_json,
    interval,
    LOG_LOSS,
    Mean,
    mean_of,
    resampled_means,
    shown,
    table,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

# What is compared where two missions know as much.
EQUAL = ('log_loss', 'sent_at_least', 'sent', 'lost_at_least', 'lost', 'difference')


def trade(
    results: Results, lethality: float | None, method: str, team: Strategy
) -> NDArray[np.float64]:
    """Return the robots lost and the total log loss, shape (trials, 2, robots + 1)."""
    lost = results.series(lethality, method, 'robots_lost', team=team)
    return np.stack([lost, results.series(lethality, method, *LOG_LOSS, team=team)], axis=1)


def at_equal_log_loss(
    least: NDArray[np.float64], this: NDArray[np.float64]
) -> NDArray[np.float64]:
    """
    Compare two missions at the lowest log loss that both reach.

    Each counts up to where it first got there, since it could have been ended then; between two
    robots as the log loss is between theirs.

    Parameters
    ----------
    least, this : ndarray, shape (2, robots + 1)
        The robots lost and the log loss of a mission where a robot costs least and of this one,
        before the first robot and after each; both begin with the same log loss.

    Returns
    -------
    ndarray, shape (6,)
        `EQUAL`: that log loss, the robots sent until then by each, those lost, and how many more
        this one lost.

    """
    lowest = [np.minimum.accumulate(log_loss) for _, log_loss in (least, this)]
    level = max(log_loss[-1] for log_loss in lowest)
    # From the last robot back, so that the first of several with the same log loss is taken.
    sent = [np.interp(level, low[::-1], np.arange(low.size)[::-1]) for low in lowest]
    lost = [np.interp(n, np.arange(of.size), of) for n, (of, _) in zip(sent, (least, this))]
    return np.array([level, *sent, *lost, lost[1] - lost[0]])


def compare(least: NDArray[np.float64], this: NDArray[np.float64]) -> Mean:
    """
    Compare the mean missions of two sets of trials, paired by their worlds.

    Parameters
    ----------
    least, this : ndarray, shape (trials, 2, robots + 1)
        As `trade` gives them.

    Returns
    -------
    Mean
        Of `EQUAL`, each shape (6,).

    """
    resampled = [
        at_equal_log_loss(*means) for means in zip(resampled_means(least), resampled_means(this))
    ]
    found = at_equal_log_loss(least.mean(axis=0), this.mean(axis=0))
    return interval(found, np.reshape(resampled, (-1, len(EQUAL))))


def at_equal_log_loss_more(
    results: Results, lethality: float | None, method: str, least: Strategy, this: Strategy
) -> dict[str, float | None]:
    """Return how many more robots a strategy has lost at equal log loss, as JSON can hold it."""
    equal = compare(*(trade(results, lethality, method, of) for of in (least, this)))
    return as_json(Mean(*(values[-1] for values in equal)))


def summarise_loss_cost(results: Results) -> dict[str, Any]:
    """
    Return what the least loss cost and each other come to at equal log loss, as JSON can hold it.

    Returns
    -------
    dict
        ``least`` (the lowest loss cost) and ``rows``: one for each lethality, method and other
        loss cost, with the mean and interval of each of `EQUAL`.

    """
    scenario = results.scenario
    least, *others = sorted(scenario.teams, key=lambda team: team.loss_cost)
    rows = []
    for lethality, method, team in product(scenario.lethalities, scenario.methods, others):
        compared = compare(*(trade(results, lethality, method, of) for of in (least, team)))
        row: dict[str, Any] = {'lethality': lethality, 'method': method, **vars(team)}
        for name, *values in zip(EQUAL, *compared):
            row[name] = as_json(Mean(*values))
        rows.append(row)
    return {'least': least.loss_cost, 'rows': rows}


def loss_cost_markdown(summary: dict[str, Any]) -> str:
    """Return a summary of loss costs as a table for people."""
    least = f'{summary["least"]:.4g}'
    columns = {
        'log_loss': 'log loss',
        'sent_at_least': f'robots sent at {least}',
        'sent': 'robots sent',
        'lost_at_least': f'robots lost at {least}',
        'lost': 'robots lost',
        'difference': 'difference',
    }
    caption = (
        f'At equal log loss: the lowest mean log loss that is reached both with a loss cost of '
        f'{least} and with that of the row, and the robots that were sent and lost when it was '
        f'reached. Difference: how many more are lost than with {least}, in the same worlds.'
    )
    rows = []
    for row in summary['rows']:
        cells = [in_short(row['lethality']), f'`{row["method"]}`', f'{row["loss_cost"]:.4g}']
        cells += [shown(row[name]) for name in columns]
        rows.append(cells)
    return table(caption, ['lethality', 'method', 'loss cost', *columns.values()], rows)


def loss_cost_chart(results: Results) -> Figure:
    """
    Draw the log loss reached against the robots lost, a panel a lethality, from the prior on.

    A marker is where the mission ends, with its intervals in both directions.
    """

    def draw(
        axes: Axes, lethality: float | None, contender: Contender, style: Style, label: str
    ) -> None:
        (lost, log_loss), low, high = mean_of(trade(results, lethality, *contender))
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
