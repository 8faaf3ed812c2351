# SPDX-License-Identifier: Apache-2.0
"""The facts of a mission, as values of JSON: all that its page draws."""

from __future__ import annotations

from base64 import b64encode
from collections import defaultdict
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
import json
from math import isnan, pi
from pathlib import Path
from typing import Any
import zlib

from kbnitp_ros.core import Belief, Grid, Observation
from kbnitp_ros.core.decision.decision import safest_ways
from kbnitp_ros.files import counted
from kbnitp_ros.log.files import NAME
from kbnitp_ros.messages.headers import stamp_fields
from kbnitp_ros.report.answers import (
    answer_tiles,
    expected_losses,
    expected_used_up,
    FREE,
    list_findings,
    loss_shares,
    safe_cells,
    used_up_at,
)
from kbnitp_ros.report.mission import DeploymentSummary, MissionSummary
from kbnitp_ros.report.said import contradiction_notes, said_rows
from kbnitp_ros.report.tables import Curves, out_at, rows
from kbnitp_ros.styles import COUNTS, DARK_MAPS, MAPS, SERIES, stops
import numpy as np
from numpy.typing import NDArray

SECOND = 10**9

# Minimum likelihood, relative to the likeliest step, of a step shown as the place of a loss.
LIKELY = 0.5

# Colour layers of the map: names in the page, and descriptions; used-up only if hazards can be.
COLOURS = {name: f'probability of a {name}' for name in ('hazard', 'target')} | {
    'kappa': 'probability of a target in a cell with a hazard',
    'robots-lost': 'robots lost, expected',
    'used-up': 'hazards used up, expected',
}

# Maximum number of cells of a field with the last belief in full precision and safest ways from
# its bases, and of a field with safest ways from every cell.
MAX_EXACT, MAX_STARTS = 10_000, 400

# Columns of `rows` that the page has elsewhere.
LISTS = ('path', 'walk', 'readings')

NAMES = ('hazard', 'target', 'kappa')
LEVELS = 255


def mission_facts(
    mission: MissionSummary, curves: Curves, kept: NDArray[np.intp], left_out: str = ''
) -> dict[str, Any]:
    """Return the facts of a mission, with the moments of these indices."""
    grid, world, last = mission.grid, mission.world, mission.moments[-1]
    ends = {'robots-lost': expected_losses(mission)}
    if mission.dynamics == 'used_up':
        ends['used-up'] = expected_used_up(mission)
    table, out = rows(mission, curves), out_at(mission)
    shown = deployments_shown(mission, kept)
    needed = {*shown, *(int(each) for place in kept for each in out[place])}
    is_exact = grid.cells <= MAX_EXACT
    return {
        'name': mission_title(mission.log),
        'summary': summary(mission, curves),
        'notes': [*filter(None, [left_out]), *mission.notes, *contradiction_notes(mission)],
        'tiles': list(answer_tiles(mission, curves)),
        'findings': list_findings(mission),
        'safe': safe_cells(mission),
        'said': said_rows(mission),
        'table': [on_page(table[each], kept) for each in shown],
        'configuration': configuration(mission),
        'grid': field_facts(mission),
        'site': mission.site
        and {name: getattr(mission.site, name) for name in ('source', 'width', 'height')},
        'isOnEarth': mission.datum is not None,
        'cell': int(np.argmax(last.belief.hazard)),
        'series': [{'color': each.colour, 'dash': each.plotly_dash} for each in SERIES],
        'scales': colour_scales(mission),
        'colours': {name: COLOURS[name] for name in (*NAMES, *ends)},
        # Layers that exist only for the last belief.
        'ends': {name: np.round(count, 4).tolist() for name, count in ends.items()},
        'free': FREE,
        'lane': [] if mission.decision is None else mission.decision.path.tolist(),
        'assumed': mission.assumed,
        'truth': world
        and {name: getattr(world, name).astype(int).tolist() for name in ('hazard', 'target')},
        'exact': {name: np.round(getattr(last.belief, name), 6).tolist() for name in NAMES}
        if is_exact
        else None,
        # Longitude and latitude of each cell, as in RFC 7946.
        'earth': mission.datum.on_earth(grid.centers(range(grid.cells)))[:, ::-1].tolist()
        if mission.datum and is_exact
        else None,
        'ways': ways(grid, last.belief) if is_exact else {},
        # P(a step is survived) without a hazard and with one.
        'survival': last.snapshot.model.survival(np.array([0.0, 1.0])).tolist(),
        'visited': np.searchsorted(kept, first_visits(mission)).tolist(),
        'looks': target_looks(mission),
        'deployments': {
            each: path_and_loss(mission, mission.deployments[each]) for each in sorted(needed)
        },
        'moments': [moment_facts(mission, curves, int(each), out[each]) for each in kept],
        'curves': curve_facts(curves, kept),
        'learnt': learnt_facts(mission, kept),
        'frames': frames([mission.moments[each].belief for each in kept]),
    }


