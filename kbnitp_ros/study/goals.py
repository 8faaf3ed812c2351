# SPDX-License-Identifier: Apache-2.0
"""What the missions of a study are to make sure of, and how near they come to it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

from kbnitp_ros.core import (
    Belief,
    Decision,
    Estimator,
    Goal,
    Grid,
    HazardDraws,
    Lane,
    Plan,
    safest_path,
    SimulatedMission,
    Stop,
    World,
)
from kbnitp_ros.core.decision.decision import there_and_back
from kbnitp_ros.core.decision.goals import GOALS, Situation
import numpy as np

# What robots are sent for, besides `GOALS`, to compare these with.
SAFEST_LANE = 'safest_lane'

# The probability at which a cell is declared free of hazards.
DECLARED = 0.95

# Measured where missions are asked for a decision: the robots sent, that what is asked for is free
# as believed and in truth, how many independent draws say so, and the parts of the cells asked for
# that are declared free, and that are so in truth as well.
OF_GOALS = ('sent', 'p_free', 'free', 'independent_draws', 'declared', 'declared_free')


@dataclass(frozen=True)
class Asked:
    """The decision that missions of a study are asked for, whatever their robots are sent for."""

    # Of `GOALS`, but for 'map'.
    goal: Annotated[str, GOALS]
    # Those of the goal.
    cells: tuple[Annotated[int, (0, 999_999)], ...]
    # The probability at which missions that are sent for the goal end; 0: they do not.
    confidence: Annotated[float, (0.0, 1.0)] = 0.0

    def sought(self) -> Goal:
        """Return the goal."""
        goal = GOALS[self.goal](self.cells, self.confidence or None)
        if goal is None:
            raise ValueError('map is no decision: ask for a goal that has one')
        return goal

    def goal_of(self, sent_for: str) -> Goal | None:
        """Return the goal of missions whose robots are sent for something; None for a map."""
        if sent_for == 'map':
            return None
        if sent_for == SAFEST_LANE and self.goal == Lane.name:
            return SafestLane(self.cells[0], self.confidence or None)
        if sent_for != self.goal:
            raise ValueError(f'robots are sent for {sent_for}, and {self.goal} is asked for')
        return self.sought()

    def check(self, grid: Grid, robots: int, max_steps: int) -> None:
        """Refuse a goal that is none, or cannot be reached on a field."""
        goal = self.sought()
        goal.check(grid, max_steps)
        Stop().check(goal, robots)


class SafestLane(Lane):
    """A lane, for which robots fly out and back on the one that is safest by now."""

    def flight(self, situation: Situation) -> Plan | None:
        """Return the safest lane, there and back."""
        grid, draws, model = situation.grid, situation.draws, situation.model
        half = situation.options.max_steps // 2
        lane = safest_path(grid, draws, model, grid.base, self.to, half).path
        return situation.planned(there_and_back(lane, lane), 0.0)


def measured_for(
    asked: Asked,
    grid: Grid,
    max_steps: int,
    estimator: Estimator,
    mission: SimulatedMission,
    is_own: bool,
    beliefs: Sequence[Belief],
    worlds: Sequence[World],
) -> dict[str, Iterable[float]]:
    """Return `OF_GOALS` before the first robot and after each."""
    goal = asked.sought()

    def decide(deployments: int) -> Decision:
        draws = HazardDraws.of(estimator, deployments)
        return goal.decide(grid, draws, estimator.model, max_steps)

    decisions = [decide(0)]
    for number, deployment in enumerate(mission, 1):
        if is_own and deployment.decision is not None:
            decisions.append(deployment.decision)
        else:
            estimator.assimilate(deployment.observation)
            decisions.append(decide(number))
    cells, hazard = list(asked.cells), np.stack([world.hazard for world in worlds])
    declared = np.stack([belief.hazard[cells] <= 1.0 - DECLARED for belief in beliefs])
    return {
        'sent': range(len(decisions)),
        'p_free': [decision.p_free for decision in decisions],
        'free': [float(not true[each.cells].any()) for true, each in zip(hazard, decisions)],
        'independent_draws': [decision.independent_draws for decision in decisions],
        'declared': declared.mean(axis=1),
        'declared_free': (declared & ~hazard[:, cells]).mean(axis=1),
    }
