# SPDX-License-Identifier: Apache-2.0
"""A mission for its report: moments, deployments, and the place of its field."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from math import ceil
from pathlib import Path
from typing import Any

from kbnitp_ros.base.said import Statement, statements
from kbnitp_ros.core import Decision, DeploymentKey, Grid, Observation, World
from kbnitp_ros.core.field.sensor import OF_HAZARDS
from kbnitp_ros.files import counted
from kbnitp_ros.log.files import log_parts, LogError
from kbnitp_ros.log.history import History, Moment, read_history
from kbnitp_ros.log.read import is_finished, LoggedMessage, RUN
from kbnitp_ros.log.record import RecordedMission
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.maps import Datum, MapError, read_site, Site
from kbnitp_ros.messages.grids import rounded_yaw
from kbnitp_ros.messages.progress import NOTHING_LEARNT
import numpy as np
from numpy.typing import NDArray

Parameters = Mapping[str, Mapping[str, Any]]

# Maximum part of a cell by which a map may exceed the field.
PART = 1e-3


def recorded_datum(parameters: Parameters) -> tuple[Datum | None, str]:
    """Return the datum of a mission, or None, and a remark if nodes had different datums."""
    given = {name: each['datum'] for name, each in parameters.items() if each.get('datum')}
    if not given:
        return None, ''
    # The datum of the estimator, if it has one.
    used = max(given, key=lambda name: 'learn.numbers' in parameters[name])
    datum = Datum.of(given[used])
    if all(each == given[used] for each in given.values()):
        return datum, ''
    listed = '; '.join(f'{name} {[*each]}' for name, each in given.items())
    return datum, (
        f'Nodes had different datums, so robots located by satellite may have been elsewhere: '
        f'{listed}. Positions on the earth are by the datum of {used}.'
    )


def map_site(parameters: Parameters, grid: Grid) -> tuple[Site | None, str]:
    """Return the image of a mission's map, or None and the reason why the map is not shown."""
    name = next((each['map'] for each in parameters.values() if each.get('map')), '')
    if not name:
        return None, ''
    try:
        site = read_site(name)
    except MapError as error:
        return None, f'The map is not shown: {error}.'
    columns, rows = (ceil(side / grid.resolution - PART) for side in (site.width, site.height))
    lies = site.origin, rounded_yaw(site.yaw), columns, rows
    if lies != (grid.origin, grid.yaw, grid.width, grid.height):
        return None, f'The map is not shown: {name} has changed, and does not match the field.'
    return site, ''


# Maximum number of refused messages listed.
REFUSALS = 5


@dataclass(frozen=True, eq=False)
class DeploymentSummary:
    """A deployment whose path is on record."""

    key: DeploymentKey
    # Cells of the path that was sent, shape (steps + 1,).
    path: NDArray[np.intp]
    # Final outcome; None without a report.
    outcome: Observation | None
    # Times at which its path and its first report were received, nanoseconds; None if unknown.
    sent: int | None
    reported: int | None
    # Index of the last moment that assimilated the report; None if no recorded belief holds it.
    moment: int | None