def mission_title(log: Path) -> str:
    """Return the name of a mission's log, or of its folder if the log has the default name."""
    path = log.resolve()
    return path.parent.name if path.name == NAME else path.name


def configuration(mission: MissionSummary) -> dict[str, dict[str, str]]:
    """Return the versions of a run, and the parameters of its nodes, as texts."""
    tables = {'Versions': mission.run, **mission.parameters}
    return {
        name: {
            key: value if isinstance(value, str) else json.dumps(value)
            for key, value in values.items()
        }
        for name, values in tables.items()
        if values
    }


def ways(grid: Grid, belief: Belief) -> dict[int, list[int]]:
    """Return the cell before each cell on its safest way, by the first cell of the way."""
    starts = sorted(grid.bases)
    if grid.cells <= MAX_STARTS:
        starts = np.flatnonzero(grid.free).tolist()
    return dict(zip(starts, safest_ways(grid, belief.hazard, starts).tolist()))


def deployments_shown(mission: MissionSummary, kept: NDArray[np.intp]) -> list[int]:
    """Return the deployments listed on a page: all, or the deployments of its moments."""
    if kept.size == len(mission.moments):
        return list(range(len(mission.deployments)))
    shown = {mission.moments[place].deployment for place in kept}
    return sorted(each for each in shown if each is not None)


def summary(mission: MissionSummary, curves: Curves) -> str:
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
        f'Method {mission.moments[0].snapshot.method}.',
    ]
    if 'time' in mission.run:
        words.append(f'Recorded {mission.run["time"][:16].replace("T", " ")} UTC.')
    return ' '.join(filter(None, words))


def colour_scales(mission: MissionSummary) -> dict[str, dict[str, list[Any]]]:
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


def path_and_loss(mission: MissionSummary, deployment: DeploymentSummary) -> dict[str, Any]:
    """Return the name of a deployment, its path, and the probability of a loss in each step."""
    seen = deployment.outcome
    is_lost = seen is not None and not seen.survived
    lost = loss_shares(mission, deployment, seen) if seen and is_lost else None
    return {
        'agent': deployment.key.agent,
        'stamp': dict(vars(stamp_fields(deployment.key.stamp))),
        'path': deployment.path.tolist(),
        'lost': None if lost is None else np.round(lost, 6).tolist(),
    }


def field_facts(mission: MissionSummary) -> dict[str, Any]:
    """Return the field."""
    grid = mission.grid
    corner, along, across = grid.in_metres([(0, 0), (1, 0), (0, 1)])
    return {
        'width': grid.width,
        'height': grid.height,
        'resolution': grid.resolution,
        'yaw': grid.yaw,
        # Direction of north in the frame, rad from its x axis.
        'north': None if mission.datum is None else pi / 2 - mission.datum.heading,
        # The corner in the frame, and a step along and across the rows.
        'corner': corner.tolist(),
        'along': (along - corner).tolist(),
        'across': (across - corner).tolist(),
        'bases': sorted(grid.bases),
        'blocked': sorted(grid.blocked),
    }


def first_visits(mission: MissionSummary) -> NDArray[np.intp]:
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


def target_looks(mission: MissionSummary) -> dict[int, list[tuple[int, int]]] | None:
    """Return the readings of each cell with their moments; None if targets are static."""
    if mission.moments[0].snapshot.target_dynamics.effect == 'static':
        return None
    looks = defaultdict[int, list[tuple[int, int]]](list)
    for place, moment in enumerate(mission.moments):
        if moment.outcome is None:
            continue
        path, readings = moment.outcome.evidence
        for cell, reading in zip(path[1:].tolist(), [] if readings is None else readings.tolist()):
            if reading >= 0:
                looks[cell].append((place, int(reading)))
    return looks


def moment_facts(
    mission: MissionSummary, curves: Curves, place: int, out: NDArray[np.intp]
) -> dict[str, Any]:
    """Return a moment."""
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
        'facts': list(described_facts(mission, curves, place, out)),
    }


