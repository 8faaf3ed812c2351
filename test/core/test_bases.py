# SPDX-License-Identifier: Apache-2.0
"""Robots of several bases, against all closed paths from each."""

import brute_force
from kbnitp_ros.core import (
    ALLOCATIONS,
    Area,
    Belief,
    DeploymentKey,
    Estimator,
    Execution,
    Grid,
    Lane,
    Ledger,
    plan,
    plan_team,
    Report,
    RobotType,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Truth,
    World,
)
from kbnitp_ros.core.planning.regions import keepout_cells
from laws import for_each
import numpy as np
import pytest
from rounds import plan_round, regions_of_team

MODEL = SensorModel(0.5)
CORNERS = Grid(6, 5, base=0, blocked=(9, 27), other_bases=(29,))
HERE, THERE = RobotType(), RobotType(base=29)


def random_problem(seed):
    rng = np.random.default_rng(seed)
    width = 3 + seed % 2
    drawn = rng.permutation(width * 3).tolist()
    bases, rest = drawn[:3], drawn[3:]
    blocked = tuple(sorted(rest[: int(rng.integers(0, 3))]))
    grid = Grid(width, 3, base=bases[0], blocked=blocked, other_bases=bases[1:])
    joint = brute_force.random_joint(rng, grid.cells, bases[0])
    sensors = SensorModel(**brute_force.random_sensors(rng))
    return grid, Belief(joint).on(grid), sensors, RobotType(base=bases[int(rng.integers(3))])


@for_each('seed', range(40))
def test_a_plan_from_any_base_is_that_of_the_grid_at_this_base(seed):
    grid, belief, model, robot_type = random_problem(seed)
    options = SearchOptions(max_steps=6)
    (found,) = plan_team(grid, belief, model, Team(types=(robot_type,)), options)
    alone = plan(grid.at(robot_type.base), belief, model, SearchOptions(max_steps=6))
    assert found.path.tolist() == alone.path.tolist()
    assert (found.information, found.survival) == (alone.information, alone.survival)


def test_a_grid_at_another_base_is_the_same_field():
    grid = Grid(5, 4, base=7, blocked=(3,), other_bases=(0, 19, 7))
    assert grid.other_bases == {0, 19}
    assert grid.bases == {0, 7, 19}
    there = grid.at(19)
    assert (there.base, there.bases, there.blocked) == (19, grid.bases, grid.blocked)
    assert there.at(7) == grid.at(None) == grid.at(7) == grid
    assert grid.at(19) is there
    assert there.steps_to_base.tolist() == Grid(5, 4, base=19, blocked=(3,)).steps_to_base.tolist()
    assert np.flatnonzero(~there.may_be_hazardous).tolist() == [0, 3, 7, 19]
    assert 'other_bases=[0, 19]' in str(grid)
    assert 'other' not in str(Grid(5, 4))


def test_no_base_has_a_hazard():
    """In worlds and in the prior; otherwise both are as with one base."""
    plain = Grid(6, 5, base=0, blocked=(9, 27))
    for seed in range(50):
        world, as_before = (World.random(g, seed, 0.9, 0.8, 0.1) for g in (CORNERS, plain))
        assert not world.hazard[[0, 29]].any()
        assert world.hazard[1:29].tolist() == as_before.hazard[1:29].tolist()
        assert world.target[:29].tolist() == as_before.target[:29].tolist()
    prior, as_before = (Belief.prior(g, 0.9, 0.8, 0.8) for g in (CORNERS, plain))
    assert prior.hazard[29] == prior.hazard[0] == 0.0
    assert prior.target[29] == prior.target[0]
    assert prior.joint[:29].tolist() == as_before.joint[:29].tolist()
    hazard = np.zeros(30, dtype=bool)
    hazard[29] = True
    with pytest.raises(ValueError, match='hazard at the base 29'):
        World(hazard, hazard).check(CORNERS)
    with pytest.raises(ValueError, match='hazard of cell 29 is 1'):
        Belief.prior(CORNERS, hazard.astype(float), 0.5, 0.5)


def test_paths_from_any_base_are_recognised():
    for path in ([0, 1, 0], [29, 28, 29]):
        assert CORNERS.check_any_path(path).tolist() == path
    for path, told in (
        ([28, 29, 28], 'start at the base 0, not at cell 28'),
        ([0, 1, 29], 'end at the base 0'),
        ([29, 28, 0], 'end at the base 29'),
        ([99, 1, 99], 'leaves the grid'),
        ([], 'at least two cells'),
    ):
        with pytest.raises(ValueError, match=told):
            CORNERS.check_any_path(np.array(path, dtype=int))


@for_each('allocation', ALLOCATIONS)
def test_each_robot_of_a_mission_leaves_from_and_returns_to_its_own_base(allocation):
    belief = Belief.prior(CORNERS, 0.2, 0.3, 0.8)
    types = (HERE, THERE, RobotType(base=29, max_steps=6, true_positive=0.99))
    execution = Execution(detour=0.2, early_return=0.2, contact=0.3, camera_failure=0.1)
    for seed in range(3):
        mission = run_mission(
            CORNERS,
            belief,
            MODEL,
            World.random(CORNERS, seed, 0.2, 0.8, 0.1),
            7,
            seed,
            options=SearchOptions('beam', 9, 8),
            team=Team(3, allocation, types),
            truth=Truth(execution=execution),
        )
        bases = [0, 29, 29, 0, 29, 29, 0]
        for base, each in zip(bases, mission, strict=True):
            for path in (each.plan.path, each.observation.path):
                assert path[0] == path[-1] == base
                CORNERS.at(base).check_path(path)
        assert {0.0} == {*mission[-1].belief.hazard[[0, 29]].tolist()}


