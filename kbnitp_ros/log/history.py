# SPDX-License-Identifier: Apache-2.0
"""A recorded mission in the terms of the core."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

from kbnitp_ros.bag import LogError, LoggedMessage, read_log, same_types
from kbnitp_ros.core import (
    Belief,
    Decision,
    deployment_order,
    DeploymentKey,
    deployments_table,
    Grid,
    Observation,
    World,
)
from kbnitp_ros.log.evidence import (
    BELIEF,
    DECISION,
    Evidence,
    GRID,
    MODEL,
    PATH,
    PROGRESS,
    REPORT,
    required_belief,
)
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.decisions import read_decision
from kbnitp_ros.messages.deployments import agent_of, key_of_path, read_report
from kbnitp_ros.messages.grids import read_occupancy_grid
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.models import Known, ModelState, read_model_belief

if TYPE_CHECKING:
    from pandas import DataFrame

TYPES = (BELIEF, DECISION, GRID, MODEL, PATH, PROGRESS, REPORT)


@dataclass(frozen=True, eq=False)
class HeardBelief:
    """A belief on record."""

    # What it says.
    snapshot: Snapshot
    # When it was received, in nanoseconds.
    time: int
    # How far into the log it stands, in bytes.
    position: int


@dataclass(eq=False)
class History:
    """What a log tells of its mission."""

    # The field.
    grid: Grid
    # The deployments on record.
    evidence: Evidence
    # That of the beliefs.
    topic: str = ''
    # The beliefs on record, the prior first; what an estimator told again comes again.
    heard: list[HeardBelief] = field(default_factory=list)
    # When the path of a deployment was received, in nanoseconds.
    sent: dict[DeploymentKey, int] = field(default_factory=dict)
    # When the report of a deployment with this stamp was received, in nanoseconds.
    reported: dict[tuple[DeploymentKey, int], int] = field(default_factory=dict)
    # Learnt numbers, kinds of hazard, and model check, by the stamp of the belief, nanoseconds.
    models: dict[int, ModelState] = field(default_factory=dict)
    # What no path was worth more than given the belief of a stamp, nats, where that was computed.
    bounds: dict[int, float] = field(default_factory=dict)
    # The last one on record: what may be relied on of the goal.
    decision: Decision | None = None
    # The hidden truth, if the agent published it.
    world: World | None = None
    # Where files are corrupt: what comes after is not read.
    corrupt: list[LogError] = field(default_factory=list)

    @property
    def beliefs(self) -> list[Belief]:
        """Those on record, the prior first."""
        return [each.snapshot.belief for each in self.heard]

    def to_dataframe(self) -> DataFrame:
        """Return one row a deployment that ended, as `kbnitp_ros.core.deployments_table`."""
        first = {each.snapshot.deployments: each.snapshot.belief for each in reversed(self.heard)}
        ended = sorted(self.evidence.reports, key=deployment_order)
        beliefs = [first.get(number) for number in range(1, len(ended) + 1)]
        table = deployments_table(self.observations, beliefs, [self.world] * len(ended))
        table.insert(0, 'agent', [key.agent for key in ended])
        table.insert(1, 'stamp', [key.stamp for key in ended])
        return table

    @property
    def learnt(self) -> list[dict[str, Known]]:
        """Return what was known of the numbers that were learnt, in the order on record."""
        return [state.numbers for state in self.models.values()]

    @property
    def observations(self) -> list[Observation]:
        """Of the deployments that ended, each once: the return if a loss was reported too."""
        ended = sorted(self.evidence.reports, key=deployment_order)
        return [self.evidence.observation(key) for key in ended]


def read_history(
    path: str | Path,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
) -> History:
    """Read what happened in a mission."""
    first = required_belief(path)
    history = History(first.grid, Evidence(first.grid, first.max_steps, first.robot_types))
    truth = {}
    with same_types(path):
        for logged in progress(read_log(path, TYPES, history.corrupt)):
            with named(path, logged, history):
                if logged.type_name in (PATH, REPORT):
                    take_evidence(history, logged)
                elif logged.type_name == BELIEF:
                    take_belief(history, logged)
                elif logged.type_name == MODEL:
                    stamp = from_stamp(logged.message.header.stamp)
                    history.models[stamp] = read_model_belief(logged.message)
                elif logged.type_name == DECISION:
                    history.decision = read_decision(first.grid, logged.message)
                elif logged.type_name == PROGRESS:
                    if not isnan(logged.message.upper_bound):
                        stamp = from_stamp(logged.message.header.stamp)
                        history.bounds[stamp] = logged.message.upper_bound
                elif logged.topic.endswith(('/truth/hazard', '/truth/target')):
                    name = logged.topic.rpartition('/')[2]
                    truth[name] = read_occupancy_grid(logged.message) > 0.0
    if len(truth) == 2 and truth['hazard'].size == first.grid.cells:
        history.world = World(**truth)
    return history


@contextmanager
def named(path: str | Path, logged: LoggedMessage, history: History) -> Iterator[None]:
    """Raise a LogError that says which message it is that cannot be."""
    try:
        yield
    except ValueError as error:
        number = f'belief {len(history.heard)}' if logged.type_name == BELIEF else 'a message'
        raise LogError(f'{path}: {number} on {logged.topic} is refused: {error}') from error


def take_belief(history: History, logged: LoggedMessage) -> None:
    """Add a belief to the history."""
    snapshot = read_belief_maps(logged.message)
    history.topic = history.topic or logged.topic
    if logged.topic != history.topic:
        raise ValueError(f'there are beliefs on {history.topic} too: a log holds one mission')
    if snapshot.grid != history.grid:
        raise ValueError(f'it is on {snapshot.grid}, and the first on {history.grid}')
    history.heard.append(HeardBelief(snapshot, logged.log_time, logged.position))
    history.evidence.allow(snapshot.max_steps, snapshot.robot_types)


def take_evidence(history: History, logged: LoggedMessage) -> None:
    """Add a path or a report to the history, or note that it is refused."""
    history.evidence.take(logged)
    if logged.type_name == PATH:
        key = key_of_path(logged.topic, logged.message)
        if key in history.evidence.paths:
            history.sent.setdefault(key, logged.log_time)
    else:
        with suppress(ValueError):
            key, report = read_report(logged.message, agent_of(logged.topic))
            history.reported.setdefault((key, report.stamp), logged.log_time)
