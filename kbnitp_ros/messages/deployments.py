# SPDX-License-Identifier: Apache-2.0
"""Messages of a deployment: its path, its agent's status and its report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import DeploymentKey, Grid, Observation, Report
from kbnitp_ros.core.inference.record import OrderState
from kbnitp_ros.messages.grids import orientation_fields
from kbnitp_ros.messages.headers import (
    check_agent,
    check_frame,
    check_reason,
    content_hash,
    Fields,
    header,
    header_fields,
    LAST_NAME,
    MAX_REASON,
    NO_MISSION,
    read_choice,
    read_header,
    read_name,
    shown,
    to_stamp,
)
import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from kbnitp_msgs import msg
    from kbnitp_msgs.msg import DeploymentReport
    from nav_msgs.msg import Path


class Source(IntEnum):
    """The source of a report, as in kbnitp_msgs/DeploymentReport."""

    AGENT = 0
    SILENCE = 1
    OPERATOR = 2


class Acknowledged(IntEnum):
    """The kind of a message that is on record, as in kbnitp_msgs/Recorded."""

    PATH = 1
    DEPARTURE = 2
    ACTION = 3
    REPORT = 4
    ACCEPTANCE = 5
    REFUSAL = 6
    REMARK = 7


STATUS_KINDS = {
    OrderState.ACCEPTED: Acknowledged.ACCEPTANCE,
    OrderState.DEPARTED: Acknowledged.DEPARTURE,
    OrderState.REFUSED: Acknowledged.REFUSAL,
}


def path_fields(grid: Grid, cells: ArrayLike, stamp: int, mission: int) -> Fields:
    """Return the fields of the message of `path_message`."""
    begun, orientation = header_fields(mission or stamp), orientation_fields(grid.yaw)
    poses = [
        Fields(
            pose=Fields(position=Fields(x=x, y=y, z=0.0), orientation=orientation), header=begun
        )
        for x, y in grid.centers(cells).tolist()
    ]
    return Fields(header=header_fields(stamp), poses=poses)


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
    """Return the deployment of a nav_msgs/Path and the cells of its path."""
    return DeploymentKey(agent, read_path_name(message)), read_cells(grid, message)


def read_cells(grid: Grid, message: Any) -> NDArray[np.intp]:
    """Return the cells of a nav_msgs/Path."""
    positions = [pose.pose.position for pose in message.poses]
    points = np.array([(position.x, position.y) for position in positions])
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        first = np.argmin(finite)
        raise ValueError(
            f'poses[{first}].pose.position is {tuple(points[first].tolist())}: it must be finite'
        )
    return grid.cells_at(points)


def read_path_name(message: Any) -> int:
    """Return the stamp of a nav_msgs/Path, nanoseconds."""
    stamp = read_header(message, LAST_NAME)
    if not message.poses:
        raise ValueError('poses is empty: a path starts and ends at the base')
    for index, pose in enumerate(message.poses):
        check_frame(f'poses[{index}].header.frame_id', pose.header.frame_id)
    return stamp


def report_message(
    key: DeploymentKey,
    observation: Observation,
    stamp: int,
    source: Source = Source.AGENT,
    field_id: str = '',
    settled: Sequence[int] = (),
) -> DeploymentReport:
    """Return the report of a deployment that ended, with a stamp in nanoseconds."""
    from kbnitp_msgs.msg import DeploymentReport, TargetReading

    readings = () if observation.readings is None else observation.readings.tolist()
    return DeploymentReport(
        header=header(stamp),
        agent=key.agent,
        deployment=to_stamp(key.stamp),
        survived=observation.survived,
        readings=[
            TargetReading(
                cell=cell,
                detected=reading == 1,
                not_looked=reading == -1,
                not_entered=not is_entered,
            )
            for cell, reading, is_entered in zip(
                observation.path[1:].tolist(), readings, observation.is_entered.tolist()
            )
        ],
        steps_survived=observation.steps_survived,
        lost_at=[] if observation.lost_at is None else observation.lost_at.tolist(),
        settled=[*settled],
        source=source,
        field_id=field_id,
    )


def read_report(message: Any, agent: str | None = None) -> tuple[DeploymentKey, Report]:
    """Return the deployment and the report of a kbnitp_msgs/DeploymentReport."""
    stamp = read_header(message)
    if not message.agent:
        raise ValueError("agent is '': it must name the agent that was deployed")
    if agent is not None:
        check_agent(message, agent)
    key = DeploymentKey(message.agent, read_name('deployment', message.deployment))
    readings = []
    for number, each in enumerate(message.readings):
        if each.detected and each.not_looked:
            raise ValueError(
                f'readings[{number}] has detected and not_looked: at most one of them can be true'
            )
        readings.append((int(each.cell), -1 if each.not_looked else int(each.detected)))
    entered = tuple(not each.not_entered for each in message.readings)
    source = read_choice('source', message.source, Source)
    settled = tuple(int(each) for each in message.settled)
    if settled and source is not Source.OPERATOR:
        raise ValueError(
            f'settled names {len(settled)} reports and source is {source.name}: only the operator '
            'settles a deployment'
        )
    if message.survived and source is not Source.AGENT:
        raise ValueError(f'survived is true and source is {source.name}: only an agent comes back')
    return key, Report(
        bool(message.survived),
        tuple(readings),
        stamp,
        int(message.steps_survived),
        lost_at=tuple(map(float, message.lost_at)),
        entered=() if all(entered) else entered,
        field_id=message.field_id,
        settled=settled if source is Source.OPERATOR else None,
        content=content_hash(message),
    )


def hear_report(message: Any, agent: str) -> tuple[DeploymentKey, Report]:
    """Return the deployment and the report of a message, also of one that cannot be read."""
    # A robot that is back is not lost, even if its report cannot be read.
    try:
        return read_report(message, agent)
    except ValueError as error:
        check_agent(message, agent)
        return DeploymentKey(agent, read_name('deployment', message.deployment)), Report(
            bool(message.survived),
            field_id=message.field_id,
            content=content_hash(message),
            unreadable=str(error),
        )


@dataclass(frozen=True)
class AgentStatus:
    """An agent's status of an order."""

    # The state of the order.
    state: OrderState
    # Time of the status, nanoseconds.
    stamp: int
    # Reason of a refusal; empty for other states.
    reason: str = ''
    # Hash of the message, which the recorder acknowledges; a later version repeats a status with
    # another hash.
    content: int = field(default=0, compare=False)


def status_message(
    key: DeploymentKey, state: OrderState, stamp: int, reason: str = ''
) -> msg.AgentStatus:
    """Return the message of an agent's status of an order, at a time in nanoseconds."""
    from kbnitp_msgs import msg

    return msg.AgentStatus(
        header=header(stamp),
        agent=key.agent,
        deployment=to_stamp(key.stamp),
        state=state,
        reason=reason[:MAX_REASON],
    )


def read_status(message: Any, agent: str) -> tuple[DeploymentKey, AgentStatus]:
    """Return the deployment and the status of a kbnitp_msgs/AgentStatus."""
    stamp = read_header(message)
    check_agent(message, agent)
    key = DeploymentKey(agent, read_name('deployment', message.deployment))
    state = read_choice('state', message.state, OrderState)
    if (state is OrderState.REFUSED) != bool(message.reason):
        raise ValueError(
            f'reason is {shown(message.reason)} and state is {state.name}: a refused order must '
            'have a reason, and all other orders must have none'
        )
    check_reason(message.reason)
    return key, AgentStatus(state, stamp, message.reason, content_hash(message))
