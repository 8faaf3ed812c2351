# SPDX-License-Identifier: Apache-2.0
"""The page of two missions side by side, of the same parts as the page of one."""

from __future__ import annotations

from collections.abc import Iterator
import json
from typing import Any

from kbnitp_ros.figures import DARK_MAPS, MAPS
from kbnitp_ros.report.answers import findings_of, losses_of
from kbnitp_ros.report.comparison import (
    differences,
    given_differently,
    Pair,
    reservations,
    true_differences,
)
from kbnitp_ros.report.figures import quantiles_of
from kbnitp_ros.report.mission import Mission
from kbnitp_ros.report.page import (
    Column,
    field_of,
    in_json,
    rendered,
    scales_of,
    summary,
    title_of,
    value_text,
)
from kbnitp_ros.report.plots import lines_plot, map_plot, OBSTACLE
from kbnitp_ros.report.tiles import Tile, tiles_of
import numpy as np
from numpy.typing import NDArray

FINDINGS = (
    Column('what', 'kind', is_text=True),
    Column('x (m)', 'x', 2),
    Column('y (m)', 'y', 2),
    Column('probability in A', 'a', 3),
    Column('in B', 'b', 3),
    Column('B less A', 'change', 3),
)

SIDES = ('A', 'B')


def comparison_of(first: Pair, second: Pair) -> str:
    """Return the page of two missions in one field, as `check_one_field` finds them to be."""
    missions = first.mission, second.mission
    titles = [title_of(each.log) for each in missions]
    maps = list(maps_of(*missions))
    panels = dict(panels_of(first, second))
    plots = {name: plot for name, _, _, plot in maps}
    plots |= {f'curve-{number}': plot for number, plot in enumerate(panels.values())}
    return rendered(
        'comparison',
        title=f'{titles[0]} and {titles[1]}',
        summaries=[
            (side, pair.mission.log, summary(*pair)) for side, pair in zip(SIDES, (first, second))
        ],
        notes=list(notes_of(*missions)),
        tiles=list(compared(first, second)),
        maps=maps,
        obstacle=OBSTACLE,
        finding_columns=FINDINGS,
        findings=list(finding_rows(*missions)),
        panels=list(panels),
        given=[
            ['' if each is None else value_text(each) for each in values]
            for values in given_differently(*missions)
        ],
        data=json.dumps(data_of(*missions, maps)).replace('<', '\\u003c'),
        plots=in_json(plots),
    )


def notes_of(first: Mission, second: Mission) -> Iterator[str]:
    """Yield what else is to be known of both, and of each."""
    yield from reservations(first, second)
    for side, mission in zip(SIDES, (first, second)):
        yield from (f'{side}: {note}' for note in mission.notes)


def compared(first: Pair, second: Pair) -> Iterator[tuple[str, list[tuple[str, Tile]], str]]:
    """Yield each question, the answers of both missions, and how they differ."""
    for a, b, difference in zip(tiles_of(*first), tiles_of(*second), differences(first, second)):
        question = a.question if a.question == b.question else 'Is the goal safe?'
        yield question, list(zip(SIDES, (a, b))), difference


def maps_of(first: Mission, second: Mission) -> Iterator[tuple[str, str, str, str]]:
    """Yield the maps in rows of A, B and B less A: id, caption, colours, and Plotly's JSON."""
    grid = first.grid
    beliefs = [each.moments[-1].belief for each in (first, second)]
    for name in MAPS:
        values = [getattr(each, name) for each in beliefs]
        for side, mission, each in zip(SIDES, (first, second), values):
            lane = None if mission.decision is None else mission.decision.path
            plot = map_plot(mission.grid, each, lane=lane)
            yield f'{side}-{name}', f'{name}, believed in {side}', name, plot
        change = map_plot(grid, values[1] - values[0], least=-1.0)
        yield f'change-{name}', f'{name}, B less A', f'change-{name}', change
    losses = [losses_of(each) for each in (first, second)]
    most = max(1.0, *(float(each.max()) for each in losses))
    for side, mission, each in zip(SIDES, (first, second), losses):
        plot = map_plot(mission.grid, each, most)
        yield f'{side}-losses', f'robots lost, expected in {side}', 'losses', plot
    change = map_plot(grid, losses[1] - losses[0], most, least=-most)
    yield 'change-losses', 'robots lost, B less A', 'change-hazard', change
    truths = {side: each.world for side, each in zip(SIDES, (first, second)) if each.world}
    if len(truths) == 2 and not any(true_differences(first, second)):
        truths = {'both': truths['A']}
    for side, world in truths.items():
        for name, values in vars(world).items():
            plot = map_plot(grid, values.astype(float))
            yield f'{side}-true-{name}', f'{name}, true in {side}', name, plot


def data_of(
    first: Mission, second: Mission, maps: list[tuple[str, str, str, str]]
) -> dict[str, Any]:
    """Return what the page is to know to draw the maps, as JSON can hold it."""
    scales: dict[str, Any] = scales_of(first)
    for name in MAPS:
        # No change has the colour of the paper, half way between -1 and 1.
        scales[f'change-{name}'] = {
            'light': MAPS[name].stops(0.5),
            'dark': DARK_MAPS[name].stops(0.5),
        }
    entered = {side: each.visited().tolist() for side, each in zip(SIDES, (first, second))}
    believed = {f'{side}-{name}' for side in SIDES for name in MAPS}
    return {
        'name': f'{title_of(first.log)}_{title_of(second.log)}',
        'grid': field_of(first.grid),
        'scales': scales,
        'assumed': first.assumed,
        'maps': {
            name: {'colours': colours, 'entered': entered[name[0]] if name in believed else None}
            for name, _, colours, _ in maps
        },
    }


def panels_of(first: Pair, second: Pair) -> Iterator[tuple[str, str]]:
    """Yield what each panel of curves is of, and the panel as Plotly's JSON."""
    panels: dict[str, dict[str, NDArray[np.float64]]] = {}
    for side, (_, curves) in zip(SIDES, (first, second)):
        for label, values in {
            'entropy H(Z) + H(X) (nats)': curves.entropy,
            'log loss (nats)': curves.log_loss,
            'information gained so far (nats)': np.nancumsum(curves.gained),
            'robots lost': curves.lost.astype(np.float64),
        }.items():
            panels.setdefault(label, {})[side] = values
    for name in first.mission.moments[-1].learnt | second.mission.moments[-1].learnt:
        panels[f'{name.replace("_", " ")} (median)'] = {
            side: quantiles_of(pair.mission, name)[:, 2]
            for side, pair in zip(SIDES, (first, second))
        }
    for label, lines in panels.items():
        known = {side: values for side, values in lines.items() if not np.isnan(values).all()}
        if known:
            drawn = {side: (np.arange(each.size), each) for side, each in known.items()}
            yield label, lines_plot(label, drawn)


def finding_rows(first: Mission, second: Mission) -> Iterator[dict[str, Any]]:
    """Yield the rows of what was found in one of two missions, or in both."""
    beliefs = [each.moments[-1].belief for each in (first, second)]
    found = {
        (each.kind, each.cell): each
        for mission in (first, second)
        for each in findings_of(mission)
    }
    for (kind, place), each in sorted(found.items()):
        a, b = (float(getattr(belief, kind)[place]) for belief in beliefs)
        yield {**vars(each), 'a': a, 'b': b, 'change': b - a}
