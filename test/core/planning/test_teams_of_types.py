# SPDX-License-Identifier: Apache-2.0
"""Robots of several kinds: each is planned for with what it has of its own."""

from itertools import product

import brute_force
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
from kbnitp_ros.core.planning import objective as readings
from kbnitp_ros.core.planning.objective import after_deployment, nobody_deployed
from laws import for_each
import numpy as np
import pytest
from rounds import plan_round

GRID = Grid(6, 5, base=8, blocked=(3, 9, 27))
MODEL = SensorModel(0.5)
# Cheap and blind; dear and with a good camera.
BLIND = RobotType(true_positive=0.5, false_positive=0.5, max_steps=6)
KEEN = RobotType(true_positive=0.99, false_positive=0.01, loss_cost=1.0)


def random_belief(seed, grid=GRID):
    joint = brute_force.random_joint(np.random.default_rng(seed), grid.cells, grid.base)
    joint[~grid.free] = [[1, 0], [0, 0]]
    return Belief(joint)


def few_robots(seed):
    """Draw a belief of four cells, a model, and the kinds and short paths of two or three."""
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


def joint_information(joint, models, paths):
    """Sum I(Z, X; all outcomes), nats, over all states and outcomes; each robot has its model."""
    cells, states, prior = brute_force.enumerate_states(joint, [c for p in paths for c in p[1:]])
    likelihood = np.ones((len(states), 1))
    for model, path in zip(models, paths):
        lost, returned = brute_force.fates(model, cells, states, path)
        outcomes = [lost] + [
            returned
            * brute_force.readings_likelihood(model, cells, states, path, np.array(readings))
            for readings in product((False, True), repeat=len(path) - 1)
        ]
        outcomes = np.column_stack(outcomes)
        likelihood = (likelihood[:, :, None] * outcomes[:, None, :]).reshape(len(states), -1)
    together = prior[:, None] * likelihood
    apart = prior[:, None] * together.sum(axis=0)
    seen = together > 0
    return float((together[seen] * np.log(together[seen] / apart[seen])).sum())


def models_of(kinds, model):
    return [kind.model(model) for kind in kinds]


# What paths of robots that differ are worth together


@pytest.mark.slow
@for_each('seed', range(300))
def test_team_information_is_exact_where_hazards_are_known(seed):
    """Then no loss ties cells together: what remains is how cameras add up."""
    joint, model, kinds, paths = few_robots(seed)
    known = joint.argmax(axis=1, keepdims=True)[:, :, :1] == np.arange(2)[:, None]
    joint = joint * known
    joint /= joint.sum(axis=(1, 2), keepdims=True)
    exact = joint_information(joint, models_of(kinds, model), paths)
    found = team_information(Belief(joint), model, paths, robot_types=kinds)
    assert found == pytest.approx(exact, abs=1e-9)


@pytest.mark.slow
def test_team_information_is_the_joint_information_but_for_a_little():
    above = np.zeros(300)
    for seed in range(above.size):
        joint, model, kinds, paths = few_robots(seed)
        exact = joint_information(joint, models_of(kinds, model), paths)
        above[seed] = team_information(Belief(joint), model, paths, robot_types=kinds) / exact - 1
    print(f'{above.mean():.2%} above on average, at most {above.max():.0%}')
    assert above.min() > -1e-9
    assert above.mean() < 0.003


@for_each('seed', range(20))
def test_one_camera_written_twice_is_one_camera(seed):
    """The two are told apart by a number that changes no reading to nine digits."""
    joint, model, _, paths = few_robots(seed)
    twin = RobotType(true_positive=min(model.true_positive * (1 + 1e-13), 1.0))
    kinds = [twin if number % 2 else RobotType() for number in range(len(paths))]
    expected = team_information(Belief(joint), model, paths)
    found = team_information(Belief(joint), model, paths, robot_types=kinds)
    assert found == pytest.approx(expected, abs=1e-9)


def test_many_readings_by_cameras_that_differ_count_up_to_a_number(monkeypatch):
    belief, kinds = random_belief(1), [RobotType(), KEEN] * 4
    paths = [each.path for each in plan_round(GRID, belief, MODEL, 6, 8)]
    all_counted = team_information(belief, MODEL, paths, robot_types=kinds)
    monkeypatch.setattr(readings, 'MOST_WAYS', 5**2)
    after = nobody_deployed(belief)
    for path, kind in zip(paths, kinds):
        after = after_deployment(after, kind.model(MODEL), path)
    assert after.readings.shape[2:] == (5, 5)
    assert after.readings.sum(axis=(2, 3)) == pytest.approx(1)
    some_counted = team_information(belief, MODEL, paths, robot_types=kinds)
    assert some_counted == pytest.approx(all_counted, rel=1e-3)


