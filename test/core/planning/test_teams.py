# SPDX-License-Identifier: Apache-2.0
"""Several robots at once, against the sum over every state and every outcome of all of them."""

from functools import cache
from itertools import pairwise, product

import brute_force
from documented import rows, words
from kbnitp_ros.core import (
    ALLOCATIONS,
    Belief,
    Grid,
    ORDINARY,
    path_information,
    plan,
    PLANNERS,
    SensorModel,
    team_information,
)
from kbnitp_ros.core.planning import objective as joint_outcomes
from kbnitp_ros.core.planning import plans as allocations
from laws import for_each
import numpy as np
import pytest
from rounds import plan_round, regions_of_team

BASES = (0, 5, 2, 15)  # a corner, the inside, an edge, the last cell
GRID = Grid(6, 5, base=8, blocked=(3, 9, 27))
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)
MODEL = SensorModel(0.5)


def visits_of(path, cells):
    return np.bincount(path[1:], minlength=cells)


def few_paths(seed):
    """Draw a belief of four cells, sensors and two or three short paths."""
    rng = np.random.default_rng(seed)
    joint, sensors = brute_force.random_joint(rng, 4, 0), brute_force.random_sensors(rng)
    robots = 2 + seed % 2
    steps = rng.integers(1, 7 - robots, robots)
    return (
        joint,
        SensorModel(**sensors),
        [brute_force.random_path(rng, 2, 2, 0, int(n)) for n in steps],
    )


def random_problem(seed):
    """Draw a belief; the sensors are the paper's, with one of its six lethalities."""
    rng = np.random.default_rng(seed)
    grid = Grid(4, 4, base=BASES[seed % len(BASES)])
    belief = Belief(brute_force.random_joint(rng, 16, grid.base))
    return grid, belief, SensorModel(float(rng.choice([0.01, 0.1, 0.3, 0.5, 0.6, 0.9])))


def random_belief(seed, grid=GRID):
    joint = brute_force.random_joint(np.random.default_rng(seed), grid.cells, grid.base)
    joint[~grid.free] = [[1, 0], [0, 0]]
    return Belief(joint)


# What several paths are worth together


@for_each('seed', range(60))
def test_the_fast_sum_over_pairs_is_the_joint_information(seed):
    joint, model, (one, other, *_) = few_paths(seed)
    visits = np.array([visits_of(path, 4) for path in (one, other)])
    pairs = brute_force.information_of_pairs(joint, model, visits)
    for i, j in ((0, 1), (1, 0), (0, 0)):
        paths = [(one, other)[i], (one, other)[j]]
        expected = brute_force.joint_information(joint, model, paths)
        assert pairs[i, j] == pytest.approx(expected, rel=0, abs=1e-9)


@pytest.mark.slow
def test_team_information_is_the_joint_information_but_for_a_little():
    cases = 600
    above = np.zeros(cases)
    for seed in range(cases):
        joint, model, paths = few_paths(seed)
        exact = brute_force.joint_information(joint, model, paths)
        above[seed] = team_information(Belief(joint), model, paths) / exact - 1
    far = (above > 0.03).sum()
    print(
        f'in {cases} cases {above.mean():.1%} above on average, more than 3 % above in {far}, '
        f'at most {above.max():.0%}, at least {above.min():.0%}'
    )
    assert above.min() > -1e-9
    page = words('docs/mathematics.md')
    assert f'in {cases} random small cases it was never below' in page
    assert f'{100 * above.mean():.1f} % above on average, and more than 3 % above in three' in page
    assert far == 3
    assert f'up to {100 * above.max():.0f} %' in page


@for_each('seed', range(20))
def test_what_may_have_happened_averages_to_what_is_believed(seed):
    """Over all joint outcomes the hazards are the prior's, whether some are merged or not."""
    rng, belief = np.random.default_rng(seed), random_belief(seed)
    model = SensorModel(**brute_force.random_sensors(rng))
    after = joint_outcomes.nobody_deployed(belief)
    for _ in range(7):
        path = brute_force.random_path(rng, 6, 5, 8, 6)
        after = joint_outcomes.after_deployment(after, model, path)
    assert after.probability.size <= joint_outcomes.MOST_OUTCOMES
    assert after.probability.sum() == pytest.approx(1, abs=1e-9)
    joint, _ = after.of_cells(np.arange(belief.cells))
    hazard = after.probability @ joint[:, :, 1].sum(axis=-1)
    np.testing.assert_allclose(hazard, belief.hazard, rtol=0, atol=1e-9)


