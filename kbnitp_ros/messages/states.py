# SPDX-License-Identifier: Apache-2.0
"""States of agents: their readiness, their fields, and whether their robots are at the base."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import Grid
from kbnitp_ros.messages.grids import (
    metadata_fields,
    read_map_metadata,
    rounded_resolution,
    rounded_yaw,
)
from kbnitp_ros.messages.headers import (
    check_agent,
    check_reason,
    filled,
    header,
    MAX_REASON,
    read_choice,
    read_header,
    shown,
)

if TYPE_CHECKING:
    from kbnitp_msgs import msg


class Readiness(IntEnum):
    """Readiness of an agent for orders, as in kbnitp_msgs/AgentState."""

    READY = 1
    WAITING = 2
    OUT = 3
    NO_JOURNAL = 4


@dataclass(frozen=True)
class AgentState:
    """The state of an agent, as it was published last."""

    # Name of the agent; '' for the base.
    agent: str
    # Time of the state, nanoseconds.
    stamp: int
    readiness: Readiness
    # Reason of the state in words; empty if it needs none.
    reason: str
    # `Grid.id` of the agent's field.
    field_id: str
    # The agent's field with its base, without blocked cells, and the number of these.
    field: Grid
    blocked: int
    # Identifier of the robot's journal; '' without one.
    journal: str
    is_at_base: bool

    @property
    def words(self) -> str:
        """Return the reason as it follows the name of the agent; empty without one."""
        verb = 'waits for' if self.readiness is Readiness.WAITING else 'says:'
        return f'{verb} {self.reason}' if self.reason else ''

    def difference(self, own: Grid) -> str:
        """Name the first parameter of the field that differs from `own`; '' if none does."""
        sides: dict[str, tuple[object, object]] = {
            name: (getattr(self.field, name), getattr(own, name))
            for name in ('width', 'height', 'origin', 'connectivity')
        }
        sides['resolution'] = self.field.resolution, rounded_resolution(own.resolution)
        sides['origin (yaw)'] = self.field.yaw, rounded_yaw(own.yaw)
        sides['corners'] = corners(self.field), corners(own)
        # Agents may have bases of their own.
        if self.agent:
            sides['base'] = self.field.base, own.base
        blocked = own.cells - int(own.free.sum())
        sides['blocked'] = f'{self.blocked} cells', f'{blocked} cells'
        if self.field_id != own.id and all(theirs == ours for theirs, ours in sides.values()):
            sides['blocked'] = f'other {self.blocked} cells', f'{blocked} cells'
        for name, (theirs, ours) in sides.items():
            if theirs != ours:
                return f'parameter grid.{name} is {theirs} there and {ours} here'
        return ''


def corners(grid: Grid) -> str:
    """Return the value of the parameter grid.corners."""
    return 'cut' if grid.through_corners else 'avoid'


def state_message(
    grid: Grid,
    agent: str,
    readiness: Readiness,
    reason: str,
    is_at_base: bool,
    stamp: int,
    journal: str = '',
) -> msg.AgentState:
    """Return the message of an agent's state on this grid, at a time in nanoseconds."""
    from kbnitp_msgs import msg

    message = msg.AgentState(
        header=header(stamp),
        agent=agent,
        state=readiness,
        reason=reason[:MAX_REASON],
        field_id=grid.id,
        base=grid.base,
        blocked=int((~grid.free).sum()),
        connectivity=grid.connectivity,
        through_corners=grid.through_corners,
        journal=journal,
        at_base=is_at_base,
    )
    filled(message.info, metadata_fields(grid))
    return message


def read_state(message: Any, agent: str) -> AgentState:
    """Convert a kbnitp_msgs/AgentState of an agent, or of the base ('')."""
    stamp = read_header(message)
    check_agent(message, agent)
    readiness = read_choice('state', message.state, Readiness)
    if readiness in (Readiness.WAITING, Readiness.NO_JOURNAL) and not message.reason:
        raise ValueError(f"reason is '' and state is {readiness.name}: it must say why")
    check_reason(message.reason)
    if not (len(message.field_id) == 16 and set(message.field_id) <= set('0123456789abcdef')):
        raise ValueError(
            f'field_id is {shown(message.field_id)}: it must be 16 hex digits, as Grid.id'
        )
    return AgentState(
        agent=agent,
        stamp=stamp,
        readiness=readiness,
        reason=message.reason,
        field_id=message.field_id,
        field=read_map_metadata(
            message.info,
            base=message.base,
            connectivity=message.connectivity,
            through_corners=message.through_corners,
        ),
        blocked=message.blocked,
        journal=message.journal,
        is_at_base=message.at_base,
    )
