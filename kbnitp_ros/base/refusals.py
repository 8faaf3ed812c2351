# SPDX-License-Identifier: Apache-2.0
"""How long an agent that refuses orders is left alone."""

from __future__ import annotations

import time

# Seconds after the first refusal and, since each that follows doubles it, at the most.
FIRST, LONGEST = 1.0, 60.0


class Refusals:
    """The agents that refused their last orders: another one would be refused for the same."""

    def __init__(self) -> None:
        self._pauses: dict[str, float] = {}
        self._until: dict[str, float] = {}

    def add(self, agent: str) -> None:
        """Take note that an agent refused an order."""
        pause = min(2 * self._pauses[agent], LONGEST) if agent in self._pauses else FIRST
        self._pauses[agent], self._until[agent] = pause, time.monotonic() + pause

    def clear(self, agent: str) -> None:
        """Take note that a robot of an agent departed."""
        self._pauses.pop(agent, None)
        self._until.pop(agent, None)

    def is_left_alone(self, agent: str) -> bool:
        """Return whether an agent is sent no order yet."""
        return time.monotonic() < self._until.get(agent, 0.0)
