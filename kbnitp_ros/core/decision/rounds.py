# SPDX-License-Identifier: Apache-2.0
"""Rounds planned for a goal, and early ends of a mission."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from kbnitp_ros.core.decision.decision import Decision
from kbnitp_ros.core.decision.goals import FlightState, Goal, GOALS
from kbnitp_ros.core.decision.hazard_draws import HazardDraws, highest_confidence
from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import cost, whole_number
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import NoPathError, PathFinder
from kbnitp_ros.core.planning.plans import check_team, Plan, plan_team, Team
import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Stop:
    """
    Conditions that end a mission besides a goal.

    Parameters
    ----------
    gain : float
        Minimum expected gain for each robot that is expected to be lost; the mission stops when
        the next round promises less. In the unit of the goal: nats of information (map), nats
        about hazards in the area (area), or probability that the best lane is free (lane). 0:
        never.
    losses : int
        Number of lost robots at which the mission stops. 0: never.

    Raises
    ------
    ValueError
        If a number is out of range.

    """

    gain: float = 0.0
    losses: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'gain', cost('stop.gain', self.gain))
        object.__setattr__(self, 'losses', whole_number('stop.losses', self.losses, 0))

    def check(self, goal: Goal | None, robots: int, estimator: Estimator | None = None) -> None:
        """Check that the conditions fit each other, the mission and, if known, its estimator."""
        if self.losses > robots:
            raise ValueError(
                f'stop.losses is {self.losses}, but at most robots = {robots} are sent: '
                'lower it, or raise robots'
            )
        if goal and goal.confidence and estimator:
            check_reachable(goal.confidence, estimator)

    def why(self, decision: Decision | None, lost: int) -> str:
        """Return why the mission is over; empty if it continues."""
        if decision is not None and decision.reached:
            return (
                f'the goal {decision.goal} is reached: free of hazards with probability '
                f'{decision.p_free:.3f} (stop.confidence)'
            )
        if 0 < self.losses <= lost:
            return f'{lost} robots are lost (stop.losses)'
        return ''

    def why_not_worth(self, plans: Sequence[Plan]) -> str:
        """Return why a round gains too little for its expected losses; empty if enough."""
        gain = sum(plan.information if plan.gain is None else plan.gain for plan in plans)
        lost = sum(1.0 - plan.survival for plan in plans)
        if gain >= self.gain * lost:
            return ''
        return (
            f'the best deployment gains {gain:.3g} and loses {lost:.3g} robots: less than '
            f'{self.gain:.3g} for each (stop.gain)'
        )


def check_reachable(confidence: float, estimator: Estimator) -> None:
    """Check that the error of an estimator's probabilities allows a confidence."""
    highest = highest_confidence(estimator)
    if confidence > highest:
        by = 'draws of the hazards'
        if estimator.hypotheses is not None:
            by = f'{estimator.particles:.0f} particles of the learnt numbers'
        raise ValueError(
            f'confidence is {confidence}: with {by} the expected error of the probability is more '
            f'than half of the rest; ask for at most {np.floor(1e4 * highest) / 1e4}'
        )


# Information below this is rounding, nats.
LEAST_INFORMATION = 1e-9


def why_worthless(plans: Sequence[Plan], loss_cost: float) -> str:
    """Return why no plan's information exceeds its cost; empty if a plan's does."""
    best = max(plans, key=lambda plan: plan.information)
    if best.information < LEAST_INFORMATION:
        return f'no plan is expected to bring more than {best.information:.2g} nats'
    if any(plan.information > loss_cost * (1.0 - plan.survival) for plan in plans):
        return ''
    cost = loss_cost * (1.0 - best.survival)
    return (
        f'the best plan is expected to bring {best.information:.3g} nats and to cost '
        f'{cost:.3g} (parameter loss_cost)'
    )


def plan_round(
    goal: Goal | None,
    draws: HazardDraws | None,
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    team: Team,
    options: SearchOptions,
    *,
    in_flight: Sequence[tuple[ArrayLike, RobotType]] = (),
    visited: ArrayLike = (),
    rng: np.random.Generator | None = None,
) -> list[Plan]:
    """
    Plan a round for a goal, robot after robot, each for its gain given the earlier robots.

    Parameters
    ----------
    goal : Goal or None
        None to map the field, as `plan_team` does.
    draws : HazardDraws or None
        Draws of the hazards, if there is a goal.
    grid, belief, model, team, options, in_flight, visited, rng
        As in `plan_team`.

    Raises
    ------
    NoPathError
        If no path of a robot satisfies the options.
    ValueError
        As in `plan_team` and `check_sought`.

    """
    for_information = partial(
        plan_team,
        grid,
        belief,
        model,
        team,
        options,
        in_flight=in_flight,
        visited=visited,
        rng=rng,
    )
    for robot_type in team.types:
        check_sought(goal, options.of_type(robot_type))
    if goal is None or draws is None:
        return for_information()
    finder = PathFinder(grid, options)
    in_use = finder.grid
    check_team(finder, team.types)
    situation = FlightState(in_use, grid.base, draws, belief, model, options, draws.weight[None])
    for path, robot_type in in_flight:
        situation = situation.with_sent(path, robot_type.model(model))
    plans = []
    for robot_type in team.types:
        own = replace(
            situation,
            grid=in_use.at(robot_type.base),
            model=robot_type.model(model),
            options=options.of_type(robot_type),
        )
        with GOALS.blamed(goal.name):
            plan = goal.flight(own)
        if plan is None and options.keepout:
            # Keepout cells may block every path that serves the goal; then map the field.
            return for_information()
        if plan is None:
            raise NoPathError(
                f'no path for the goal {goal.name} was found that a robot survives with '
                f'minimum_survival = {own.options.minimum_survival} within max_steps = '
                f'{own.options.max_steps} and max_visits = {own.options.max_visits}'
            )
        own.grid.check_path(plan.path, own.options.max_steps)
        plans.append(plan)
        situation = situation.with_sent(plan.path, own.model)
    return plans


def check_sought(goal: Goal | None, options: SearchOptions) -> None:
    """Check that the options of a plan fit the goal."""
    if goal is not None and options.max_distance:
        raise ValueError(
            f'max_distance is {options.max_distance:.6g} m, but paths for the goal {goal.name} '
            'do not keep to it: choose the goal map, or leave max_distance at 0'
        )
    if goal is not None and options.objective == 'information_per_loss':
        raise ValueError(
            f'objective is {options.objective}, but paths for the goal {goal.name} are not chosen '
            'by it: choose the goal map, or the objective information'
        )