@for_each('seed', range(5))
def test_merging_the_least_probable_fates_changes_little(seed, monkeypatch):
    belief = random_belief(seed)
    paths = [p.path for p in plan_round(GRID, belief, MODEL, 8, 7, 'voronoi', 'relaxed')]
    merged = team_information(belief, MODEL, paths)
    monkeypatch.setattr(joint_outcomes, 'MOST_OUTCOMES', 256)
    assert merged == pytest.approx(team_information(belief, MODEL, paths), rel=0.03)


# The allocations


def shares_of_the_best(grid, belief, model, steps):
    """Return the exact joint information of each allocation's pair over that of the best pair."""

    def of_pairs(visits):
        return brute_force.information_of_pairs(belief.joint, model, visits)

    found = {}
    for allocation in ALLOCATIONS:
        plans = plan_round(grid, belief, model, steps, 2, allocation)
        found[allocation] = of_pairs(np.array([visits_of(p.path, 16) for p in plans]))[0, 1]
    visits = every_path(grid.base, steps)
    alone = brute_force.information_of_visits(belief.joint, model, visits)
    # Two paths are never worth more together than one by one, so a poor one is in no best pair.
    worthy = alone + alone.max() >= max(found.values()) - 1e-9
    best = of_pairs(visits[worthy]).max()
    return {allocation: information / best for allocation, information in found.items()}


@cache
def every_path(base, steps):
    return brute_force.all_visit_counts(4, 4, base, steps)


@pytest.mark.slow
@for_each('steps', [4, 5])
def test_greedy_comes_close_to_the_best_of_all_pairs(steps):
    shares = [shares_of_the_best(*random_problem(seed), steps) for seed in range(30)]
    page = rows('docs/mathematics.md', f'{steps} steps, least')
    place = 2 * (steps - 4)
    for allocation in ALLOCATIONS:
        of_best = [share[allocation] for share in shares]
        figures = [f'{min(of_best):.3f}', f'{np.mean(of_best):.3f}']
        print(f'{allocation}, {steps} steps: {figures[0]}, on average {figures[1]}')
        assert max(of_best) <= 1 + 1e-9
        if allocation in page:
            assert figures == page[allocation][place:][:2]
    assert min(share['greedy'] for share in shares) >= 0.96


@for_each('agents', [2, 3, 5])
def test_a_greedy_team_is_the_best_of_those_that_grow_side_by_side(agents, monkeypatch):
    """No less is found than by one team that grows with the best path for each robot."""

    def found(seed):
        belief = random_belief(seed)
        paths = [planned.path for planned in plan_round(GRID, belief, MODEL, 7, agents)]
        return team_information(belief, MODEL, paths)

    together = np.array([found(seed) for seed in range(8)])
    monkeypatch.setattr(allocations, 'ROBOTS_SIDE_BY_SIDE', 1)
    alone = np.array([found(seed) for seed in range(8)])
    assert (together >= 0.999 * alone).all()
    assert together.mean() > alone.mean()


@for_each('allocation, planner, agents', product(ALLOCATIONS, PLANNERS, [2, 5]))
def test_plans_of_a_team_are_legal_and_say_what_they_are_worth(agents, planner, allocation):
    belief = random_belief(agents)
    team = plan_round(GRID, belief, MODEL, 7, agents, allocation, planner, max_visits=2)
    around = brute_force.adjacent(6, 5, GRID.blocked)
    assert len(team) == agents
    for planned in team:
        path = planned.path.tolist()
        assert path[0] == path[-1] == 8
        assert 2 <= len(path) <= 8
        assert all(after in around[before] for before, after in pairwise(path))
        assert visits_of(path, 30).max() <= 2
        assert planned.information == path_information(belief, MODEL, path)
    together = team_information(belief, MODEL, [planned.path for planned in team])
    assert together <= sum(planned.information for planned in team) + 1e-9


