# SPDX-License-Identifier: Apache-2.0
"""A whole mission without ROS: plan, traverse, update, round after round."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kbnitp_ros.core.field import (
    Belief,
    Conduct,
    Grid,
    Kind,
    OBEDIENT,
    Observation,
    of_each,
    SensorModel,
    whole_number,
    World,
)
from kbnitp_ros.core.inference import ALL_KNOWN, Estimator, Learnt, Unknowns
from kbnitp_ros.core.planning import count_visits, Plan, plan_team, team_size
import numpy as np


@dataclass(frozen=True, eq=False)
class Deployment:
    """
    One robot's part of a mission.

    Attributes
    ----------
    plan : Plan
        Where it was sent and what was expected.
    observation : Observation
        What came of it.
    belief : Belief
        Given this and all earlier deployments.
    model : SensorModel
        What robots like all others are planned with that know of these.
    parameters : mapping of str to Learnt
        What is known by then of each number that was not.

    """

    plan: Plan
    observation: Observation
    belief: Belief
    model: SensorModel
    parameters: Mapping[str, Learnt]


def run_mission(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    world: World,
    robots: int,
    rng: np.random.Generator,
    method: str = 'kappa_bnitp',
    *,
    max_steps: int = 18,
    planner: str = 'beam',
    width: int = 16,
    max_visits: int = 3,
    agents: int = 1,
    allocation: str = 'greedy',
    loss_cost: float = 0.0,
    world_model: SensorModel | None = None,
    unknowns: Unknowns = ALL_KNOWN,
    seed: int = 0,
    conduct: Conduct = OBEDIENT,
    kinds: Sequence[Kind] = (),
    objective: str = 'information',
    alpha: float = 1.0,
) -> list[Deployment]:
    """
    Deploy robots one after another (arXiv:2305.06929, Algorithm 1), or several at a time.

    The robots of a round are planned on the same belief, and their evidence is taken in in their
    order. Robot k of the mission is traversed with the k-th child of `rng`, so that its fate does
    not depend on what was drawn before, and missions that differ in their method or their teams
    share their random numbers.

    Parameters
    ----------
    grid : Grid
        The field.
    belief : Belief
        The prior.
    model : SensorModel
        What robots like all others, and their sensors, are believed to be like.
    world : World
        The hidden truth.
    robots : int
        How many are deployed, at least 0.
    rng : numpy.random.Generator
        The only source of randomness: ``rng.spawn(1)`` for each robot.
    method : str
        The estimator's, one of `METHODS`.
    max_steps, planner, width, max_visits, allocation, loss_cost, objective, alpha
        As for `plan_team`.
    agents : int
        How many leave together, from 1 to the number of free cells; fewer in the last round if
        `robots` is no multiple of it.
    world_model : SensorModel, optional
        What the robots and their sensors are really like, if not as believed.
    unknowns : Unknowns
        Which numbers of `model` and of the prior are not known. Robots are planned with what is
        known of them by then: with the estimator's model.
    seed : int
        Of the random numbers that the method draws.
    conduct : Conduct
        How the robots depart from their orders; by default they do not.
    kinds : sequence of Kind
        Of the robots of each agent, which they are like in truth as well; empty if all are alike.

    Returns
    -------
    list of Deployment
        In order.

    Raises
    ------
    ValueError
        If the world or the belief does not fit the grid, or an argument is out of range.

    """
    world.check(grid)
    estimator = Estimator(belief, model, method, unknowns, seed)
    truth = model if world_model is None else world_model
    deployments: list[Deployment] = []
    robots, agents = whole_number('robots', robots, 0), team_size(grid, agents)
    kinds = of_each(agents, kinds)
    visited = count_visits(grid, [])
    while len(deployments) < robots:
        leaving = kinds[: robots - len(deployments)]
        team = plan_team(
            grid,
            estimator.belief,
            estimator.model,
            max_steps,
            len(leaving),
            allocation,
            planner,
            width=width,
            max_visits=max_visits,
            loss_cost=loss_cost,
            kinds=leaving,
            visited=visited,
            objective=objective,
            alpha=alpha,
        )
        visited += count_visits(grid, [planned.path for planned in team.plans])
        for planned, kind in zip(team.plans, leaving):
            own = kind.model(truth)
            made = conduct.traverse(world, grid, planned.path, own, rng.spawn(1)[0])
            observation = made.observation
            estimator.assimilate(observation, kind)
            deployments.append(
                Deployment(
                    planned,
                    observation,
                    estimator.belief,
                    estimator.model,
                    estimator.parameters,
                )
            )
    return deployments
