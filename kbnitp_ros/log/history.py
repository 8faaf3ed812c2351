# SPDX-License-Identifier: Apache-2.0
"""A recorded mission, as objects of `kbnitp_ros.core`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from kbnitp_ros.core import Belief, Decision, Grid, Observation, ORDINARY, SensorModel, World
from kbnitp_ros.core.mission import deployments_table
from kbnitp_ros.log.files import LogError
from kbnitp_ros.log.read import Bookmark, LoggedMessage
from kbnitp_ros.log.record import RecordedMission, required_belief
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.messages.beliefs import Snapshot
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.progress import LearntNumber, ModelState, NOTHING_LEARNT, read_decision
from kbnitp_ros.messages.states import AgentState
from kbnitp_ros.messages.topics import REMARKS, TRUTH
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pandas import DataFrame

ROLES = (
    'belief',
    'decision',
    'model',
    'operator',
    'path',
    'report',
    'standings',
    'state',
    'status',
    *REMARKS,
    *TRUTH,
)


@dataclass(frozen=True, eq=False)
class Moment:
    """A recorded belief: the prior, or the belief after one report."""

    snapshot: Snapshot
    # Time at which the belief was received, nanoseconds.
    time: int
    # Position of the belief in the log, in bytes.
    position: int
    # Index of the deployment assimilated last; None for the prior.
    deployment: int | None = None
    # The outcome of this deployment; None for the prior.
    outcome: Observation | None = None
    # Whether the report replaced an earlier report of this deployment.
    is_late: bool = False
    # Whether beliefs are missing before this moment.
    is_after_gap: bool = False
    # Learnt numbers, kinds of hazard, and the check of the model.
    state: ModelState = NOTHING_LEARNT

    @property
    def belief(self) -> Belief:
        """Return the belief."""
        return self.snapshot.belief

    @property
    def held(self) -> int:
        """Return the number of deployments in the belief."""
        return self.snapshot.deployments

    def agent_model(self, agent: str) -> SensorModel:
        """Return the believed sensor model of an agent's robots."""
        own = self.snapshot.robot_types.get(agent, ORDINARY)
        return own.model(self.snapshot.model)


@dataclass(eq=False)
class History:
    """A recorded mission: deployments, beliefs, model, decision and truth."""

    # The recorded deployments.
    evidence: RecordedMission
    # The recorded beliefs, the prior first; a belief that was published twice appears twice.
    moments: list[Moment] = field(default_factory=list)
    # Learnt numbers, kinds of hazard, and model check, by the stamp of the belief, nanoseconds.
    models: dict[int, ModelState] = field(default_factory=dict)
    # The last recorded decision on the goal.
    decision: Decision | None = None
    # The last state of each agent.
    states: dict[str, AgentState] = field(default_factory=dict)
    # The maps of the hidden truth that the agent published, by role.
    truth: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    # The first corrupt place of each file, where reading ends.
    corrupt: list[LogError] = field(default_factory=list)
    # How far the log has been read.
    bookmark: Bookmark = field(default_factory=Bookmark)

    @property
    def grid(self) -> Grid:
        """Return the field."""
        return self.evidence.grid

    @property
    def world(self) -> World | None:
        """Return the hidden truth, if the agent published it."""
        hazard, target = (self.truth.get(name) for name in TRUTH)
        return None if hazard is None or target is None else World(hazard, target)

    @property
    def beliefs(self) -> list[Belief]:
        """Return the recorded beliefs, the prior first."""
        return [each.belief for each in self.moments]

    def to_dataframe(self) -> DataFrame:
        """Return `core.deployments_table` of the deployments that ended, with agent and stamp."""
        first = {each.held: each.belief for each in reversed(self.moments)}
        ended = [*self.evidence.outcomes]
        beliefs = [first.get(number) for number in range(1, len(ended) + 1)]
        table = deployments_table(self.observations, beliefs, [self.world] * len(ended))
        table.insert(0, 'agent', [key.agent for key in ended])
        table.insert(1, 'stamp', [key.stamp for key in ended])
        return table

    @property
    def learnt(self) -> list[dict[str, LearntNumber]]:
        """Return the learnt numbers after each belief, in recorded order."""
        return [state.numbers for state in self.models.values()]

    @property
    def observations(self) -> list[Observation]:
        """Return an observation for each deployment that ended; a return replaces a loss."""
        return [*self.evidence.outcomes.values()]


def read_history(
    log: str | Path | MissionLog,
    progress: Callable[[Iterator[LoggedMessage]], Iterable[LoggedMessage]] = iter,
    history: History | None = None,
) -> History:
    """Read the history of a mission; a history read earlier is continued with what is new."""
    log = log if isinstance(log, MissionLog) else MissionLog(log)
    if history is None:
        first = required_belief(log)
        history = History(RecordedMission(first.grid, first.max_steps, first.robot_types))
    evidence, grid, refused = history.evidence, history.grid, len(log.left_out)
    messages = log.read(
        *ROLES, corrupt=history.corrupt, progress=progress, bookmark=history.bookmark
    )
    for role, logged in messages:
        with log.leaving_out(logged):
            if role.name in ('operator', 'path', 'report', 'standings', 'status', *REMARKS):
                evidence.take(role, logged)
            elif role.name == 'belief':
                snapshot = logged.said
                if snapshot.grid != grid:
                    raise ValueError(f'grid is {snapshot.grid}: in the first belief it was {grid}')
                history.moments.append(Moment(snapshot, logged.log_time, logged.position))
                evidence.take(role, logged)
            elif role.name == 'model':
                history.models[from_stamp(logged.message.header.stamp)] = logged.said
            elif role.name == 'state':
                history.states[role.agent] = logged.said
            elif role.name == 'decision':
                history.decision = read_decision(grid, logged.message)
            else:
                shown = logged.said > 0.0
                if shown.size != grid.cells:
                    raise ValueError(f'it has {shown.size} cells: the grid has {grid.cells}')
                history.truth[role.name] = shown
    left_out = [f'{topic}: {why}' for (topic, _), why in log.left_out.items()]
    evidence.refused += left_out[refused:]
    return history