def test_independent_robots_go_the_same_way():
    alone = plan(GRID, PRIOR, MODEL, 8).path.tolist()
    team = plan_round(GRID, PRIOR, MODEL, 8, 3, 'independent')
    assert [planned.path.tolist() for planned in team] == [alone] * 3


@for_each('allocation', ALLOCATIONS)
def test_there_may_be_as_many_robots_as_free_cells(allocation):
    grid = Grid(3, 2, base=1, blocked=(5,))
    belief = Belief.prior(grid, 0.3, 0.4, 0.8)
    assert len(plan_round(grid, belief, MODEL, 4, 5, allocation)) == 5


# Regions


@for_each('agents, base', product([1, 2, 3, 8], [0, 40]))
def test_regions_divide_the_free_cells_evenly(base, agents):
    grid = Grid(9, 9, base=base, blocked=(13, 14, 22))
    for belief in (Belief.prior(grid, 0.5, 0.45, 0.8), random_belief(agents, grid)):
        regions = regions_of_team(grid, belief, MODEL, 18, agents)
        assert (regions.owner[[13, 14, 22]] == -1).all()
        assert set(np.delete(regions.owner, [13, 14, 22]).tolist()) == set(range(agents))
        each = [Belief(belief.joint[regions.owner == r]).joint_entropy() for r in range(agents)]
        np.testing.assert_allclose(regions.entropy, each, rtol=0, atol=1e-9)
        assert regions.imbalance == pytest.approx(max(each) / np.mean(each) - 1, abs=1e-9)
        assert regions.imbalance * np.mean(each) <= 1.5  # nats, about a cell


def test_regions_are_the_same_in_a_larger_field():
    """What is out of reach is not looked at: division costs what the cells within reach cost."""
    small, large = Grid(9, 9, base=40), Grid(60, 50, base=24 * 60 + 34)
    inside = (np.arange(20, 29)[:, None] * 60 + np.arange(30, 39)).ravel()
    near = random_belief(5, small)
    joint = Belief.prior(large, 0.5, 0.45, 0.8).joint.copy()
    joint[inside] = near.joint
    found, wide = (
        regions_of_team(grid, belief, MODEL, 8, 4)
        for grid, belief in ((small, near), (large, Belief(joint)))
    )
    assert found.owner.tolist() == wide.owner[inside].tolist()
    assert (np.delete(wide.owner, inside) == -1).all()


def test_robots_prefer_their_regions():
    grid = Grid(9, 9, base=40)
    belief = Belief.prior(grid, 0.1, 0.15, 0.8)
    team = plan_round(grid, belief, SensorModel(0.3), 12, 4, 'voronoi')
    owner = regions_of_team(grid, belief, SensorModel(0.3), 12, 4).owner
    for robot, planned in enumerate(team):
        inside = owner[planned.path] == robot
        assert inside.mean() > 0.6


# Refusals


BAD_TEAMS = [
    ({'agents': 0}, 'agents is 0.*at least 1'),
    ({'agents': -2}, 'agents is -2.*at least 1'),
    ({'agents': 1.5}, 'agents is 1.5.*whole number'),
    ({'agents': 28}, 'agents is 28.*27.*free cell'),
    ({'allocation': 'auction'}, 'allocation.*auction(?=.*voronoi)(?=.*greedy)'),
    ({'in_flight': [([8, 30, 8], ORDINARY)]}, 'path leaves the grid.*30'),
    (
        {'in_flight': [([8, 7, 8], ORDINARY), ([8, 22, 8], ORDINARY)]},
        'path jumps.*from cell 8 to 22',
    ),
]


@for_each('allocation, bad', product(ALLOCATIONS, BAD_TEAMS))
def test_bad_teams_are_refused(allocation, bad):
    arguments, message = bad
    request = {'max_steps': 4, 'agents': 2, 'allocation': allocation, **arguments}
    with pytest.raises(ValueError, match=message):
        plan_round(GRID, PRIOR, MODEL, **request)


@for_each('allocation', ALLOCATIONS)
def test_a_belief_of_another_grid_is_refused(allocation):
    with pytest.raises(ValueError, match='belief.*30.*16'):
        plan_round(Grid(4, 4), PRIOR, MODEL, 4, 2, allocation)
