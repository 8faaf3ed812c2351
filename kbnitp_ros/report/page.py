# SPDX-License-Identifier: Apache-2.0
"""The page of a mission: one HTML file that needs no network."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from functools import cache
from importlib.resources import files
import json
from math import pi
from pathlib import Path
from typing import Any, NamedTuple
import zlib

from jinja2 import Environment, PackageLoader, StrictUndefined
from kbnitp_ros.core import Belief, Grid, Observation
from kbnitp_ros.files import counted
from kbnitp_ros.log.files import NAME
from kbnitp_ros.report.answers import (
    answer_tiles,
    expected_losses,
    expected_used_up,
    FREE,
    list_findings,
    loss_shares,
    metres,
    safe_cells,
    used_up_at,
)
from kbnitp_ros.report.mission import DeploymentSummary, Mission
from kbnitp_ros.report.plots import (
    as_drawn,
    cell_plot,
    curve_plots,
    map_plot,
    OBSTACLE,
    TRACES,
    WALKS,
)
from kbnitp_ros.report.tables import Curves, out_at, rows
from kbnitp_ros.styles import COUNTS, DARK_MAPS, LOST, MAPS, RETURNED, stops
import numpy as np
from numpy.typing import NDArray

# Maximum bytes of a page that can be sent by mail.
MAX_BYTES = 15_000_000

SECOND = 10**9

# Minimum likelihood, relative to the likeliest step, of a step shown as the place of a loss.
LIKELY = 0.5

TEMPLATES = Environment(
    loader=PackageLoader('kbnitp_ros.report', 'assets'),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
)


class Column(NamedTuple):
    """A column of a table."""

    heading: str
    # Key of the value in a row.
    name: str
    # Decimals; None for metres.
    decimals: int | None = 0
    is_text: bool = False
    # Whether the column is hidden on a phone.
    is_minor: bool = False

    @property
    def kind(self) -> str:
        """Return the style classes of the column."""
        return ' '.join(['text'] * self.is_text + ['minor'] * self.is_minor)

    def shown(self, value: Any) -> str:
        """Return the text of a value in a cell."""
        if value is None:
            return ''
        if self.is_text:
            return str(value)
        return metres(value) if self.decimals is None else f'{value:.{self.decimals}f}'


TABLE = (
    Column('no.', 'deployment'),
    Column('agent', 'agent', is_text=True, is_minor=True),
    Column('outcome', 'outcome', is_text=True),
    Column('steps', 'steps'),
    Column('steps survived', 'steps_survived', is_minor=True),
    Column('targets read', 'detected'),
    Column('expected (nats)', 'information_expected', 2, is_minor=True),
    Column('gained (nats)', 'information_gained', 2, is_minor=True),
    Column('entropy (nats)', 'entropy', 1),
    Column('log loss (nats)', 'log_loss', 1, is_minor=True),
    Column('reported after (s)', 'duration', 2, is_minor=True),
)

# Columns omitted if they are empty.
OPTIONAL = ('log_loss',)

PLACE = (Column('x (m)', 'x', None), Column('y (m)', 'y', None))

FINDINGS = (
    Column('what', 'kind', is_text=True),
    *PLACE,
    Column('probability', 'probability', 3),
    Column('looks', 'looks'),
    Column('target read', 'seen'),
)

SAFE = (
    *PLACE,
    Column('hazard', 'hazard', 3),
    Column('target', 'target', 3),
    Column('lost by malfunctions', 'malfunctions', 2),
)

# Columns of the table of places where a robot may have been lost.
LOSS = (*PLACE, Column('step', 'step', is_text=True), Column('lost here', 'lost', 3))

# Colour layers of the map: names in the page, and descriptions.
COLOURS = {name: f'probability of a {name}' for name in ('hazard', 'target')} | {
    'kappa': 'probability of a target in a cell with a hazard',
    'robots-lost': 'robots lost, expected',
    'used-up': 'hazards used up, expected',
}

# Layers that exist only for the last belief.
ENDS = {'robots-lost': expected_losses, 'used-up': expected_used_up}

# Maximum number of cells for which the page has the last belief in full precision.
MAX_EXACT = 10_000

# Decimals of positions on the earth; seven are a centimetre.
ON_EARTH = (
    Column('latitude (°)', 'latitude', 7),
    Column('longitude (°)', 'longitude', 7),
)


def mission_page(mission: Mission, curves: Curves, *, is_live: bool = False) -> tuple[str, str]:
    """Return the page of a mission, of at most `MAX_BYTES`, and a note on omitted moments."""
    moments = len(mission.moments)
    frames = quantised([each.belief for each in mission.moments])
    stride = 1
    while True:
        kept = np.unique([*range(0, moments, stride), moments - 1])
        left_out = ''
        if stride > 1:
            left_out = (
                f'The page shows {kept.size} of {moments} moments, one in {stride}, to stay below '
                f'{MAX_BYTES // 10**6} MB; deployments.csv and belief.npz have all moments.'
            )
        page = filled(mission, curves, frames[kept], kept, left_out, is_live)
        size = len(page.encode())
        if size <= MAX_BYTES:
            return page, left_out
        if kept.size == 2:
            raise ValueError(
                f'a page of {mission.grid.cells} cells has {size / 1e6:.1f} MB with two beliefs: '
                f'at most {MAX_BYTES / 1e6:.0f} MB are allowed'
            )
        fixed = len(library())
        stride = min(moments, max(stride + 1, int(stride * (size - fixed) / (MAX_BYTES - fixed))))


def filled(
    mission: Mission,
    curves: Curves,
    frames: NDArray[np.uint8],
    kept: NDArray[np.intp],
    left_out: str,
    is_live: bool,
) -> str:
    """Return the page with some of the moments; a live page follows its log."""
    table = rows(mission, curves)
    shown = deployments_shown(mission, kept)
    labels, panels = zip(*curve_plots(mission, curves, kept))
    north = None if mission.datum is None else pi / 2 - mission.datum.heading
    plots = {'map': map_plot(mission.grid, north=north), 'cell': cell_plot()}
    plots |= {f'curve-{number}': panel for number, panel in enumerate(panels)}
    tables = {'Versions': mission.run, **mission.parameters}
    return rendered(
        'page',
        title=f'Mission {mission_title(mission.log)}',
        is_live=is_live,
        summary=summary(mission, curves),
        tiles=list(answer_tiles(mission, curves)),
        notes=[*filter(None, [left_out]), *mission.notes],
        is_true_known=mission.world is not None,
        grid=mission.grid,
        colours=map_colours(mission),
        returned=RETURNED.colour,
        lost=LOST.colour,
        obstacle=OBSTACLE,
        finding_columns=(*FINDINGS, *(ON_EARTH if mission.datum else ())),
        findings=[vars(each) for each in list_findings(mission)],
        safe_columns=(*SAFE, *(ON_EARTH if mission.datum else ())),
        safe=safe_cells(mission),
        loss_columns=LOSS,
        is_exact=mission.grid.cells <= MAX_EXACT,
        site=mission.site,
        panels=labels,
        columns=[
            each
            for each in TABLE
            if each.name not in OPTIONAL or any(row[each.name] is not None for row in table)
        ],
        rows=[row(table[each], kept, mission.deployments[each]) for each in shown],
        configuration={
            name: {key: value_text(value) for key, value in values.items()}
            for name, values in tables.items()
            if values
        },
        mission=packed(
            json.dumps(
                page_data(mission, curves, table, kept, shown),
                separators=(',', ':'),
                allow_nan=False,
            ).encode()
        ),
        # Differences modulo 256: negative differences wrap around, as in the script of the page.
        frames=packed(np.diff(frames, axis=0, prepend=np.zeros_like(frames[:1])).tobytes()),
        plots=in_json(plots),
    )


def rendered(name: str, **values: object) -> str:
    """Render a page by its template, with the style, Plotly and the scripts."""
    return TEMPLATES.get_template(f'{name}.html').render(
        style=asset('page.css'),
        plotly=library(),
        script=asset('drawing.js') + asset(f'{name}.js'),
        **values,
    )


@cache
def library() -> str:
    """Return Plotly's script, packed by gzip, in base64."""
    script = files('kbnitp_ros.report').joinpath('assets').joinpath('plotly-cartesian.min.js.gz')
    return b64encode(script.read_bytes()).decode()