@dataclass(frozen=True, eq=False)
class MissionSummary:
    """The mission of a log."""

    # The log.
    log: Path
    grid: Grid
    moments: list[Moment]
    deployments: list[DeploymentSummary]
    # The hidden truth, if recorded.
    world: World | None
    # Time and versions of the run.
    run: dict[str, str]
    # Parameters of each node, by its full name.
    parameters: dict[str, dict[str, Any]]
    # Further remarks on the log.
    notes: list[str]
    # The first corrupt place of each file, where reading ends.
    corrupt: list[LogError]
    # Number of robots in flight when the log ended.
    in_flight: int
    # The last decision on the goal.
    decision: Decision | None
    # The geographic datum of the field, if recorded.
    datum: Datum | None
    # The image of the field's map, if available.
    site: Site | None
    # The statements of people, in the order in which they were said.
    said: list[Statement]

    @property
    def dynamics(self) -> str:
        """Return how hazards change, as in `Dynamics.kind`."""
        return self.moments[0].snapshot.dynamics.kind

    @property
    def assumed(self) -> dict[str, float]:
        """Return the prior mean of each map over the free cells that are not bases."""
        inside = self.grid.free.copy()
        inside[sorted(self.grid.bases)] = self.grid.cells == len(self.grid.bases)
        return {
            name: float(getattr(self.moments[0].belief, name)[inside].mean())
            for name in ('hazard', 'target', 'kappa')
        }

    @cached_property
    def numbers(self) -> dict[str, float]:
        """Return the true values of the learnable numbers, where recorded."""
        nodes = self.parameters.values()
        agent = next((each for each in nodes if 'world.kappa' in each), None)
        estimator = next((each for each in nodes if 'learn.numbers' in each), None)
        # Foreign logs may hold any parameters.
        with suppress(KeyError, TypeError):
            if self.world is not None and agent is not None and estimator is not None:
                return true_numbers(agent, estimator)
        return {}

    @property
    def ended(self) -> list[Observation]:
        """Return the outcomes of the deployments that ended."""
        return [each.outcome for each in self.deployments if each.outcome is not None]

    @property
    def robots(self) -> list[Observation]:
        """Return the outcomes that count as robots: not of those that came back without a step."""
        return [each for each in self.ended if not each.is_unmoved]

    def entered(self) -> NDArray[np.bool_]:
        """Return the cells that robots are known to have entered, and the bases, (cells,)."""
        entered = np.zeros(self.grid.cells, dtype=bool)
        entered[sorted(self.grid.bases)] = True
        for ended in self.ended:
            known = ended.steps if ended.survived else ended.steps_survived
            entered[ended.evidence[0][: known + 1]] = True
        return entered

    def visited(self) -> NDArray[np.bool_]:
        """Return the cells on the paths of robots that were sent, shape (cells,)."""
        visited = np.zeros(self.grid.cells, dtype=bool)
        for deployment in self.deployments:
            ended = deployment.outcome
            visited[deployment.path if ended is None else ended.evidence[0]] = True
        return visited


def read_summary(
    path: str | Path,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
    namespace: str | None = None,
) -> MissionSummary:
    """Return the mission of a log; `namespace` selects one of several."""
    log = MissionLog(path, namespace)
    mission = recorded_mission(log, read_history(log, progress))
    return replace(mission, notes=[*end_notes(log.path, mission.in_flight), *mission.notes])


def recorded_mission(log: MissionLog, history: History) -> MissionSummary:
    """Return the mission of a log by its history."""
    evidence, path = history.evidence, log.path
    grid = evidence.grid
    if not evidence.paths and evidence.refused:
        raise LogError(f'{path}: nothing to report; refused: {evidence.refused[0]}')
    keys = evidence.kept_orders
    moments, notes = recorded_moments(log, history, keys)
    in_flight = sum(not evidence.is_at_base(key) for key in evidence.without_report)
    metadata = history.bookmark.metadata
    parameters = log.parse_parameters(metadata)
    site, unseen = map_site(parameters, grid)
    datum, differing = recorded_datum(parameters)
    return MissionSummary(
        log=path,
        grid=grid,
        moments=moments,
        deployments=summarise_deployments(history, keys, moments),
        world=history.world,
        run=metadata.get(RUN, {}),
        parameters=parameters,
        notes=[*notes, *log_notes(history), *filter(None, [unseen, differing])],
        corrupt=history.corrupt,
        in_flight=in_flight,
        decision=history.decision,
        datum=datum,
        site=site,
        said=statements(evidence, evidence.said.values()),
    )


def recorded_moments(
    log: MissionLog, history: History, keys: Sequence[DeploymentKey]
) -> tuple[list[Moment], list[str]]:
    """Return the recorded beliefs as moments, and remarks on missing beliefs."""
    place = {key: number for number, key in enumerate(keys)}
    ends = list(accumulate(part.stat().st_size for part in log_parts(log.path)))
    is_any_left_out = any(log.roles.by_topic[topic].name == 'belief' for topic, _ in log.left_out)
    moments: list[Moment] = []
    notes = []
    taken = set()
    known: set[DeploymentKey] = set()
    before: Moment | None = None
    is_restarted = False
    for moment in history.moments:
        said = moment.snapshot
        name = said.deployments, said.newest, said.stamp
        if moments and (said.deployments < max(moments[-1].held, 1) or name in taken):
            is_restarted |= said.newest is None
            continue
        taken.add(name)
        missing = said.deployments - moments[-1].held - 1 if moments else 0
        if missing > 0:
            assert before is not None
            is_later_part = any(before.position < end <= moment.position for end in ends)
            which = f'{moments[-1].held + 1} to {said.deployments - 1}'
            if missing == 1:
                which = f'{said.deployments - 1}'
            is_begun = moments[-1].deployment is None
            if not (is_restarted or is_later_part or is_begun or is_any_left_out):
                raise LogError(
                    f'{log.path}: the belief after deployment {which} is missing, and neither the '
                    'estimator nor the recorder was restarted there, so the log was changed after '
                    'recording: replay lists its defects'
                )
            notes.append(
                f'There is no belief after deployment {which} on record: the estimator or the '
                'recorder was restarted or began later, or the belief was refused.'
            )
        moments.append(
            replace(
                moment,
                deployment=place.get(said.newest) if said.newest else None,
                outcome=reported_outcome(history.evidence, said.newest, said.stamp),
                is_late=said.newest in known,
                is_after_gap=missing > 0,
                state=history.models.get(said.stamp, NOTHING_LEARNT),
            )
        )
        if said.newest:
            known.add(said.newest)
        before, is_restarted = moment, False
    return moments, notes


