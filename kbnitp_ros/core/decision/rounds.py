# SPDX-License-Identifier: Apache-2.0
"""The plans of a round for a goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from kbnitp_ros.core.decision.goals import Goal, GOALS, Situation
from kbnitp_ros.core.decision.hazard_draws import HazardDraws
from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import NoPathError
from kbnitp_ros.core.planning.plans import Plan, plan_team, Team
from kbnitp_ros.core.planning.regions import without
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Less information than this is nothing, in nats: the results of updates are rounded.
LEAST_INFORMATION = 1e-9


def why_worthless(plans: Sequence[Plan], loss_cost: float) -> str:
    """Return why none of the plans of a round is worth a robot; empty if one is."""
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
    keepout: Sequence[int] | NDArray[np.intp] = (),
    bound: bool = False,
) -> list[Plan]:
    """
    Plan a round for a goal, robot after robot, each for what it adds to those before it.

    Parameters
    ----------
    goal : Goal or None
        None to map the field, as `plan_team` does.
    draws : HazardDraws or None
        What is known of the hazards, if there is a goal.
    grid, belief, model, team, options, in_flight, visited, keepout, bound
        As of `plan_team`.

    Raises
    ------
    NoPathError
        If a robot may take no path.
    ValueError
        As of `plan_team` and `check_sought`.

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
        keepout=keepout,
        bound=bound,
    )
    for robot_type in team.types:
        check_sought(goal, options.of_type(robot_type), bound)
    if goal is None or draws is None:
        return for_information()
    in_use = without(grid, keepout) if len(keepout) else grid
    situation = Situation(in_use, grid.base, draws, belief, model, options, draws.weight[None])
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
        if plan is None and len(keepout):
            # The operator keeps robots from where the goal is.
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


def check_sought(goal: Goal | None, options: SearchOptions, bound: bool) -> None:
    """Check that what is asked of a plan goes with the goal."""
    if goal is not None and options.max_distance:
        raise ValueError(
            f'max_distance is {options.max_distance:.6g} m, which paths for the goal {goal.name} '
            'do not keep: choose the goal map, or leave max_distance at 0'
        )
    if goal is not None and bound:
        raise ValueError(
            f'bound is true, which is for the most information, and the goal is {goal.name}: '
            'leave bound at false, or choose the goal map'
        )