# The allocations


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
def test_a_team_of_one_kind_is_that_of_its_numbers(allocation):
    kind = RobotType(lethality=0.2, true_positive=0.8, max_steps=7, loss_cost=0.3)
    belief = random_belief(4)
    team = plan_round(GRID, belief, MODEL, 12, 3, allocation, types=[kind] * 3)
    alike = plan_round(GRID, belief, kind.model(MODEL), 7, 3, allocation, loss_cost=0.3)
    assert [p.path.tolist() for p in team] == [p.path.tolist() for p in alike]


@for_each('allocation', ALLOCATIONS)
def test_a_robot_alone_is_planned_with_its_own_numbers(allocation):
    belief = random_belief(2)
    for kind in (BLIND, KEEN, RobotType()):
        team = plan_round(GRID, belief, MODEL, 9, 1, allocation, types=[kind])
        cost, steps = kind.loss_cost or 0.0, kind.max_steps or 9
        alone = plan(GRID, belief, kind.model(MODEL), steps, loss_cost=cost)
        assert team[0].path.tolist() == alone.path.tolist()
        assert team[0].information == alone.information
        assert team[0].survival == alone.survival


def two_wings():
    """Return a field whose west may be deadly but holds nothing, and whose east is the reverse."""
    grid = Grid(11, 1, base=5)
    hazard = np.where(np.arange(11) < 5, 0.5, 0.0)
    target = np.where(np.arange(11) > 5, 0.5, 0.0)
    return grid, Belief.prior(grid, hazard, target, 0.0)


@for_each('allocation, order', product(['greedy', 'independent'], [(BLIND, KEEN), (KEEN, BLIND)]))
def test_each_goes_where_it_is_of_use(order, allocation):
    """The cheap blind one finds out where hazards are, the dear one what its camera sees."""
    grid, belief = two_wings()
    model = SensorModel(0.9, malfunction=0.001)
    plans = plan_round(grid, belief, model, 10, 2, allocation, types=order)
    for planned, kind in zip(plans, order):
        inside = planned.path[1:-1]
        assert (inside < 5).all() if kind is BLIND else (inside > 5).all()


def test_what_robots_are_out_for_is_left_to_them():
    """With a keen robot out in the east the next one goes elsewhere, but not if it is blind."""
    grid, belief = two_wings()
    model, east = SensorModel(0.9, malfunction=0.001), [5, 6, 7, 8, 9, 10, 9, 8, 7, 6, 5]
    for out, goes_west in ((KEEN, True), (BLIND, False)):
        kind = RobotType(true_positive=0.99, false_positive=0.01)
        team = plan_round(grid, belief, model, 10, 1, types=[kind], in_flight=[(east, out)])
        assert (team[0].path.min() < 5) == goes_west


# Whole missions


def test_a_mission_of_kinds_is_what_each_of_them_makes_of_the_world():
    grid, rng = Grid(5, 5, base=12), np.random.default_rng(2)
    world = World.random(grid, rng, 0.2, 0.8, 0.1)
    kinds = [RobotType(lethality=0.0, malfunction=0.0, max_steps=4), RobotType(malfunction=1.0)]
    prior = Belief.prior(grid, 0.2, 0.24, 0.8)
    options, team = SearchOptions(max_steps=8), Team(2, types=kinds)
    made = run_mission(grid, prior, MODEL, world, 7, rng, options=options, team=team)
    survived = [deployment.observation.survived for deployment in made]
    assert survived == [True, False, True, False, True, False, True]
    assert all(each.observation.steps <= 4 for each in made[::2])


# Refusals


@for_each('arguments, message', [
    ({'types': [KEEN]}, 'has 1 values.*one for each of 2'),
    (
        {'agents': 7, 'types': [RobotType(true_positive=0.9 + n / 100) for n in range(7)]},
        '7 different cameras.*at most 6',
    ),
])  # fmt: skip
def test_bad_kinds_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        plan_round(GRID, random_belief(0), MODEL, **{'max_steps': 4, 'agents': 2, **arguments})
