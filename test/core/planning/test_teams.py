# SPDX-License-Identifier: Apache-2.0
"""Robots in flight together, of one or several types, against all states and outcomes."""

from itertools import product

import brute_force
from documented import rows, words
from kbnitp_ros.core import (
    ALLOCATIONS,
    Belief,
    Grid,
    path_information,
    plan,
    RobotType,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    team_information,
    World,
)
from kbnitp_ros.core.planning import objective as joint_outcomes
from kbnitp_ros.core.planning import objective as readings
from kbnitp_ros.core.planning.objective import after_deployment, nobody_deployed
from laws import for_each
import numpy as np
import pytest
from rounds import every_path, plan_round, random_problem, regions_of_team

GRID = Grid(6, 5, base=8, blocked=(3, 9, 27))
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
MODEL = SensorModel(0.5)


def count_visits(path, cells):
    return np.bincount(path[1:], minlength=cells)


def few_paths(seed):
    rng = np.random.default_rng(seed)
    joint, sensors = brute_force.random_joint(rng, 4, 0), brute_force.random_sensors(rng)
    robots = 2 + seed % 2
    steps = rng.integers(1, 7 - robots, robots)
    return (
        joint,
        SensorModel(**sensors),
        [brute_force.random_path(rng, 2, 2, 0, int(n)) for n in steps],
    )


def random_belief(seed, grid=GRID):
    joint = brute_force.random_joint(np.random.default_rng(seed), grid.cells, grid.base)
    joint[~grid.free] = [[1, 0], [0, 0]]
    return Belief(joint)


@pytest.mark.slow
@pytest.mark.parametrize('cases', [60, pytest.param(600, marks=pytest.mark.full)])
def test_team_information_is_nearly_the_joint_information(cases):
    above = np.zeros(cases)
    for seed in range(cases):
        joint, model, paths = few_paths(seed)
        exact = brute_force.joint_information(joint, [model] * len(paths), paths)
        above[seed] = team_information(Belief(joint), model, paths) / exact - 1
    far = (above > 0.03).sum()
    print(
        f'in {cases} cases {above.mean():.1%} above on average, more than 3 % above in {far}, '
        f'at most {above.max():.0%}, at least {above.min():.0%}'
    )
    assert above.min() > -1e-9
    if cases < 600:
        return
    assert far == 3
    page = words('docs/mathematics/plans.md')
    assert f'in {cases} random small cases it was never below' in page
    assert f'{100 * above.mean():.1f} % above on average, and more than 3 % above in three' in page
    assert f'up to {100 * above.max():.0f} %' in page


@for_each('seed', range(20))
def test_joint_outcomes_average_to_the_belief(seed):
    """Averaged over joint outcomes, the hazards are the prior's, with and without merging."""
    rng, belief = np.random.default_rng(seed), random_belief(seed)
    model = SensorModel(**brute_force.random_sensors(rng))
    after = joint_outcomes.nobody_deployed(belief)
    for _ in range(7):
        path = brute_force.random_path(rng, 6, 5, 8, 6)
        after = joint_outcomes.after_deployment(after, model, path)
    assert after.probability.size <= joint_outcomes.MAX_OUTCOMES
    assert after.probability.sum() == pytest.approx(1, abs=1e-9)
    joint, _ = after.of_cells(np.arange(belief.cells))
    hazard = after.probability @ joint[:, :, 1].sum(axis=-1)
    np.testing.assert_allclose(hazard, belief.hazard, rtol=0, atol=1e-9)


@for_each('seed', range(5))
def test_merging_the_least_probable_fates_changes_little(seed, monkeypatch):
    belief = random_belief(seed)
    paths = [p.path for p in plan_round(GRID, belief, MODEL, 8, 7, 'voronoi', 'relaxed')]
    merged = team_information(belief, MODEL, paths)
    monkeypatch.setattr(joint_outcomes, 'MAX_OUTCOMES', 256)
    assert merged == pytest.approx(team_information(belief, MODEL, paths), rel=0.03)


def shares_of_the_best(grid, belief, model, steps):
    """Return the joint information of each allocation's pair, relative to the best pair."""

    def of_pairs(visits):
        return brute_force.information_of_pairs(belief.joint, model, visits)

    found = {}
    for allocation in ALLOCATIONS:
        plans = plan_round(grid, belief, model, steps, 2, allocation)
        found[allocation] = of_pairs(np.array([count_visits(p.path, 16) for p in plans]))[0, 1]
    visits = every_path(grid.base, steps)
    alone = brute_force.information_of_visits(belief.joint, model, visits)
    # A pair has at most the sum of its values, so a poor path is in no best pair.
    worthy = alone + alone.max() >= max(found.values()) - 1e-9
    best = of_pairs(visits[worthy]).max()
    return {allocation: information / best for allocation, information in found.items()}