def test_the_field_is_divided_by_distance_from_the_bases():
    """Alike robots at bases on opposite ends: each has the nearer half."""
    grid = Grid(12, 3, base=12, other_bases=(23,))
    belief = Belief.prior(grid, 0.2, 0.3, 0.8)
    for types, first in (((HERE, RobotType(base=23)), 0), ((RobotType(base=23), HERE), 1)):
        owner = regions_of_team(grid, belief, MODEL, 24, 2, types).reshape(3, 12)
        assert (owner[:, :6] == first).all()
        assert (owner[:, 6:] == 1 - first).all()
    four = (HERE, RobotType(base=23), HERE, RobotType(base=23))
    owner = regions_of_team(grid, belief, MODEL, 24, 4, four)
    left, right = owner.reshape(3, 12)[:, :6], owner.reshape(3, 12)[:, 6:]
    assert set(left.ravel()) == {0, 2}
    assert set(right.ravel()) == {1, 3}


@for_each('seed', range(10))
def test_regions_hold_only_what_their_robots_reach(seed):
    rng = np.random.default_rng(seed)
    grid = Grid(15, 4, base=0, blocked=(7, 37), other_bases=(59, 30))
    belief = Belief(brute_force.random_joint(rng, 60, 0)).on(grid)
    types = tuple(
        RobotType(base=int(base), max_steps=int(rng.integers(4, 20)))
        for base in rng.choice([0, 59, 30], 4)
    )
    regions = regions_of_team(grid, belief, MODEL, 9, 4, types)
    reach = [grid.at(kind.base).in_reach(kind.max_steps) for kind in types]
    assert ((regions >= 0) == np.any(reach, axis=0)).all()
    for robot, within in enumerate(reach):
        assert within[regions == robot].all()


def test_plans_consider_robots_in_flight_from_another_base():
    belief = Belief.prior(CORNERS, 0.2, 0.3, 0.8)
    (alone,) = plan_round(CORNERS, belief, MODEL, 12, 1, types=(THERE,))
    out = [(alone.path, THERE)]
    (other,) = plan_round(CORNERS, belief, MODEL, 12, 1, types=(THERE,), in_flight=out)
    assert sorted(other.path) != sorted(alone.path)
    with pytest.raises(ValueError, match='start at the base 0, not at cell 29'):
        plan_round(CORNERS, belief, MODEL, 12, 1, in_flight=[(alone.path, HERE)])


def test_cells_around_bases_are_never_refused():
    belief, refused = Belief.prior(CORNERS, 0.2, 0.3, 0.8), []
    types, bases = (HERE, THERE), [None, 29]
    for _ in range(12):
        kept = keepout_cells(CORNERS, 12, bases, refused)
        assert not {0, 29} & set(kept.tolist())
        plans = plan_round(CORNERS, belief, MODEL, 12, 2, types=types, keepout=kept)
        assert [planned.path[0] for planned in plans] == [0, 29]
        assert all(len(set(each.path.tolist())) > 1 for each in plans)
        refused.append([each.path for each in plans])
    assert len(kept)


def test_paths_and_walks_begin_and_end_at_the_base_of_their_agent():
    register = Ledger(
        CORNERS, 6, Estimator(Belief.prior(CORNERS, 0.2, 0.3, 0.8), MODEL), {'far': THERE}
    )
    near, far = DeploymentKey('near', 1), DeploymentKey('far', 2)
    register.record_path(near, [0, 1, 0])
    with pytest.raises(ValueError, match='path must start at the base 29, not at cell 0'):
        register.record_path(far, [0, 1, 0])
    register.record_path(far, [29, 28, 29])
    with pytest.raises(ValueError, match='closed walk from the base.*end at the base 29'):
        register.record_report(far, Report(True, ((28, 1), (22, 0))))
    assert register.record_report(far, Report(True, ((28, 1), (22, 0), (29, 0))))
    assert register.outcomes[far].path.tolist() == [29, 28, 22, 29]


@for_each('goal', [Lane(17), Area((2, 3, 20, 26))])
def test_robots_of_another_base_fly_for_the_goal(goal):
    belief = Belief.prior(CORNERS, 0.2, 0.3, 0.8)
    mission = run_mission(
        CORNERS,
        belief,
        MODEL,
        World.random(CORNERS, 1, 0.2, 0.8, 0.1),
        6,
        1,
        options=SearchOptions('beam', 12, 8),
        team=Team(2, types=(HERE, THERE)),
        goal=goal,
    )
    assert [deployment.plan.path[0] for deployment in mission] == [0, 29] * 3
    if goal.name == 'lane':
        assert all(each.decision.path[0] == 0 for each in mission)
    # The goal's cells are explored: both robots enter some.
    sought = {*mission[-1].decision.cells.tolist()}
    assert all(sought & {*each.plan.path.tolist()} for each in mission)


def test_an_area_that_only_another_base_reaches_is_sought():
    line = Grid(20, 1, base=0, other_bases=(19,))
    Area((16,)).check(line, 6)
    with pytest.raises(ValueError, match='max_steps = 6, such as 10'):
        Area((10,)).check(line, 6)