def in_json(plots: Mapping[str, str]) -> str:
    """Return plots, each in JSON, as one JSON object for a page."""
    inside = ','.join(f'{json.dumps(name)}:{plot}' for name, plot in plots.items())
    return f'{{{inside}}}'.replace('<', '\\u003c')


def mission_title(log: Path) -> str:
    """Return the name of a mission's log, or of its folder if the log has the default name."""
    path = log.resolve()
    return path.parent.name if path.name == NAME else path.name


def asset(name: str) -> str:
    """Return a file of the page that is the same for all missions."""
    return files('kbnitp_ros.report').joinpath('assets').joinpath(name).read_text(encoding='utf-8')


def deployments_shown(mission: Mission, kept: NDArray[np.intp]) -> list[int]:
    """Return the deployments listed on a page: all, or the deployments of its moments."""
    if kept.size == len(mission.moments):
        return list(range(len(mission.deployments)))
    shown = {mission.moments[place].deployment for place in kept}
    return sorted(each for each in shown if each is not None)


def summary(mission: Mission, curves: Curves) -> str:
    """Summarize a mission in a few sentences."""
    ended, entropy = mission.robots, curves.entropy
    lost = sum(not each.survived for each in ended)
    agents = len({each.key.agent for each in mission.deployments})
    unmoved = len(mission.ended) - len(ended)
    sent = len(mission.deployments) - unmoved
    share = 100.0 * entropy[-1] / entropy[0] if entropy[0] else 0.0
    words = [
        f'{counted(sent, "robot")} of {counted(agents, "agent")} went into '
        f'a field of {mission.grid.width} x {mission.grid.height} cells: '
        f'{len(ended) - lost} returned, {lost} lost.',
        f'{counted(unmoved, "robot")} came back without a step.' if unmoved else '',
        f'{share:.0f} % of the uncertainty about hazards and targets is left.',
        f'Method {mission.rules["method"]}.',
    ]
    if 'time' in mission.run:
        words.append(f'Recorded {mission.run["time"][:16].replace("T", " ")} UTC.')
    return ' '.join(filter(None, words))


