# SPDX-License-Identifier: Apache-2.0
"""What the method that learns came to know of numbers, and what not knowing them costs."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from kbnitp_ros.figures import SERIES, WIDTH
from kbnitp_ros.study.panels import columns_for, grid_of, legend_above, trials_in
from kbnitp_ros.study.results import Results
from kbnitp_ros.study.scenario import in_percent, LEARNING, NUMBERS
from kbnitp_ros.study.summary import (
    after_robots,
    LOG_LOSS,
    mean_of,
    means_after,
    Row,
)
from kbnitp_ros.study.trial import LEARNT
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

MEAN, SD, LOW, HIGH = (LEARNT.index(name) for name in ('mean', 'sd', 0.05, 0.95))

# After how many robots missions are compared, and after the last one.
ROBOTS = (10, 25, 50, 100, 200)


def learnt_numbers(results: Results) -> list[str]:
    """Return the names of the numbers that were learnt."""
    return list(results.scenario.learn.priors())


def of_number(
    results: Results, lethality: float | None, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what was known of a number, (trials, robots + 1, learnt), and it, (trials, 1)."""
    known, truth = results.learnt(lethality, results.scenario.teams[0])
    place = NUMBERS.index(name)
    return known[:, :, place], truth[:, place, None]


def number_rows(results: Results) -> Iterator[Row]:
    """Yield how well numbers are known at the end, one row for each lethality and number."""
    for lethality, name in product(results.scenario.lethalities, learnt_numbers(results)):
        known, truth = of_number(results, lethality, name)
        first, last = known[:, 0], known[:, -1]
        is_within = (last[:, LOW] <= truth[:, 0]) & (truth[:, 0] <= last[:, HIGH])
        yield {
            'lethality': lethality,
            'number': name,
            'sd_before': mean_of(first[:, SD]),
            'sd': mean_of(last[:, SD]),
            'error': mean_of(np.abs(last[:, MEAN] - truth[:, 0])),
            'within': mean_of(is_within.astype(np.float64)),
        }


def cost_of_learning(results: Results) -> Iterator[Row]:
    """Yield what not being told costs, one row for each lethality and other method."""
    scenario = results.scenario
    team, robots = scenario.teams[0], after_robots(ROBOTS, scenario.robots)
    for lethality in scenario.lethalities:
        learner = results.series(lethality, LEARNING, *LOG_LOSS, team=team)
        for method in scenario.methods:
            if method != LEARNING:
                informed = results.series(lethality, method, *LOG_LOSS, team=team)
                costs = means_after(learner - informed, robots)
                yield {'lethality': lethality, 'method': method, 'costs': costs}


def numbers_chart(results: Results) -> Figure:
    """Draw how well each number is known after each deployment, a panel a number and lethality."""
    scenario, names = results.scenario, learnt_numbers(results)
    shown_in = list(product(names, scenario.lethalities))
    # A row a number, unless there is but one panel of each.
    are_rows = len(scenario.lethalities) > 1
    columns = len(scenario.lethalities) if are_rows else columns_for(len(names))
    rows = -(-len(shown_in) // columns)
    figure = Figure(figsize=(WIDTH, 1.7 * rows + 0.6), layout='constrained')
    panels = grid_of(figure, len(shown_in), columns, sharey='row' if are_rows else 'none')
    for place, ((name, lethality), axes) in enumerate(zip(shown_in, panels)):
        draw_known(axes, *of_number(results, lethality, name))
        if not are_rows:
            axes.set_title(name.replace('_', ' '))
        elif place % columns == 0:
            axes.set_ylabel(name.replace('_', ' '))
        if are_rows and place < columns:
            axes.set_title(f'lethality {in_percent(lethality)}')
    figure.supxlabel(f'deployment (root mean squares of {trials_in(scenario)})')
    legend_above(figure, panels[0])
    return figure


def draw_known(axes: Axes, known: NDArray[np.float64], truth: NDArray[np.float64]) -> None:
    """Draw how far a number is from what is believed, and how far it is believed to be."""
    error = np.sqrt(((known[:, :, MEAN] - truth) ** 2).mean(axis=0))
    spread = np.sqrt((known[:, :, SD] ** 2).mean(axis=0))
    lines = {'error of the mean': error, 'standard deviation believed': spread}
    for (label, values), style in zip(lines.items(), SERIES):
        axes.plot(values, **style.line(values.size), label=label)
    axes.margins(x=0.02)
    axes.set_ylim(bottom=0.0)
