# SPDX-License-Identifier: Apache-2.0
"""The page of two missions in one field, A and B, with their differences."""

from __future__ import annotations

from collections.abc import Iterator
import json
from typing import Any

from kbnitp_ros.figures import DARK_MAPS, MAPS, stops
from kbnitp_ros.files import counted
from kbnitp_ros.report.answers import (
    answer_tiles,
    classify_cells,
    expected_losses,
    FOUND,
    list_findings,
    places,
    spot,
    SUSPECTED,
    Tile,
)
from kbnitp_ros.report.figures import learnt_quantiles
from kbnitp_ros.report.mission import Mission
from kbnitp_ros.report.page import (
    colour_scales,
    Column,
    field_data,
    in_json,
    mission_title,
    rendered,
    summary,
    value_text,
)
from kbnitp_ros.report.plots import lines_plot, map_plot, OBSTACLE
from kbnitp_ros.report.tables import Curves
import numpy as np
from numpy.typing import NDArray

# A mission with its curves.
Pair = tuple[Mission, Curves]


def check_one_field(first: Mission, second: Mission) -> None:
    """Check that the cells of two missions cover the same places."""
    fields = [
        f'{grid.width}x{grid.height} cells of {grid.resolution:g} m from '
        f'({grid.origin[0]:g}, {grid.origin[1]:g})'
        + (f', turned by {grid.yaw:g} rad' if grid.yaw else '')
        for grid in (first.grid, second.grid)
    ]
    if fields[0] != fields[1]:
        raise ValueError(
            f'{first.log} has {fields[0]}, {second.log} has {fields[1]}: only missions in the '
            'same field can be compared; report each of them separately'
        )


def reservations(first: Mission, second: Mission) -> Iterator[str]:
    """Yield differences of two missions in one field that limit a comparison."""
    if first.grid.bases != second.grid.bases:
        yield 'The bases are different cells.'
    blocked = int((first.grid.free != second.grid.free).sum())
    if blocked:
        yield f'Blocked in only one of the missions: {counted(blocked, "cell")}.'
    if first.world and second.world:
        hazards, targets = true_differences(first, second)
        if hazards or targets:
            yield (
                f'The true fields differ: hazards in {counted(hazards, "cell")}, targets in '
                f'{counted(targets, "cell")}. This may cause other differences.'
            )
    elif first.world or second.world:
        known = 'A' if first.world else 'B'
        yield f'Only {known} has the truth on record.'
    for name, assumed in first.assumed.items():
        other = second.assumed[name]
        if abs(assumed - other) >= 0.005:
            yield (
                f'The prior probability of {name} was {assumed:.2f} in A and {other:.2f} in B; '
                "the colours of both maps are relative to A's."
            )


def true_differences(first: Mission, second: Mission) -> tuple[int, int]:
    """Return the numbers of cells whose true hazard, and true target, differ; 0 if unknown."""
    if not (first.world and second.world):
        return 0, 0
    hazards = first.world.hazard != second.world.hazard
    targets = first.world.target != second.world.target
    return int(hazards.sum()), int(targets.sum())


def differences(first: Pair, second: Pair) -> Iterator[str]:
    """Yield the difference of two missions in each tile; empty if a tile has none."""
    missions, curves = (first[0], second[0]), (first[1], second[1])
    one, other = map(classify_cells, missions)
    yield alone(one.free, other.free, 'free')
    yield found_alone(*missions, 'target', FOUND)
    yield found_alone(*missions, 'hazard', SUSPECTED)
    yield alone(one.entered, other.entered, 'entered')
    yield lanes(*missions)
    entropies = [float(each.entropy[-1]) for each in curves]
    losses = [float(each.log_loss[-1]) for each in curves]
    left = f'{more(entropies[1] - entropies[0], "nats", ".1f")} left in B.'
    if not np.isnan(losses).any():
        left += f' Log loss: {losses[0]:.1f} nats in A, {losses[1]:.1f} in B.'
    yield left
    sent = [len(each.deployments) for each in missions]
    lost = [sum(not seen.survived for seen in each.ended) for each in missions]
    yield f'B sent {more(sent[1] - sent[0], "robots")} and lost {more(lost[1] - lost[0])}.'
    yield where(*missions)
    # Recommended actions are not compared.
    yield ''


