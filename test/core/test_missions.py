# SPDX-License-Identifier: Apache-2.0
"""Whole missions without ROS: plan, deploy, learn, again."""

from kbnitp_ros.core import (
    ALLOCATIONS,
    Belief,
    Estimator,
    Grid,
    Learning,
    METHODS,
    plan_team,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Truth,
    Unknowns,
    World,
)
from laws import for_each
import numpy as np

GRID = Grid(5, 5, base=12, blocked=(3,))
MODEL = SensorModel(0.5)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
OPTIONS = SearchOptions(max_steps=8)


def test_a_mission_learns():
    """Many robots, mild hazards: entropy falls and the belief approaches the world."""
    rng = np.random.default_rng(7)
    model = SensorModel(0.3)
    world = World.random(GRID, rng, hazard_density=0.15, kappa=0.8, target_background=0.1)
    after = run_mission(GRID, PRIOR, model, world, 60, rng, options=OPTIONS)[-1].belief
    assert after.entropy() < 0.5 * PRIOR.entropy()
    reachable = np.delete(np.arange(25), 3)
    assert ((after.target > 0.5) == world.target)[reachable].mean() > 0.9


@for_each('method, team, learning', [
    *((method, Team(), Learning()) for method in METHODS),
    *(('kappa_bnitp', Team(3, allocation), Learning()) for allocation in ALLOCATIONS),
    ('kappa_bnitp_sampled', Team(), Learning(Unknowns(lethality=(0.0, 1.0)), seed=3)),
])  # fmt: skip
def test_rounds_are_planned_at_once_and_assimilated_in_order(method, team, learning):
    """Where the lethality is learnt, the prior says that hazards are harmless."""
    is_learnt = bool(learning.unknowns.priors)
    told, true = (SensorModel(0.0), SensorModel(0.9)) if is_learnt else (MODEL, MODEL)
    options = SearchOptions(max_steps=8, loss_cost=0.2)
    rng, again = np.random.default_rng(3), np.random.default_rng(3)
    world, same = (World.random(GRID, each, 0.15, 0.8, 0.1) for each in (rng, again))
    mission = run_mission(
        GRID, PRIOR, told, world, 11, rng, method, options,
        team=team, truth=Truth(true), learning=learning,
    )  # fmt: skip
    assert {deployment.observation.survived for deployment in mission} == {True, False}
    estimator = Estimator(PRIOR, told, method, learning.unknowns, learning.seed)
    left = [*mission]
    while left:
        leaving = team.first(len(left))
        for planned in plan_team(GRID, estimator.belief, estimator.model, leaving, options):
            deployment = left.pop(0)
            assert deployment.plan == planned
            assert deployment.observation == same.traverse(planned.path, true, again.spawn(1)[0])
            estimator.assimilate(deployment.observation)
            assert deployment.belief == estimator.belief
            assert deployment.model == estimator.model
            assert (deployment.model != told) == is_learnt
            assert deployment.parameters.keys() == learning.unknowns.priors.keys()