@pytest.mark.slow
@for_each('steps', [4, 5], every=2)
def test_greedy_comes_close_to_the_best_of_all_pairs(steps):
    shares = [shares_of_the_best(*random_problem(seed), steps) for seed in range(30)]
    page = rows('docs/mathematics/plans.md', f'{steps} steps, least')
    place = 2 * (steps - 4)
    for allocation in ALLOCATIONS:
        of_best = [share[allocation] for share in shares]
        figures = [f'{min(of_best):.3f}', f'{np.mean(of_best):.3f}']
        print(f'{allocation}, {steps} steps: {figures[0]}, on average {figures[1]}')
        assert max(of_best) <= 1 + 1e-9
        if allocation in page:
            assert figures == page[allocation][place:][:2]
    assert min(share['greedy'] for share in shares) >= 0.92


def test_independent_robots_take_the_same_path():
    alone = plan(GRID, PRIOR, MODEL, SearchOptions(max_steps=8)).path.tolist()
    team = plan_round(GRID, PRIOR, MODEL, 8, 3, 'independent')
    assert [planned.path.tolist() for planned in team] == [alone] * 3


@for_each('agents, base', product([1, 2, 3, 8], [0, 40]))
def test_regions_divide_the_free_cells_evenly(base, agents):
    grid = Grid(9, 9, base=base, blocked=(13, 14, 22))
    for belief in (Belief.prior(grid, 0.5, 0.45, 0.8), random_belief(agents, grid)):
        regions = regions_of_team(grid, belief, MODEL, 18, agents)
        assert (regions[[13, 14, 22]] == -1).all()
        assert set(np.delete(regions, [13, 14, 22]).tolist()) == set(range(agents))
        each = [Belief(belief.joint[regions == r]).joint_entropy() for r in range(agents)]
        assert max(each) - np.mean(each) <= 1.5  # nats, of about one cell


def test_regions_are_the_same_in_a_larger_field():
    """Cells out of reach are ignored: the cost of regions depends on the cells in reach."""
    small, large = Grid(9, 9, base=40), Grid(60, 50, base=24 * 60 + 34)
    inside = (np.arange(20, 29)[:, None] * 60 + np.arange(30, 39)).ravel()
    near = random_belief(5, small)
    joint = Belief.prior(large, 0.5, 0.45, 0.8).joint.copy()
    joint[inside] = near.joint
    found, wide = (
        regions_of_team(grid, belief, MODEL, 8, 4)
        for grid, belief in ((small, near), (large, Belief(joint)))
    )
    assert found.tolist() == wide[inside].tolist()
    assert (np.delete(wide, inside) == -1).all()


def test_robots_prefer_their_regions():
    grid = Grid(9, 9, base=40)
    belief = Belief.prior(grid, 0.1, 0.15, 0.8)
    team = plan_round(grid, belief, SensorModel(0.3), 12, 4, 'voronoi')
    owner = regions_of_team(grid, belief, SensorModel(0.3), 12, 4)
    for robot, planned in enumerate(team):
        inside = owner[planned.path] == robot
        assert inside.mean() > 0.6


# A cheap blind robot and an expensive one with a good camera.
BLIND = RobotType(true_positive=0.5, false_positive=0.5, max_steps=6)
KEEN = RobotType(true_positive=0.99, false_positive=0.01, loss_cost=1.0)


def few_robots(seed):
    rng = np.random.default_rng(seed)
    joint, model = brute_force.random_joint(rng, 4, 0), brute_force.random_sensors(rng)
    robots = 2 + seed % 2
    kinds = [
        RobotType(
            **{k: p for k, p in brute_force.random_sensors(rng).items() if rng.random() < 0.6}
        )
        for _ in range(robots)
    ]
    steps = rng.integers(1, 7 - robots, robots)
    paths = [brute_force.random_path(rng, 2, 2, 0, int(n)) for n in steps]
    return joint, SensorModel(**model), kinds, paths


def sensor_models(kinds, model):
    return [kind.model(model) for kind in kinds]


@pytest.mark.slow
@for_each('seed', range(300), every=4)
def test_team_information_is_exact_where_hazards_are_known(seed):
    """Then no loss correlates cells: the readings of different cameras remain."""
    joint, model, kinds, paths = few_robots(seed)
    known = joint.argmax(axis=1, keepdims=True)[:, :, :1] == np.arange(2)[:, None]
    joint = joint * known
    joint /= joint.sum(axis=(1, 2), keepdims=True)
    exact = brute_force.joint_information(joint, sensor_models(kinds, model), paths)
    found = team_information(Belief(joint), model, paths, robot_types=kinds)
    assert found == pytest.approx(exact, abs=1e-9)