def alone(first: NDArray[np.bool_], second: NDArray[np.bool_], what: str) -> str:
    """Return the numbers of cells with a property in only one of two missions."""
    return (
        f'{what.capitalize()} only in A: {counted(int((first & ~second).sum()), "cell")}; only '
        f'in B: {counted(int((second & ~first).sum()), "cell")}.'
    )


def found_alone(first: Mission, second: Mission, kind: str, least: float) -> str:
    """Describe the findings of at least this probability: in both missions, and in only one."""
    one, other = (
        {
            each.cell: each
            for each in list_findings(mission)
            if each.kind == kind and each.probability >= least
        }
        for mission in (first, second)
    )
    only_one = [each for cell, each in one.items() if cell not in other]
    only_other = [each for cell, each in other.items() if cell not in one]
    both = len(one) - len(only_one)
    return f'{both} in both; only in A: {places(only_one)}; only in B: {places(only_other)}.'


def lanes(first: Mission, second: Mission) -> str:
    """Describe the difference of the probabilities of the goal; empty without a goal."""
    one, other = first.decision, second.decision
    if one is None or other is None:
        return '' if one is other else 'Only one of the missions had a goal.'
    if one.goal != other.goal:
        return 'The goals are different.'
    points = 100.0 * (other.p_free - one.p_free)
    return f'{more(points, "points", ".1f")} in B.'


def where(first: Mission, second: Mission) -> str:
    """Describe the cell in which the expected losses differ most."""
    one, other = expected_losses(first), expected_losses(second)
    most = int(np.argmax(np.abs(other - one)))
    if one[most] == other[most]:
        return 'No difference.'
    place = spot(*first.grid.centers([most])[0])
    return f'Largest difference at {place}: {one[most]:.1f} in A, {other[most]:.1f} in B.'


def more(difference: float, unit: str = '', form: str = 'd') -> str:
    """Return a signed difference in words."""
    if format(abs(difference), form) == format(type(difference)(0), form):
        return f'as many {unit}'.strip()
    word = 'more' if difference > 0 else 'fewer' if unit != 'nats' else 'less'
    return ' '.join(filter(None, (format(abs(difference), form), unit, word)))


def given_differently(
    first: Mission, second: Mission
) -> Iterator[tuple[str, str, object, object]]:
    """Yield versions and parameters that differ: node, name, value in A, value in B."""
    tables = [{'versions': each.run, **each.parameters} for each in (first, second)]
    for node in dict.fromkeys([*tables[0], *tables[1]]):
        one, other = (each.get(node, {}) for each in tables)
        for name in dict.fromkeys([*one, *other]):
            values = one.get(name), other.get(name)
            if values[0] != values[1]:
                yield node, name, *values


FINDINGS = (
    Column('what', 'kind', is_text=True),
    Column('x (m)', 'x', None),
    Column('y (m)', 'y', None),
    Column('probability in A', 'a', 3),
    Column('in B', 'b', 3),
    Column('B less A', 'change', 3),
)

SIDES = ('A', 'B')


def comparison_page(first: Pair, second: Pair) -> str:
    """Return the page of two missions that have passed `check_one_field`."""
    missions = first[0], second[0]
    titles = [mission_title(each.log) for each in missions]
    maps = list(compared_maps(*missions))
    panels = dict(compared_panels(first, second))
    plots = {name: plot for name, _, _, plot in maps}
    plots |= {f'curve-{number}': plot for number, plot in enumerate(panels.values())}
    return rendered(
        'comparison',
        title=f'{titles[0]} and {titles[1]}',
        summaries=[
            (side, pair[0].log, summary(*pair)) for side, pair in zip(SIDES, (first, second))
        ],
        notes=[
            *reservations(*missions),
            *(f'{side}: {note}' for side, each in zip(SIDES, missions) for note in each.notes),
        ],
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
        data=json.dumps(comparison_data(*missions, maps)).replace('<', '\\u003c'),
        plots=in_json(plots),
    )


