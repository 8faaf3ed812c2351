# SPDX-License-Identifier: Apache-2.0
"""A recorded mission in the terms of the core."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from typing import Any, TYPE_CHECKING

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
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import LoggedMessage
from kbnitp_ros.log.record import Departures, Evidence, required_belief
from kbnitp_ros.log.roles import mission_log, MissionLog, Role, TRUTH
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.deployments import key_of_path, read_report, read_status
from kbnitp_ros.messages.grids import read_occupancy_grid
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.progress import Known, ModelState, read_decision, read_model_belief
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pandas import DataFrame

ROLES = ('belief', 'decision', 'model', 'path', 'progress', 'report', 'status', *TRUTH)


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
    # What agents said of their orders.
    departures: Departures = field(default_factory=Departures)
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
        return [self.evidence.outcomes[key] for key in ended]


def read_history(
    log: str | Path | MissionLog,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
) -> History:
    """Read what happened in a mission."""
    log = mission_log(log)
    first = required_belief(log)
    history = History(first.grid, Evidence(first.grid, first.max_steps, first.robot_types))
    truth = {}
    for role, logged in log.read(*ROLES, corrupt=history.corrupt, progress=progress):
        with log.leaving_out(role, logged):
            message = logged.message
            stamp = from_stamp(message.header.stamp)
            if role.name in ('path', 'report'):
                take_evidence(history, role, logged)
            elif role.name == 'status':
                history.departures.take(*read_status(message, role.agent))
            elif role.name == 'belief':
                take_belief(history, logged)
            elif role.name == 'model':
                history.models[stamp] = read_model_belief(message)
            elif role.name == 'decision':
                history.decision = read_decision(first.grid, message)
            elif role.name in TRUTH:
                truth[role.name] = read_truth(first.grid, message)
            elif not isnan(message.upper_bound):
                history.bounds[stamp] = message.upper_bound
    history.evidence.refused += map(str, log.left_out.values())
    if len(truth) == len(TRUTH):
        history.world = World(*(truth[name] for name in TRUTH))
    return history


def read_truth(grid: Grid, message: Any) -> NDArray[np.bool_]:
    """Return where a map of the hidden truth shows something, shape (cells,)."""
    shown = read_occupancy_grid(message) > 0.0
    if shown.size != grid.cells:
        raise ValueError(f'it has {shown.size} cells: the grid has {grid.cells}')
    return shown


def take_belief(history: History, logged: LoggedMessage) -> None:
    """Add a belief to the history."""
    snapshot = read_belief_maps(logged.message)
    if snapshot.grid != history.grid:
        raise ValueError(f'it is on {snapshot.grid}, and the first on {history.grid}')
    history.heard.append(HeardBelief(snapshot, logged.log_time, logged.position))
    history.evidence.allow(snapshot.max_steps, snapshot.robot_types)


def take_evidence(history: History, role: Role, logged: LoggedMessage) -> None:
    """Add a path or a report to the history, or note that it is refused."""
    history.evidence.take(role, logged)
    if role.name == 'path':
        key = key_of_path(role.agent, logged.message)
        if key in history.evidence.paths:
            history.sent.setdefault(key, logged.log_time)
    else:
        with suppress(ValueError):
            key, report = read_report(logged.message, role.agent)
            history.reported.setdefault((key, report.stamp), logged.log_time)