def reported_outcome(
    evidence: RecordedMission, key: DeploymentKey | None, stamp: int
) -> Observation | None:
    """Return the observation reported at this stamp; None if it is not on record."""
    report = evidence.find_report(key, stamp) if key in evidence.paths else None
    if key is None or report is None:
        return None
    heard = evidence.heard[key].get(report)
    return heard.outcome if heard else None


def summarise_deployments(
    history: History, keys: Sequence[DeploymentKey], moments: Sequence[Moment]
) -> list[DeploymentSummary]:
    """Return the deployments whose path is on record."""
    evidence = history.evidence
    last = {moment.deployment: place for place, moment in enumerate(moments)}
    reported: dict[DeploymentKey, int] = {}
    for (key, _), time in evidence.reported.items():
        reported[key] = min(time, reported.get(key, time))
    # Reports during a gap of recorded beliefs are in the first belief after the gap.
    return [
        DeploymentSummary(
            key,
            evidence.paths[key],
            evidence.outcome(key),
            evidence.sent.get(key),
            reported.get(key),
            last.get(place, moment_after(moments, reported.get(key))),
        )
        for place, key in enumerate(keys)
    ]


def moment_after(moments: Sequence[Moment], time: int | None) -> int | None:
    """Return the index of the first moment at or after a time; None if there is none."""
    if time is None:
        return None
    return next((place for place, each in enumerate(moments) if each.time >= time), None)


def end_notes(log: Path, in_flight: int) -> Iterator[str]:
    """Yield remarks on the end of a log that does not grow any more."""
    if not is_finished(log):
        yield 'The log is unfinished: it was still being written, or its end is missing.'
    if in_flight:
        were = 'was' if in_flight == 1 else 'were'
        yield f'{counted(in_flight, "robot")} {were} in flight when the log ended.'


def log_notes(history: History) -> Iterator[str]:
    """Yield remarks on a log."""
    evidence = history.evidence
    if history.corrupt:
        yield f'The log was read up to its first error: {history.corrupt[0]}'
    if evidence.without_path:
        yield f'No path is on record for {counted(len(evidence.without_path), "deployment")}.'
    for key, why in evidence.held.items():
        yield f'{key} is held, and counts for nothing: {why}'
    for agent, state in history.states.items():
        field = evidence.grid.at(evidence.robot_type(DeploymentKey(agent, 0)).base)
        differs = state.difference(field)
        if words := f'says: {differs}' if differs else state.words:
            yield f'{agent or "The base"} {words}'
    for refusal in evidence.refused[:REFUSALS]:
        yield f'Refused: {refusal}'
    if len(evidence.refused) > REFUSALS:
        yield f'Refused: {len(evidence.refused) - REFUSALS} more.'


def true_numbers(agent: Mapping[str, Any], estimator: Mapping[str, Any]) -> dict[str, float]:
    """Return the true values of the learnable numbers, as far as the parameters state them."""
    numbers = {
        name: agent[f'sensor.{name}']
        for name in ('lethality', 'malfunction', 'true_positive', 'false_positive', *OF_HAZARDS)
        # Earlier logs have neither reach nor duds.
        if f'sensor.{name}' in agent
    }
    # Lethality and false negatives cannot be distinguished: scale the true lethality to the
    # believed false negatives.
    working = 1.0 - estimator['sensor.false_negative']
    if working > 0.0:
        numbers['lethality'] *= (1.0 - agent['sensor.false_negative']) / working
    if not agent['world.file']:
        for name in ('hazard_density', 'kappa', 'target_background'):
            numbers[name] = agent[f'world.{name}']
    return numbers