def compared(first: Pair, second: Pair) -> Iterator[tuple[str, list[tuple[str, Tile]], str]]:
    """Yield each question, the answers of both missions, and the difference."""
    for a, b, difference in zip(
        answer_tiles(*first), answer_tiles(*second), differences(first, second)
    ):
        question = a.question if a.question == b.question else 'Is the goal safe?'
        yield question, list(zip(SIDES, (a, b))), difference


def compared_maps(first: Mission, second: Mission) -> Iterator[tuple[str, str, str, str]]:
    """Yield the maps, in rows of A, B, and B minus A: id, caption, colours, and Plotly's JSON."""
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
    losses = [expected_losses(each) for each in (first, second)]
    most = max(1.0, *(float(each.max()) for each in losses))
    for side, mission, each in zip(SIDES, (first, second), losses):
        plot = map_plot(mission.grid, each, most)
        yield f'{side}-losses', f'robots lost, expected in {side}', 'robots-lost', plot
    change = map_plot(grid, losses[1] - losses[0], most, least=-most)
    yield 'change-losses', 'robots lost, B less A', 'change-hazard', change
    truths = {side: each.world for side, each in zip(SIDES, (first, second)) if each.world}
    if len(truths) == 2 and not any(true_differences(first, second)):
        truths = {'both': truths['A']}
    for side, world in truths.items():
        for name, values in vars(world).items():
            plot = map_plot(grid, values.astype(float))
            yield f'{side}-true-{name}', f'{name}, true in {side}', name, plot


def comparison_data(
    first: Mission, second: Mission, maps: list[tuple[str, str, str, str]]
) -> dict[str, Any]:
    """Return the data of the maps for the page, as JSON values."""
    scales: dict[str, Any] = colour_scales(first)
    for name in MAPS:
        # The middle of the scale from -1 to 1, no change, has the colour of the paper.
        scales[f'change-{name}'] = {
            'light': stops(MAPS[name], 0.5),
            'dark': stops(DARK_MAPS[name], 0.5),
        }
    entered = {side: each.visited().tolist() for side, each in zip(SIDES, (first, second))}
    believed = {f'{side}-{name}' for side in SIDES for name in MAPS}
    return {
        'name': f'{mission_title(first.log)}_{mission_title(second.log)}',
        'grid': field_data(first.grid),
        'scales': scales,
        'assumed': first.assumed,
        'maps': {
            name: {'colours': colours, 'entered': entered[name[0]] if name in believed else None}
            for name, _, colours, _ in maps
        },
    }


def compared_panels(first: Pair, second: Pair) -> Iterator[tuple[str, str]]:
    """Yield the title of each panel of curves, and the panel in Plotly's JSON."""
    panels: dict[str, dict[str, NDArray[np.float64]]] = {}
    for side, (_, curves) in zip(SIDES, (first, second)):
        for label, values in {
            'entropy H(Z) + H(X) (nats)': curves.entropy,
            'log loss (nats)': curves.log_loss,
            'information gained so far (nats)': np.nancumsum(curves.gained),
            'robots lost': curves.lost.astype(np.float64),
        }.items():
            panels.setdefault(label, {})[side] = values
    missions = first[0], second[0]
    for name in {name: 0 for each in missions for name in each.moments[-1].state.numbers}:
        panels[f'{name.replace("_", " ")} (median)'] = {
            side: learnt_quantiles(each, name)[:, 2] for side, each in zip(SIDES, missions)
        }
    for label, lines in panels.items():
        known = {side: values for side, values in lines.items() if not np.isnan(values).all()}
        if known:
            drawn = {side: (np.arange(each.size), each) for side, each in known.items()}
            yield label, lines_plot(label, drawn)


def finding_rows(first: Mission, second: Mission) -> Iterator[dict[str, Any]]:
    """Yield the rows of findings in one of two missions, or in both."""
    beliefs = [each.moments[-1].belief for each in (first, second)]
    found = {
        (each.kind, each.cell): each
        for mission in (first, second)
        for each in list_findings(mission)
    }
    for (kind, place), each in sorted(found.items()):
        a, b = (float(getattr(belief, kind)[place]) for belief in beliefs)
        yield {**vars(each), 'a': a, 'b': b, 'change': b - a}
