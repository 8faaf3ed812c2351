# SPDX-License-Identifier: Apache-2.0
"""Whole missions without ROS: plan, deploy, learn, again."""

from itertools import product

from kbnitp_ros.core import (
    ALLOCATIONS,
    Belief,
    Estimator,
    Grid,
    Learning,
    METHODS,
    plan,
    PLANNERS,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Truth,
    Unknowns,
    update,
    World,
)
from laws import for_each
import numpy as np
import pytest
from rounds import plan_round

GRID = Grid(5, 5, base=12, blocked=(3,))
MODEL = SensorModel(0.5)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
OPTIONS = SearchOptions(max_steps=8)


def fly(seed, robots=12, **options):
    rng = np.random.default_rng(seed)
    world = World.random(GRID, rng, hazard_density=0.15, kappa=0.8, target_background=0.1)
    method, truth = options.pop('method', 'kappa_bnitp'), options.pop('truth', None)
    team = Team(
        **{name: options.pop(name) for name in ('agents', 'allocation') if name in options}
    )
    search = SearchOptions(**{'max_steps': 8, **options})
    made = run_mission(
        GRID, PRIOR, MODEL, world, robots, rng, method, search, team=team, truth=truth
    )
    return world, made


def trace(deployments):
    return [
        (
            d.plan.path.tobytes(),
            d.plan.information,
            d.plan.survival,
            d.observation.survived,
            d.observation.readings is not None and d.observation.readings.tobytes(),
            d.belief.joint.tobytes(),
        )
        for d in deployments
    ]


@pytest.mark.slow
@for_each('planner, method', product(PLANNERS, METHODS), every=3)
def test_the_same_seed_is_the_same_mission(method, planner):
    one, same, other = (trace(fly(s, method=method, planner=planner)[1]) for s in (1, 1, 2))
    assert one == same
    assert one != other


@for_each('method', METHODS)
def test_beliefs_are_the_fold_of_the_observations(method):
    _, deployments = fly(3, method=method)
    assert {d.observation.survived for d in deployments} == {True, False}
    estimator = Estimator(PRIOR, MODEL, method)
    for deployment in deployments:
        expected = plan(GRID, estimator.belief, MODEL, 8)
        assert deployment.plan.path.tolist() == expected.path.tolist()
        assert deployment.observation.path.tolist() == expected.path.tolist()
        assert deployment.plan.information == expected.information
        estimator.assimilate(deployment.observation)
        assert deployment.belief.joint.tobytes() == estimator.belief.joint.tobytes()


def test_a_longer_mission_begins_as_the_shorter():
    assert trace(fly(5, robots=10)[1])[:4] == trace(fly(5, robots=4)[1])


def test_the_world_may_have_other_sensors_than_believed():
    deadly = SensorModel(1.0, malfunction=1.0)
    _, deployments = fly(6, robots=5, truth=Truth(deadly))
    assert not any(d.observation.survived for d in deployments)
    belief = PRIOR
    for d in deployments:
        belief = update(belief, MODEL, d.observation)
    assert deployments[-1].belief.joint.tobytes() == belief.joint.tobytes()


def test_a_mission_learns():
    """Many robots, mild hazards: entropy falls and the belief approaches the world."""
    rng = np.random.default_rng(7)
    model = SensorModel(0.3)
    world = World.random(GRID, rng, hazard_density=0.15, kappa=0.8, target_background=0.1)
    after = run_mission(GRID, PRIOR, model, world, 60, rng, options=OPTIONS)[-1].belief
    assert after.entropy() < 0.5 * PRIOR.entropy()
    reachable = np.delete(np.arange(25), 3)
    assert ((after.target > 0.5) == world.target)[reachable].mean() > 0.9


@pytest.mark.slow
@for_each('allocation', ALLOCATIONS)
def test_a_round_is_planned_at_once_and_assimilated_in_order(allocation):
    options = {'allocation': allocation, 'loss_cost': 0.2}
    world, deployments = fly(10, robots=8, agents=3, **options)
    rng = np.random.default_rng(10)
    World.random(GRID, rng, hazard_density=0.15, kappa=0.8, target_background=0.1)
    estimator, held = Estimator(PRIOR, MODEL), iter(deployments)
    for agents in (3, 3, 2):
        team = plan_round(GRID, estimator.belief, MODEL, 8, agents, **options)
        for planned in team:
            deployment = next(held)
            assert deployment.plan.path.tolist() == planned.path.tolist()
            fate = world.traverse(planned.path, MODEL, rng.spawn(1)[0])
            assert fate.survived == deployment.observation.survived
            estimator.assimilate(fate)
            assert deployment.belief.joint.tobytes() == estimator.belief.joint.tobytes()
    assert next(held, None) is None


def test_plans_use_learnt_numbers():
    """The prior says that hazards are harmless, but not for certain."""
    rng = np.random.default_rng(5)
    world = World.random(GRID, rng, hazard_density=0.3, kappa=0.8, target_background=0.1)
    unknowns = Unknowns(lethality=(0.0, 1.0))
    told = SensorModel(0.0)
    mission = run_mission(
        GRID,
        PRIOR,
        told,
        world,
        15,
        rng,
        'kappa_bnitp_sampled',
        OPTIONS,
        truth=Truth(SensorModel(0.9)),
        learning=Learning(unknowns, seed=3),
    )
    estimator = Estimator(PRIOR, told, 'kappa_bnitp_sampled', unknowns, seed=3)
    for deployment in mission:
        best = plan(GRID, estimator.belief, estimator.model, 8)
        assert deployment.plan.path.tolist() == best.path.tolist()
        estimator.assimilate(deployment.observation)
        assert deployment.belief.joint.tobytes() == estimator.belief.joint.tobytes()
        assert deployment.model == estimator.model
        assert deployment.model.lethality != told.lethality
        assert deployment.parameters.keys() == {'lethality'}