@for_each('seed', range(20))
def test_nearly_equal_cameras_are_one_camera(seed):
    """The two differ in a number that changes no reading in nine digits."""
    joint, model, _, paths = few_robots(seed)
    twin = RobotType(true_positive=min(model.true_positive * (1 + 1e-13), 1.0))
    kinds = [twin if number % 2 else RobotType() for number in range(len(paths))]
    expected = team_information(Belief(joint), model, paths)
    found = team_information(Belief(joint), model, paths, robot_types=kinds)
    assert found == pytest.approx(expected, abs=1e-9)


def test_readings_of_different_cameras_count_up_to_a_limit(monkeypatch):
    belief, kinds = random_belief(1), [RobotType(), KEEN] * 4
    paths = [planned.path for planned in plan_round(GRID, belief, MODEL, 6, 8)]
    all_counted = team_information(belief, MODEL, paths, robot_types=kinds)
    monkeypatch.setattr(readings, 'MAX_WAYS', 5**2)
    after = nobody_deployed(belief)
    for path, kind in zip(paths, kinds):
        after = after_deployment(after, kind.model(MODEL), path)
    assert after.readings.shape[2:] == (5, 5)
    assert after.readings.sum(axis=(2, 3)) == pytest.approx(1)
    some_counted = team_information(belief, MODEL, paths, robot_types=kinds)
    assert some_counted == pytest.approx(all_counted, rel=1e-3)


@for_each('allocation', ALLOCATIONS)
def test_each_robot_keeps_to_its_own_limits(allocation):
    kinds = [BLIND, RobotType(), KEEN, BLIND, RobotType(max_steps=12)]
    model = SensorModel(0.1, malfunction=0.001)
    for seed in range(2):
        belief = random_belief(seed)
        team = plan_round(GRID, belief, model, 8, 5, allocation, types=kinds)
        for planned, kind in zip(team, kinds, strict=True):
            assert len(planned.path) - 1 <= (kind.max_steps or 8)
            own = kind.model(model)
            assert planned.information == path_information(belief, own, planned.path)
        assert max(len(planned.path) - 1 for planned in team) > 8


@for_each('allocation', ALLOCATIONS)
def test_a_team_of_one_type_is_planned_with_its_numbers(allocation):
    kind = RobotType(lethality=0.2, true_positive=0.8, max_steps=7, loss_cost=0.3)
    belief = random_belief(4)
    team = plan_round(GRID, belief, MODEL, 12, 3, allocation, types=[kind] * 3)
    alike = plan_round(GRID, belief, kind.model(MODEL), 7, 3, allocation, loss_cost=0.3)
    assert [p.path.tolist() for p in team] == [p.path.tolist() for p in alike]


def two_wings():
    """Return a field with a hazardous empty west, and a safe east with targets."""
    grid = Grid(11, 1, base=5)
    hazard = np.where(np.arange(11) < 5, 0.5, 0.0)
    target = np.where(np.arange(11) > 5, 0.5, 0.0)
    return grid, Belief.prior(grid, hazard, target, 0.0)


@for_each('allocation, order', product(['greedy', 'independent'], [(BLIND, KEEN), (KEEN, BLIND)]))
def test_each_robot_type_goes_where_it_is_useful(order, allocation):
    """The cheap blind robot explores hazards, the expensive one targets."""
    grid, belief = two_wings()
    model = SensorModel(0.9, malfunction=0.001)
    plans = plan_round(grid, belief, model, 10, 2, allocation, types=order)
    for planned, kind in zip(plans, order):
        inside = planned.path[1:-1]
        assert (inside < 5).all() if kind is BLIND else (inside > 5).all()


def test_targets_of_robots_in_flight_are_left_to_them():
    """With a keen robot in flight in the east the next one goes elsewhere, unless it is blind."""
    grid, belief = two_wings()
    model, east = SensorModel(0.9, malfunction=0.001), [5, 6, 7, 8, 9, 10, 9, 8, 7, 6, 5]
    for out, goes_west in ((KEEN, True), (BLIND, False)):
        kind = RobotType(true_positive=0.99, false_positive=0.01)
        team = plan_round(grid, belief, model, 10, 1, types=[kind], in_flight=[(east, out)])
        assert (team[0].path.min() < 5) == goes_west


def test_robots_of_types_meet_the_world_with_their_own_sensors():
    grid, rng = Grid(5, 5, base=12), np.random.default_rng(2)
    world = World.random(grid, rng, 0.2, 0.8, 0.1)
    kinds = [RobotType(lethality=0.0, malfunction=0.0, max_steps=4), RobotType(malfunction=1.0)]
    prior = Belief.prior(grid, 0.2, 0.24, 0.8)
    options, team = SearchOptions(max_steps=8), Team(2, types=kinds)
    made = run_mission(grid, prior, MODEL, world, 7, rng, options=options, team=team)
    survived = [deployment.observation.survived for deployment in made]
    assert survived == [True, False, True, False, True, False, True]
    assert all(each.observation.steps <= 4 for each in made[::2])
