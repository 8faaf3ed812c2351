# SPDX-License-Identifier: Apache-2.0
"""
What the two messages of a deployment mean: the path it was sent on and how it ended.

A deployment's key is its agent and the stamp of its path. The path's topic names the agent, the
report names both.
"""

from __future__ import annotations

from enum import IntEnum
from itertools import count
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import DeploymentKey, Grid, Observation, Report
from kbnitp_ros.messages.grids import orientation_fields
from kbnitp_ros.messages.headers import (
    check_frame,
    from_stamp,
    header,
    read_name,
    read_stamp,
    shown,
    to_stamp,
)
from kbnitp_ros.messages.missions import NO_MISSION
import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from kbnitp_msgs.msg import DeploymentReport
    from nav_msgs.msg import Path


class Source(IntEnum):
    """Who says how a deployment ended, as in kbnitp_msgs/DeploymentReport."""

    AGENT = 0
    SILENCE = 1
    OPERATOR = 2


def path_message(grid: Grid, cells: ArrayLike, stamp: int, mission: int = NO_MISSION) -> Path:
    """Return the message that sends an agent along `cells`."""
    from geometry_msgs.msg import PoseStamped, Quaternion
    from nav_msgs.msg import Path

    begun = header(mission or stamp)
    positions = grid.centers(cells).tolist()
    orientation = Quaternion(**vars(orientation_fields(grid.yaw)))
    poses = [PoseStamped() for _ in positions]
    for each, (x, y) in zip(poses, positions):
        each.header = begun
        each.pose.position.x, each.pose.position.y = x, y
        each.pose.orientation = orientation
    return Path(header=header(stamp), poses=poses)


def read_path(grid: Grid, agent: str, message: Any) -> tuple[DeploymentKey, NDArray[np.intp]]:
    """Return which deployment a nav_msgs/Path names and the cells it leads through."""
    stamp = read_path_name(message)
    positions = [pose.pose.position for pose in message.poses]
    points = np.array([(position.x, position.y) for position in positions])
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        first = np.argmin(finite)
        raise ValueError(
            f'poses[{first}].pose.position is {tuple(points[first].tolist())}: it must be finite'
        )
    return DeploymentKey(agent, stamp), grid.cells_at(points)


def read_path_name(message: Any) -> int:
    """Return the time that names the deployment of a nav_msgs/Path, in nanoseconds."""
    check_frame('header.frame_id', message.header.frame_id)
    if not message.poses:
        raise ValueError('poses is empty: a path starts and ends at the base')
    for index, pose in enumerate(message.poses):
        check_frame(f'poses[{index}].header.frame_id', pose.header.frame_id)
    return read_name('header.stamp', message.header.stamp)


def key_of_path(agent: str, message: Any) -> DeploymentKey:
    """Return which deployment of an agent a path names, whatever its poses are."""
    return DeploymentKey(agent, from_stamp(message.header.stamp))


def report_message(
    key: DeploymentKey, observation: Observation, stamp: int, source: Source = Source.AGENT
) -> DeploymentReport:
    """Return the message of how a deployment ended, which the base learnt at a time."""
    from kbnitp_msgs.msg import DeploymentReport, TargetReading

    readings = () if observation.readings is None else observation.readings.tolist()
    return DeploymentReport(
        header=header(stamp),
        agent=key.agent,
        deployment=to_stamp(key.stamp),
        survived=observation.survived,
        readings=[
            TargetReading(cell=cell, detected=reading == 1, not_looked=reading == -1)
            for cell, reading in zip(observation.path[1:].tolist(), readings)
        ],
        steps_survived=observation.steps_survived,
        lost_at=[] if observation.lost_at is None else observation.lost_at.tolist(),
        source=source,
    )


def read_report(message: Any, agent: str | None = None) -> tuple[DeploymentKey, Report]:
    """Return which deployment a kbnitp_msgs/DeploymentReport is about and what it says."""
    check_frame('header.frame_id', message.header.frame_id)
    if not message.agent:
        raise ValueError("agent is '': it must name the agent that was deployed")
    if agent not in (None, message.agent):
        raise ValueError(f'agent is {shown(message.agent)}: on this topic it must be {agent!r}')
    stamp = read_stamp('header.stamp', message.header.stamp)
    key = DeploymentKey(message.agent, read_name('deployment', message.deployment))
    readings = tuple(map(_read_reading, message.readings, count()))
    if message.source not in list(Source):
        raise ValueError(f'source is {message.source}: it must be from 0 to {max(Source)}')
    return key, Report(
        bool(message.survived),
        readings,
        stamp,
        int(message.steps_survived),
        lost_at=tuple(map(float, message.lost_at)),
    )


def _read_reading(message: Any, number: int) -> tuple[int, int]:
    """Return the cell and the reading of a kbnitp_msgs/TargetReading, the n-th of a report."""
    if not message.not_looked:
        return int(message.cell), int(message.detected)
    if message.detected:
        raise ValueError(
            f'readings[{number}] has detected and not_looked: nothing is detected without a look'
        )
    return int(message.cell), -1
