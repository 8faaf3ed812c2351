# SPDX-License-Identifier: Apache-2.0
"""The conditions that keep the robot of one agent at its base while others leave."""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, isnan, nan
from typing import Any, NamedTuple

from kbnitp_ros.messages.health import Health
from kbnitp_ros.messages.progress import Need

# Seconds without a message after which the health of a robot is not known; one comes each second.
MAX_AGE = 5.0


class Waiting(NamedTuple):
    """The condition that a robot waits for, and the words for people."""

    what: Need
    why: str


def percent(share: float) -> str:
    """Return a share in percent."""
    return f'{100.0 * share:.3g} %'


class Readiness:
    """The newest health of each robot of a team, and whether its agent is said to be ready."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = values
        # The health of each agent's robot, and the time of its message, seconds.
        self._health: dict[str, tuple[Health, float]] = {}
        # The last message on the ready_topic of each agent.
        self.ready: dict[str, bool] = {}

    def take(self, agent: str, health: Health, now: float) -> None:
        """Keep the health of an agent's robot."""
        self._health[agent] = health, now

    def battery(self, agent: str, now: float) -> float:
        """Return the charge of the battery of an agent's robot, from 0 to 1; NaN if unknown."""
        health, heard = self._health.get(agent, (None, now))
        return nan if health is None or now > heard + MAX_AGE else health.battery

    def distance(self, agent: str, x: float, y: float) -> float:
        """Return the distance of a robot's last place from a point, metres; NaN if unknown."""
        if agent not in self._health:
            return nan
        health, _ = self._health[agent]
        return hypot(health.x - x, health.y - y)

    def waiting(self, agent: str, now: float) -> Waiting | None:
        """Return the condition that an agent's robot waits for; None if it may leave."""
        needed = self._values.get(f'team.{agent}.min_battery', self._values['min_battery'])
        battery = self.battery(agent, now)
        if needed and isnan(battery):
            why = f'battery not known, {percent(needed)} needed'
            return Waiting(Need.BATTERY, f'{why} (parameters min_battery and battery_topic)')
        if battery < needed:
            why = f'battery {percent(battery)} of {percent(needed)}'
            return Waiting(Need.BATTERY, f'{why} (parameter min_battery)')
        if (topic := self._values['ready_topic']) and not self.ready.get(agent, False):
            said = 'says false' if agent in self.ready else 'was not published'
            return Waiting(Need.READY, f'{agent}/{topic} {said} (parameter ready_topic)')
        return None
