# SPDX-License-Identifier: Apache-2.0
"""The deployments of a log, for a node that goes on with its mission."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from kbnitp_ros.bag import LoggedMessage
from kbnitp_ros.core import deployment_order, DeploymentKey, Grid, Observation, RobotType
from kbnitp_ros.log.departures import Departures
from kbnitp_ros.log.evidence import check_same_field, Evidence
from kbnitp_ros.log.roles import MissionLog, Role
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.deployments import key_of_path
from kbnitp_ros.messages.headers import from_stamp, read_stamp
from kbnitp_ros.messages.missions import mission_of_path
from kbnitp_ros.messages.operator_action import OperatorAction, read_operator_action
from kbnitp_ros.messages.status import AgentStatus, OrderState, read_status
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RecordedDeployment:
    """What a log has of a deployment."""

    # Its cells. Shape (steps + 1,).
    path: NDArray[np.intp]
    # The nav_msgs/Path, as it came off the wire.
    message: bytes
    # Hash of what it says.
    content: int
    # What came of it; None if the robot was still out.
    observation: Observation | None = None
    # When the base learnt that, in nanoseconds.
    reported: int = 0
    # What its agent said last of it; None if nothing.
    status: AgentStatus | None = None

    @property
    def is_refused(self) -> bool:
        """Whether its robot stays at the base."""
        return self.status is not None and self.status.state is OrderState.REFUSED

    @property
    def has_departed(self) -> bool:
        """Whether its robot is known to have left the base."""
        says_so = self.status is not None and self.status.state is OrderState.DEPARTED
        return says_so or self.observation is not None


class MissionRecord:
    """What a log has of a mission, to go on with: one pass over it."""

    def __init__(
        self,
        log: MissionLog,
        grid: Grid,
        max_steps: int,
        robot_types: Mapping[str, RobotType] = MappingProxyType({}),
    ) -> None:
        self.log = log
        self.prior = check_same_field(log, grid, robot_types)
        # When it began, in nanoseconds; None as long as no belief is on record.
        self.mission = read_mission(log)
        self.evidence = Evidence(grid, max_steps, robot_types)
        if self.prior:
            self.evidence.allow(self.prior.max_steps, self.prior.robot_types)
        self._departures = Departures()
        # The actions of the operator, each with its message as it came off the wire.
        self.actions: list[tuple[OperatorAction, bytes]] = []
        # The path of each deployment as it came, and the hash of what it says.
        self._sent: dict[DeploymentKey, tuple[bytes, int]] = {}
        for role, logged in log.read('path', 'report', 'status', 'operator'):
            with log.leaving_out(role, logged):
                self._take(role, logged)

    def _take(self, role: Role, logged: LoggedMessage) -> None:
        message = logged.message
        if role.name == 'operator':
            self.actions.append((read_operator_action(self.evidence.grid, message), logged.data))
        elif role.name == 'status':
            self._departures.take(*read_status(message, role.agent))
        elif is_of_mission(role, message, self.mission):
            self.evidence.take(role, logged)
            key = key_of_path(role.agent, message) if role.name == 'path' else None
            if key in self.evidence.paths:
                self._sent.setdefault(key, (logged.data, content_hash(message)))

    @property
    def deployments(self) -> dict[DeploymentKey, RecordedDeployment]:
        """Return those that the estimator takes, in the order they were made."""
        return {key: self._deployment(key) for key in sorted(self._sent, key=deployment_order)}

    def _deployment(self, key: DeploymentKey) -> RecordedDeployment:
        evidence, status = self.evidence, self._departures.status(key)
        report, path = evidence.reports.get(key), evidence.path(key)
        if report and report.survived and self._departures.is_refused(key):
            # Whoever comes back has been away.
            status = None
        if report is None or (status is not None and status.state is OrderState.REFUSED):
            return RecordedDeployment(path, *self._sent[key], status=status)
        seen = evidence.observation(key)
        return RecordedDeployment(path, *self._sent[key], seen, report.stamp, status)


def read_newest_round(
    log: MissionLog, deployments: dict[DeploymentKey, RecordedDeployment]
) -> tuple[Snapshot, list[DeploymentKey]] | None:
    """Return the recorded belief that the newest deployments were planned on, and their keys."""
    # Nobody waits for an order that was refused: no belief holds it.
    keys = [key for key, each in deployments.items() if not each.is_refused]
    planned_on = None
    for _, logged in log.read('belief'):
        held, stamp = logged.message.deployments, from_stamp(logged.message.header.stamp)
        if held < len(keys) and stamp <= keys[held].stamp:
            planned_on = logged.message
    if planned_on is None:
        return None
    snapshot = read_belief_maps(planned_on)
    first = snapshot.deployments
    newest = {*keys[first:]}
    return snapshot, [
        key
        for key, each in deployments.items()
        if key in newest or (each.is_refused and key.stamp >= snapshot.stamp)
    ]


def read_mission(log: MissionLog) -> int | None:
    """Return when the mission of a log began, in nanoseconds; None if no belief is on record."""
    stated: dict[int, None] = {}
    sent: dict[int, None] = {}
    for role, logged in log.read('belief', 'path'):
        if role.name == 'belief':
            mission = read_stamp('mission', logged.message.mission)
            stated.pop(mission, None)
            stated[mission] = None
        else:
            sent.setdefault(mission_of_path(logged.message))
        for mission in sent:
            if mission in stated:
                return mission
    return next(reversed(stated), None)


def is_of_mission(role: Role, message: Any, mission: int | None) -> bool:
    """Return whether a path or report on record can be of the mission begun at a time."""
    return mission is None or role.name != 'path' or mission_of_path(message) == mission