def map_colours(mission: Mission) -> dict[str, str]:
    """Return the colour layers of the map."""
    return {
        name: words
        for name, words in COLOURS.items()
        if name != 'used-up' or mission.rules['dynamics'] == 'used_up'
    }


def colour_scales(mission: Mission) -> dict[str, dict[str, list[Any]]]:
    """Return the colours of each map on light paper and on a dark screen."""
    assumed = mission.assumed
    scales = {
        name: {
            'light': stops(MAPS[name], assumed[name]),
            'dark': stops(DARK_MAPS[name], assumed[name]),
        }
        for name in MAPS
    }
    counts = {theme: list(zip((0.0, 0.5, 1.0), colours)) for theme, colours in COUNTS.items()}
    return {**scales, 'robots-lost': counts, 'used-up': counts}


def page_data(
    mission: Mission,
    curves: Curves,
    table: list[dict[str, Any]],
    kept: NDArray[np.intp],
    shown: list[int],
) -> dict[str, Any]:
    """Return the data of the page besides the beliefs, as JSON values."""
    grid, world, last = mission.grid, mission.world, mission.moments[-1].belief
    colours = map_colours(mission)
    out = out_at(mission)
    needed = {*shown, *(int(each) for place in kept for each in out[place])}
    return {
        'grid': field_data(grid),
        'site': mission.site
        and {name: getattr(mission.site, name) for name in ('source', 'width', 'height')},
        'cell': int(np.argmax(last.hazard)),
        'scales': colour_scales(mission),
        'colours': colours,
        'ends': {
            name: np.round(count(mission), 4).tolist()
            for name, count in ENDS.items()
            if name in colours
        },
        'free': FREE,
        'lane': [] if mission.decision is None else mission.decision.path.tolist(),
        'assumed': mission.assumed,
        'name': mission_title(mission.log),
        'traces': TRACES,
        'walks': WALKS,
        'truth': world
        and {name: values.astype(int).tolist() for name, values in vars(world).items()},
        'exact': {name: np.round(getattr(last, name), 6).tolist() for name in NAMES}
        if grid.cells <= MAX_EXACT
        else None,
        # Longitude and latitude of each cell, as in RFC 7946.
        'earth': mission.datum.on_earth(grid.centers(range(grid.cells)))[:, ::-1].tolist()
        if mission.datum and grid.cells <= MAX_EXACT
        else None,
        # P(a step is survived) without a hazard and with one.
        'survival': mission.moments[-1].snapshot.model.survival(np.array([0.0, 1.0])).tolist(),
        'visited': np.searchsorted(kept, first_visits(mission)).tolist(),
        'deployments': {
            each: path_and_loss(mission, mission.deployments[each]) for each in sorted(needed)
        },
        'moments': [moment_data(mission, curves, table, int(each), out[each]) for each in kept],
    }


