# SPDX-License-Identifier: Apache-2.0
"""Panels of a study's figures: what shares one, what it is called, and where it stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from kbnitp_ros.figures import SERIES, Style, WIDTH
from kbnitp_ros.study.scenario import Contender, in_percent, Scenario, team_labels
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
import numpy as np

# Beside each other at most.
COLUMNS = 4

Draw = Callable[[Axes, float | None, Contender, Style, str], None]


def labels_of(scenario: Scenario) -> dict[Contender, str]:
    """Return what tells each contender from the others."""
    teams = team_labels(scenario)
    return {each: _label(each, scenario, teams[each.team]) for each in scenario.contenders}


def _label(contender: Contender, scenario: Scenario, team: str) -> str:
    if len(scenario.methods) == 1 and team:
        return team
    return f'{contender.method}, {team}' if team else contender.method


def groups_of(contenders: Sequence[Contender]) -> list[list[Contender]]:
    """Return which contenders share a panel."""
    if len(contenders) <= len(SERIES):
        return [list(contenders)]
    for distinctions in (
        [each.method for each in contenders],
        [each.team.allocation if each.team.agents > 1 else None for each in contenders],
    ):
        names = [name for name in dict.fromkeys(distinctions) if name is not None]
        if len(names) > 1:
            return [
                group
                for name in names
                for group in groups_of(
                    [
                        each
                        for each, distinction in zip(contenders, distinctions)
                        if distinction in (name, None)
                    ]
                )
            ]
    first, *others = contenders
    groups = -(-len(others) // (len(SERIES) - 1))
    size = -(-len(others) // groups)
    return [[first, *others[slice(begin, begin + size)]] for begin in range(0, len(others), size)]


def panels_figure(
    scenario: Scenario, draw: Draw, across: str, up: str, scale: str = 'linear'
) -> Figure:
    """Return a figure with a panel a lethality, and rows of them for each group of contenders."""
    labels, groups = labels_of(scenario), groups_of(scenario.contenders)
    lethalities = scenario.lethalities
    columns = columns_for(len(lethalities))
    height = 1.9 * -(-len(lethalities) // columns) + 0.4
    figure = Figure(figsize=(WIDTH, height * len(groups) + 0.4), layout='constrained')
    panels = []
    for part, group in zip(figure.subfigures(len(groups), 1, squeeze=False).flat, groups):
        row = grid_of(part, len(lethalities), columns)
        for axes, lethality in zip(row, lethalities):
            for contender, style in zip(group, SERIES):
                draw(axes, lethality, contender, style, labels[contender])
            axes.set_title(f'lethality {in_percent(lethality)}')
            axes.set_yscale(scale)
        legend_above(part, row[0])
        panels += row
    share_limits(panels)
    if scale == 'log':
        mark_decades(panels)
    # Where all have one method no label names it.
    methods, teams = scenario.methods, scenario.teams
    method = f'{methods[0]}, ' if len(methods) == 1 < len(teams) else ''
    figure.supxlabel(f'{across} ({method}mean of {trials_in(scenario)}, 95 % intervals)')
    figure.supylabel(up)
    return figure


def trials_in(scenario: Scenario) -> str:
    """Return how many trials a study has, in words."""
    return '1 trial' if scenario.trials == 1 else f'{scenario.trials} trials'


def columns_for(panels: int) -> int:
    """Return how many panels stand beside each other, so that the rows are full if they can be."""
    rows = -(-panels // COLUMNS)
    return -(-panels // rows)


def grid_of(
    part: FigureBase, panels: int, columns: int, sharey: Literal['none', 'all', 'row'] = 'all'
) -> list[Axes]:
    """Return panels that share their axes, row by row; only those at the edges have numbers."""
    rows = -(-panels // columns)
    grid = part.subplots(rows, columns, sharex=True, sharey=sharey, squeeze=False)
    used, unused = np.split(grid.ravel(), [panels])
    for axes in unused:
        axes.set_visible(False)
    for axes in used[slice(-columns, None)]:
        axes.tick_params(labelbottom=True)
    for axes in used:
        axes.grid(alpha=0.3)
    return list(used)


def legend_above(part: FigureBase, axes: Axes) -> None:
    """Say above the panels what their lines are, in as many columns as there is room for."""
    handles, labels = axes.get_legend_handles_labels()
    # In points: the letters of the labels, and their lines.
    room = 72.0 * WIDTH
    widths = [3.9 * len(label) + 30.0 for label in labels]
    columns = len(labels)
    if sum(widths) > room:
        rows = -(-len(labels) // max(1, int(room / max(widths))))
        columns = -(-len(labels) // rows)
    part.legend(handles, labels, loc='outside upper center', ncols=columns, handlelength=3.0)


def share_limits(panels: Sequence[Axes]) -> None:
    """Let all panels show the same range, also where they share no axis."""
    left, right = zip(*(axes.get_xlim() for axes in panels))
    bottom, top = zip(*(axes.get_ylim() for axes in panels))
    for axes in panels:
        axes.set_xlim(min(left), max(right))
        axes.set_ylim(min(bottom), max(top))


def mark_decades(panels: Sequence[Axes]) -> None:
    """Put numbers on logarithmic axes as people count, the closer the less they span."""
    low, high = panels[0].get_ylim()
    steps = (1, 2, 3, 5, 7) if high < 20.0 * low else (1, 2, 5) if high < 1e3 * low else (1,)
    for axes in panels:
        axes.yaxis.set_major_locator(LogLocator(subs=steps))
        axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axes.yaxis.set_minor_locator(NullLocator())
