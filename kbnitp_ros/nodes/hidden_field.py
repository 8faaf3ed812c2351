# SPDX-License-Identifier: Apache-2.0
"""The field as it really is, which robots and time may change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import time

from kbnitp_ros.core import (
    deployment_order,
    DeploymentKey,
    Dynamics,
    Execution,
    Grid,
    SensorModel,
    Traverse,
    World,
)
import numpy as np
from numpy.typing import NDArray

# How long a robot waits for paths that may come before its own, in seconds: acknowledgements that
# were missed are asked for again after 1 s and 2 s.
PATIENCE = 5.0


class HiddenField:
    """What becomes of robots in a field, as core's run_mission has it."""

    # Hazards that change are a fold of all paths in deployment order, so a robot leaves when those
    # before it are known. Where all agents take part in each round in their order, robot n of an
    # agent, from 0, waits for n + 1 paths of each agent before it and n of each after it. An agent
    # whose robot is out or waits gets no earlier path. Of others it may never come, as at the end
    # of a mission or when agents leave one by one, so nobody waits for longer than `PATIENCE`.

    def __init__(
        self,
        grid: Grid,
        world: World,
        dynamics: Dynamics,
        execution: Execution,
        models: Mapping[str, SensorModel],
        agents: Sequence[str],
        generator: Callable[[str, int], np.random.Generator],
    ) -> None:
        # The field by now.
        self.world = world
        self._grid = grid
        self._dynamics = dynamics
        self._execution = execution
        self._models = models
        self._agents = agents
        self._generator = generator
        # Paths known, and how many of them were made, by agent; those that wait for others.
        self._known = dict.fromkeys(agents, 0)
        self._made = dict.fromkeys(agents, 0)
        self._waiting: dict[DeploymentKey, NDArray[np.intp]] = {}
        # When these became known.
        self._since: dict[DeploymentKey, float] = {}
        # Agents whose robots have left and are not back.
        self.out: set[str] = set()

    def take(self, key: DeploymentKey, path: NDArray[np.intp]) -> None:
        """Add a path."""
        if key not in self._waiting:
            self._known[key.agent] += 1
            self._waiting[key] = path
            self._since[key] = time.monotonic()

    def leaving(self) -> list[tuple[DeploymentKey, Traverse]]:
        """Return the robots that leave now, and what becomes of them."""
        leaving = []
        while self._waiting and not self.awaited:
            first = min(self._waiting, key=deployment_order)
            leaving.append((first, self._leave(first)))
        return leaving

    def pass_over(self, agent: str) -> None:
        """Count a robot whose outcome is known, where hazards stay."""
        self._known[agent] += 1
        self._made[agent] += 1

    @property
    def is_static(self) -> bool:
        """Whether hazards stay."""
        return self._dynamics.effect == 'static'

    @property
    def awaited(self) -> str:
        """Return the agent whose path the next robot waits for; empty when it waits for none."""
        if not self._waiting or self.is_static:
            return ''
        first = min(self._waiting, key=deployment_order)
        if time.monotonic() > self._since[first] + PATIENCE:
            return ''
        place, robot = self._agents.index(first.agent), self._made[first.agent]
        settled = {*self.out, *(key.agent for key in self._waiting)}
        for number, other in enumerate(self._agents):
            if self._known[other] < robot + (number < place) and other not in settled:
                return other
        return ''

    def _leave(self, key: DeploymentKey) -> Traverse:
        robot = self._made[key.agent]
        is_first = not any(self._made.values())
        path = self._waiting.pop(key)
        del self._since[key]
        made = self._execution.traverse(
            self.world,
            self._grid.at(int(path[0])),
            path,
            self._models[key.agent],
            self._generator(key.agent, robot),
            self._dynamics,
            changing=None if is_first else self._grid.may_be_hazardous,
        )
        self._made[key.agent] = robot + 1
        self.world = made.world
        return made