def path_and_loss(mission: Mission, deployment: DeploymentSummary) -> dict[str, Any]:
    """Return the path of a deployment, and the probability of a loss in each step."""
    seen = deployment.outcome
    is_lost = seen is not None and not seen.survived
    lost = loss_shares(mission, deployment, seen) if seen and is_lost else None
    return {
        'path': deployment.path.tolist(),
        'lost': None if lost is None else np.round(lost, 6).tolist(),
    }


def field_data(grid: Grid) -> dict[str, Any]:
    """Return the data of the field for the page."""
    corner, along, across = grid.in_metres([(0, 0), (1, 0), (0, 1)])
    x, y = as_drawn(grid).origin
    return {
        'width': grid.width,
        'height': grid.height,
        'resolution': grid.resolution,
        # The corner as drawn; the corner in the frame, and a step along and across the rows.
        'x': x,
        'y': y,
        'corner': corner.tolist(),
        'along': (along - corner).tolist(),
        'across': (across - corner).tolist(),
        'bases': sorted(grid.bases),
        'blocked': sorted(grid.blocked),
        'connectivity': grid.connectivity,
        'cutsCorners': grid.through_corners,
    }


def first_visits(mission: Mission) -> NDArray[np.intp]:
    """Return the index of the first moment after each cell's first visit; else len(moments)."""
    times = [each.time for each in mission.moments]
    first = np.full(mission.grid.cells, len(times), dtype=np.intp)
    for deployment in mission.deployments:
        known = [(deployment.path, deployment.sent or 0)]
        if deployment.outcome is not None and deployment.reported is not None:
            known.append((deployment.outcome.evidence[0], deployment.reported))
        for path, time in known:
            first[path] = np.minimum(first[path], np.searchsorted(times, time))
    return first


def moment_data(
    mission: Mission,
    curves: Curves,
    table: list[dict[str, Any]],
    place: int,
    out: NDArray[np.intp],
) -> dict[str, Any]:
    """Return the data of a moment for the page."""
    moment = mission.moments[place]
    seen, deployment = moment.outcome, moment.deployment
    walk = readings = None
    if seen is not None and seen.readings is not None and deployment is not None:
        readings = seen.readings.astype(int).tolist()
        if not np.array_equal(seen.path, mission.deployments[deployment].path):
            walk = seen.path.tolist()
    return {
        'place': place,
        'deployment': deployment,
        'survived': None if seen is None else seen.survived,
        'known': 0 if seen is None else seen.steps_survived,
        'likely': likely_steps(seen),
        'walk': walk,
        'readings': readings,
        'out': out.tolist(),
        'told': describe_moment(mission, place),
        'facts': list(moment_facts(mission, curves, table, place, out)),
    }


def likely_steps(seen: Observation | None) -> tuple[int, int] | None:
    """Return the first and last likely step of a loss; None if no step is known to be likelier."""
    if seen is None or seen.lost_at is None:
        return None
    (likely,) = np.nonzero(seen.lost_at >= LIKELY)
    return int(likely[0]), int(likely[-1]) + 1


