# SPDX-License-Identifier: Apache-2.0
"""Health of robots: battery, pose, journal, action server, clock and version."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan
from typing import Any, TYPE_CHECKING

from kbnitp_ros.messages.headers import check_agent, header, read_header, SHOWN, shown

if TYPE_CHECKING:
    from kbnitp_msgs import msg

# Fields of the message that `Health` has by the same name.
FIELDS = 'version', 'battery', 'x', 'y', 'pose_age', 'deviation', 'journal', 'server'


@dataclass(frozen=True)
class Health:
    """The health of a robot; NaN where a number is not known."""

    # Time of the message by the robot's clock, nanoseconds.
    stamp: int
    # Version of the robot's package.
    version: str
    # Charge, from 0 to 1.
    battery: float = nan
    # Place in metres, its age in seconds, and its standard deviation in metres.
    x: float = nan
    y: float = nan
    pose_age: float = nan
    deviation: float = nan
    # Whether records reach the disk, and whether the action server takes goals.
    journal: bool = True
    server: bool = True

    @property
    def recorded(self) -> tuple[str, str, bool, bool, bool]:
        """Return the values whose change is recorded, with the battery in percent."""
        charge = f'{100.0 * self.battery:.0f}'
        return self.version, charge, isnan(self.pose_age), self.journal, self.server


def health_message(agent: str, health: Health) -> msg.AgentHealth:
    """Return the message of the health of an agent's robot."""
    from kbnitp_msgs import msg

    values = {name: getattr(health, name) for name in FIELDS}
    return msg.AgentHealth(header=header(health.stamp), agent=agent, **values)


def read_health(message: Any, agent: str) -> Health:
    """Convert a kbnitp_msgs/AgentHealth of an agent."""
    stamp = read_header(message)
    check_agent(message, agent)
    if len(message.version) > SHOWN:
        raise ValueError(f'version is {shown(message.version)}: at most {SHOWN} are allowed')
    if message.battery < 0.0 or message.battery > 1.0:
        raise ValueError(f'battery is {message.battery}: it must be from 0 to 1, or NaN')
    for name in ('pose_age', 'deviation'):
        if getattr(message, name) < 0.0:
            raise ValueError(f'{name} is {getattr(message, name)}: it must be 0 or more, or NaN')
    return Health(stamp, **{name: getattr(message, name) for name in FIELDS})
