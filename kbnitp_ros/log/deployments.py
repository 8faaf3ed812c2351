# SPDX-License-Identifier: Apache-2.0
"""The deployments of a log, for a node that goes on with its mission."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from kbnitp_ros.bag import LoggedMessage, read_log, same_types
from kbnitp_ros.core import deployment_order, DeploymentKey, Grid, Observation, RobotType
from kbnitp_ros.log.departures import read_departures
from kbnitp_ros.log.evidence import BELIEF, check_same_field, Evidence, PATH, REPORT
from kbnitp_ros.messages.beliefs import read_belief_maps, Snapshot
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.deployments import key_of_path
from kbnitp_ros.messages.headers import from_stamp, read_stamp
from kbnitp_ros.messages.missions import mission_of_path
from kbnitp_ros.messages.status import AgentStatus, OrderState
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


def read_deployments(
    log: str | Path,
    grid: Grid,
    max_steps: int,
    robot_types: Mapping[str, RobotType] = MappingProxyType({}),
) -> dict[DeploymentKey, RecordedDeployment]:
    """Return the deployments on record that the estimator takes, in the order they were made."""
    belief, mission = check_same_field(log, grid, robot_types), read_mission(log)
    evidence = Evidence(grid, max_steps, robot_types)
    if belief:
        evidence.allow(belief.max_steps, belief.robot_types)
    departures = read_departures(log)
    messages: dict[DeploymentKey, tuple[bytes, int]] = {}
    with same_types(log):
        for logged in read_log(log, (PATH, REPORT)):
            if not is_of_mission(logged, mission):
                continue
            evidence.take(logged)
            if logged.type_name == PATH:
                key = key_of_path(logged.topic, logged.message)
                if key and key in evidence.paths:
                    messages.setdefault(key, (logged.data, content_hash(logged.message)))

    def deployment(key: DeploymentKey) -> RecordedDeployment:
        path, status = evidence.path(key), departures.status(key)
        report = evidence.reports.get(key)
        if report and report.survived and departures.is_refused(key):
            # Whoever comes back has been away.
            status = None
        if report is None or (status is not None and status.state is OrderState.REFUSED):
            return RecordedDeployment(path, *messages[key], status=status)
        return RecordedDeployment(
            path, *messages[key], evidence.observation(key), report.stamp, status
        )

    return {key: deployment(key) for key in sorted(evidence.paths, key=deployment_order)}


def read_newest_round(
    log: str | Path, deployments: dict[DeploymentKey, RecordedDeployment]
) -> tuple[Snapshot, list[DeploymentKey]] | None:
    """Return the recorded belief that the newest deployments were planned on, and their keys."""
    # Nobody waits for an order that was refused: no belief holds it.
    keys = [key for key, each in deployments.items() if not each.is_refused]
    planned_on = None
    with same_types(log):
        for logged in read_log(log, (BELIEF,)):
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


def read_mission(log: str | Path) -> int | None:
    """Return when the mission of a log began, in nanoseconds; None if no belief is on record."""
    stated: dict[int, None] = {}
    sent: dict[int, None] = {}
    with same_types(log):
        for logged in read_log(log, (BELIEF, PATH)):
            with suppress(ValueError):
                if logged.type_name == BELIEF:
                    mission = read_stamp('mission', logged.message.mission)
                    stated.pop(mission, None)
                    stated[mission] = None
                elif key_of_path(logged.topic, logged.message):
                    sent.setdefault(mission_of_path(logged.message))
            for mission in sent:
                if mission in stated:
                    return mission
    return next(reversed(stated), None)


def is_of_mission(logged: LoggedMessage, mission: int | None) -> bool:
    """Return whether a path or report on record can be of the mission begun at a time."""
    if mission is None or logged.type_name != PATH:
        return True
    with suppress(ValueError):
        return mission_of_path(logged.message) == mission
    return False


def read_paths(log: str | Path) -> Iterator[tuple[str, int, int, int]]:
    """Yield the topic, stamp, mission and content hash of each path on record."""
    with same_types(log):
        for logged in read_log(log, (PATH,)):
            if key := key_of_path(logged.topic, logged.message):
                with suppress(ValueError):
                    mission = mission_of_path(logged.message)
                    yield logged.topic, key.stamp, mission, content_hash(logged.message)
