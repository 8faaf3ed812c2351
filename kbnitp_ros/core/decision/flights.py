# SPDX-License-Identifier: Apache-2.0
"""The flights that a goal compares, and what each tells of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from kbnitp_ros.core.decision.decision import cheapest_lanes, LEAST, STEP_COST, there_and_back
from kbnitp_ros.core.decision.hazard_draws import Bools, Floats, HazardDraws, Path
from kbnitp_ros.core.field import Belief, binary_entropy, Grid, SensorModel
from kbnitp_ros.core.planning import Objective, PathFinder, SearchOptions
import numpy as np
from numpy.typing import ArrayLike

# The most outcomes of robots that are out which are told apart: those of the last six.
MOST_OUTCOMES = 64

# To how many of some cells, the most uncertain ones, ways there and back are compared.
DIRECT = 16
# How many paths of a search for information on all hazards, and of one for information on the
# targets as well, are compared with these.
SEARCHED = 24


class Flight(NamedTuple):
    """The path of a robot, for a goal."""

    # Shape (steps + 1,). The base first and last.
    path: Path
    # How much nearer the goal is expected to be once it is known what came of it, in the unit of
    # the goal, at least 0.
    gain: float


@dataclass(frozen=True, eq=False)
class Situation:
    """What a robot is sent on."""

    # The field, with the base of the robot.
    grid: Grid
    # The base of the mission, where lanes start.
    start: int
    # What is known of the hazards.
    draws: HazardDraws
    # What is known of the targets: P(X | Z) of each cell.
    belief: Belief
    # What the robot is believed to be like.
    model: SensorModel
    # The limits of its path, and how probably it must survive it.
    options: SearchOptions
    # Shape (outcomes, draws). The probability of each draw together with each outcome of the
    # robots that are out.
    outcomes: Floats

    def of_robot(self, base: int | None, model: SensorModel, options: SearchOptions) -> Situation:
        """Return the situation of a robot with a base, a model and limits of its own."""
        return replace(self, grid=self.grid.at(base), model=model, options=options)

    def with_sent(self, path: ArrayLike, model: SensorModel) -> Situation:
        """Return the situation once another robot, of some model, has left on a path."""
        survived = self.draws.survivals([path], model)[0]
        outcomes = np.concatenate([self.outcomes * survived, self.outcomes * (1.0 - survived)])
        if len(outcomes) > MOST_OUTCOMES:
            # That of the robot sent first, which alternates, is told apart no longer.
            outcomes = outcomes[0::2] + outcomes[1::2]
        return replace(self, outcomes=outcomes)

    def is_allowed(self, survival: Floats) -> Bools:
        """Return which paths, of these chances (paths, draws), the robot may be sent on."""
        allowed: Bools = survival @ self.draws.weight >= self.options.minimum_survival
        return allowed


def flights_over(situation: Situation, over: Sequence[int]) -> list[Path]:
    """Return closed paths for information on the field, and to some cells and back."""
    grid, draws, options = situation.grid, situation.draws, situation.options
    hazard = draws.p_hazard()
    none = np.zeros(grid.cells)
    searched = [
        candidate
        for belief in (Belief.from_maps(hazard, none, none), situation.belief)
        for candidate in PathFinder(grid, options).candidates(
            Objective.alone(grid, belief, situation.model, options)
        )[:SEARCHED]
    ]
    with np.errstate(divide='ignore'):
        cost = -np.log1p(-hazard).clip(min=LEAST) + STEP_COST
    cells = np.array(over)
    cells = cells[grid.in_reach(options.max_steps)[cells]]
    open_first = cells[np.argsort(-binary_entropy(hazard[cells]), kind='stable')]
    ends = open_first[open_first != grid.base][:DIRECT]
    costs = np.tile(cost, (ends.size, 1))
    [lanes] = cheapest_lanes(grid, costs, grid.base, ends, [options.max_steps // 2])
    direct = [there_and_back(lane, lane) for lane in lanes]
    return [each.path for each in searched] + [
        path for path in direct if np.bincount(path[1:]).max() <= options.max_visits
    ]


def information(survival: Floats, outcomes: Floats) -> Floats:
    """
    Return what the outcome of a flight tells of all hazards, nats, for each path, shape (paths,).

    Equation :eq:`outcome-information`.
    """
    known = outcomes.sum(axis=1)
    expected = survival @ (outcomes / np.where(known > 0.0, known, 1.0)[:, None]).T
    entropy: Floats = binary_entropy(expected.clip(0.0, 1.0)) @ known
    left: Floats = binary_entropy(survival.clip(0.0, 1.0)) @ outcomes.sum(axis=0)
    return np.maximum(entropy - left, 0.0)