def likely_steps(seen: Observation | None) -> tuple[int, int] | None:
    """Return the first and last likely step of a loss; None if no step is known to be likelier."""
    if seen is None or seen.lost_at is None:
        return None
    (likely,) = np.nonzero(seen.lost_at >= LIKELY)
    return int(likely[0]), int(likely[-1]) + 1


def describe_moment(mission: MissionSummary, place: int) -> str:
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


def described_facts(
    mission: MissionSummary, curves: Curves, place: int, out: NDArray[np.intp]
) -> Iterator[tuple[str, str]]:
    """Yield the facts of a moment, as pairs of a name and a text."""
    moment = mission.moments[place]
    yield 'time', datetime.fromtimestamp(moment.time / SECOND, timezone.utc).strftime('%F %T UTC')
    if moment.deployment is not None and moment.outcome is not None:
        seen = moment.outcome
        agent = mission.deployments[moment.deployment].key.agent
        yield 'deployment', f'no. {moment.deployment + 1} of {agent}'
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
        if mission.dynamics == 'used_up' and place:
            yield 'hazards used up', f'{used_up_at(mission, place).sum():.2f} expected'
    for name, values in (('expected', curves.expected), ('gained', curves.gained)):
        if np.isfinite(values[place]):
            yield f'information {name}', f'{values[place]:.3f} nats'
    yield 'entropy H(Z) + H(X)', f'{curves.entropy[place]:.2f} nats'
    if np.isfinite(curves.log_loss[place]):
        yield 'log loss', f'{curves.log_loss[place]:.2f} nats'
    yield 'lost so far', str(curves.lost[place])
    agents = [f'{mission.deployments[each].key.agent} (no. {each + 1})' for each in out]
    yield 'out', ', '.join(agents) or 'nobody'
    for name, number in moment.state.numbers.items():
        low, _, middle, _, high = number.quantiles
        yield name.replace('_', ' '), f'{middle:.2f} ({low:.2f} to {high:.2f})'


def on_page(row: dict[str, Any], kept: NDArray[np.intp]) -> dict[str, Any]:
    """Return a row of the table, with the index of its moment on the page."""
    moment, sent, told = row['moment'], row['sent'], row['told']
    return {
        **{name: value for name, value in row.items() if name not in LISTS},
        'moment': None if moment is None else int(np.searchsorted(kept, moment)),
        'duration': None if sent is None or told is None else (told - sent) / SECOND,
    }


def curve_facts(curves: Curves, kept: NDArray[np.intp]) -> dict[str, list[float | None]]:
    """Return the known curves at these moments; information is added up."""
    values = {
        **vars(curves),
        'entropy': curves.entropy,
        'expected': np.nancumsum(curves.expected),
        'gained': np.nancumsum(curves.gained),
    }
    return {name: known(each[kept]) for name, each in values.items() if not np.isnan(each).all()}


def known(values: NDArray[Any]) -> list[float | None]:
    """Return numbers for JSON, None for NaN."""
    return [None if isnan(value) else value for value in values.tolist()]


def learnt_facts(mission: MissionSummary, kept: NDArray[np.intp]) -> dict[str, dict[str, Any]]:
    """Return the curves of the learnt numbers, and their true values."""
    facts = {}
    for name in mission.moments[-1].state.numbers:
        numbers = [mission.moments[place].state.numbers.get(name) for place in kept]
        quantiles = np.array([each.quantiles if each else [np.nan] * 5 for each in numbers])
        facts[name] = {
            'low': known(quantiles[:, 0]),
            'middle': known(quantiles[:, 2]),
            'high': known(quantiles[:, 4]),
            'truth': mission.numbers.get(name),
        }
    return facts


def frames(beliefs: Sequence[Belief]) -> str:
    """Return the three maps of beliefs in steps of 1/255, each less the one before, packed."""
    levels = np.empty((len(beliefs), len(NAMES), beliefs[0].cells), dtype=np.uint8)
    for frame, belief in zip(levels, beliefs):
        for level, name in zip(frame, NAMES):
            level[:] = np.rint(LEVELS * getattr(belief, name))
    # Differences modulo 256: negative differences wrap around, as in the script of the page.
    return packed(np.diff(levels, axis=0, prepend=np.zeros_like(levels[:1])).tobytes())


def packed(data: bytes) -> str:
    """Return bytes packed by zlib, in base64."""
    return b64encode(zlib.compress(data, 6)).decode()