def describe_moment(mission: Mission, place: int) -> str:
    """Return a moment in a sentence."""
    moment = mission.moments[place]
    if moment.deployment is None:
        return 'Before the first deployment.' if not moment.held else 'Where the log begins.'
    of = f'{moment.held} of {counted(len(mission.deployments), "deployment")} assimilated'
    agent = mission.deployments[moment.deployment].key.agent
    if moment.outcome is None:
        return f'{of}: the report of the last deployment, by {agent}, is not on record.'
    ending = 'returned' if moment.outcome.survived else 'was lost'
    late = ' after it had been given up' if moment.is_late and moment.outcome.survived else ''
    return f'{of}: no. {moment.deployment + 1}, {agent}, {ending}{late}.'


def moment_facts(
    mission: Mission,
    curves: Curves,
    table: list[dict[str, Any]],
    place: int,
    out: NDArray[np.intp],
) -> Iterator[tuple[str, str]]:
    """Yield the facts of a moment, as pairs of a name and a text."""
    moment = mission.moments[place]
    yield 'time', datetime.fromtimestamp(moment.time / SECOND, timezone.utc).strftime('%F %T UTC')
    if moment.deployment is not None and moment.outcome is not None:
        seen = moment.outcome
        yield 'deployment', f'no. {moment.deployment + 1} of {table[moment.deployment]["agent"]}'
        if seen.readings is not None:
            read = seen.readings.astype(int)
            yield 'outcome', f'returned after {counted(seen.steps, "step")}'
            if out_of := seen.steps - int(seen.is_entered.sum()):
                yield 'not vouched for', f'{counted(out_of, "step")}, which count for nothing'
            yield 'targets read', f'{(read == 1).sum()} in {counted((read >= 0).sum(), "look")}'
        else:
            yield 'outcome', f'lost on a path of {counted(seen.steps, "step")}'
            if seen.steps_survived:
                yield 'last contact', f'after {counted(seen.steps_survived, "step")}'
            if likely := likely_steps(seen):
                yield 'most likely lost', f'in steps {likely[0] + 1} to {likely[1]}'
        if mission.rules['dynamics'] == 'used_up' and place:
            yield 'hazards used up', f'{used_up_at(mission, place).sum():.2f} expected'
    for name, values in (('expected', curves.expected), ('gained', curves.gained)):
        if np.isfinite(values[place]):
            yield f'information {name}', f'{values[place]:.3f} nats'
    entropy = curves.hazard_entropy[place] + curves.target_entropy[place]
    yield 'entropy H(Z) + H(X)', f'{entropy:.2f} nats'
    if np.isfinite(curves.hazard_loss[place]):
        yield 'log loss', f'{curves.hazard_loss[place] + curves.target_loss[place]:.2f} nats'
    yield 'lost so far', str(curves.lost[place])
    agents = [f'{mission.deployments[each].key.agent} (no. {each + 1})' for each in out]
    yield 'out', ', '.join(agents) or 'nobody'
    for name, known in moment.state.numbers.items():
        low, _, middle, _, high = known.quantiles
        yield name.replace('_', ' '), f'{middle:.2f} ({low:.2f} to {high:.2f})'


def row(
    values: Mapping[str, Any], kept: NDArray[np.intp], deployment: DeploymentSummary
) -> dict[str, Any]:
    """Return a row of the table, with the index of its moment on the page."""
    moment = '' if deployment.moment is None else int(np.searchsorted(kept, deployment.moment))
    duration = None
    if deployment.sent is not None and deployment.reported is not None:
        duration = (deployment.reported - deployment.sent) / SECOND
    return {**values, 'moment': moment, 'duration': duration}


def value_text(value: Any) -> str:
    """Return the text of a parameter's value."""
    return value if isinstance(value, str) else json.dumps(value)


NAMES = ('hazard', 'target', 'kappa')
LEVELS = 255


def quantised(beliefs: Sequence[Belief]) -> NDArray[np.uint8]:
    """Return the three maps of beliefs in steps of 1/255, shape (beliefs, 3, cells)."""
    frames = np.empty((len(beliefs), len(NAMES), beliefs[0].cells), dtype=np.uint8)
    for frame, belief in zip(frames, beliefs):
        for level, name in zip(frame, NAMES):
            level[:] = np.rint(LEVELS * getattr(belief, name))
    return frames


def packed(data: bytes) -> str:
    """Return bytes packed by zlib, in base64."""
    return b64encode(zlib.compress(data, 6)).decode()
