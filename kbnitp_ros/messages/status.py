# SPDX-License-Identifier: Apache-2.0
"""What the message means by which an agent says what it does with an order."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import DeploymentKey
from kbnitp_ros.messages.content import content_hash
from kbnitp_ros.messages.headers import check_frame, header, read_name, read_stamp, shown, to_stamp

if TYPE_CHECKING:
    from kbnitp_msgs import msg

# The most characters of a reason.
LONGEST_REASON = 500


class OrderState(IntEnum):
    """What becomes of an order, as in kbnitp_msgs/AgentStatus."""

    ACCEPTED = 1
    DEPARTED = 2
    REFUSED = 3


@dataclass(frozen=True)
class AgentStatus:
    """What an agent says of an order."""

    # What it does with it.
    state: OrderState
    # When it says so, in nanoseconds.
    stamp: int
    # Why the robot stays at the base, if it does; else empty.
    reason: str = ''
    # Hash of the message, by which the recorder names it.
    content: int = 0


def status_message(
    key: DeploymentKey, state: OrderState, stamp: int, reason: str = ''
) -> msg.AgentStatus:
    """Return the message of what an agent does, at a time in nanoseconds, with an order."""
    from kbnitp_msgs import msg

    return msg.AgentStatus(
        header=header(stamp),
        agent=key.agent,
        deployment=to_stamp(key.stamp),
        state=state,
        reason=reason[:LONGEST_REASON],
    )


def read_status(message: Any, agent: str) -> tuple[DeploymentKey, AgentStatus]:
    """Return which deployment a kbnitp_msgs/AgentStatus is about and what it says."""
    check_frame('header.frame_id', message.header.frame_id)
    if message.agent != agent:
        raise ValueError(f'agent is {shown(message.agent)}: on this topic it must be {agent!r}')
    stamp = read_stamp('header.stamp', message.header.stamp)
    key = DeploymentKey(agent, read_name('deployment', message.deployment))
    if message.state not in list(OrderState):
        raise ValueError(
            f'state is {message.state}: it must be from {min(OrderState)} to {max(OrderState)}'
        )
    state = OrderState(message.state)
    if (state is OrderState.REFUSED) != bool(message.reason):
        raise ValueError(
            f'reason is {shown(message.reason)} and state {state.name}: an order that is refused '
            'has a reason, and no other'
        )
    if len(message.reason) > LONGEST_REASON:
        raise ValueError(
            f'reason has {len(message.reason)} characters: it may have {LONGEST_REASON}'
        )
    return key, AgentStatus(state, stamp, message.reason, content_hash(message))
