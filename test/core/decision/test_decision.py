# SPDX-License-Identifier: Apache-2.0
"""Decisions and their probabilities equal the enumeration of all states."""

from itertools import product
from math import inf

from brute_force import adjacent, random_path, random_sensors, step_survival
from extent import FULL
from kbnitp_ros.core import (
    Area,
    Belief,
    Decision,
    Estimator,
    Grid,
    HazardDraws,
    Lane,
    Learning,
    NoPathError,
    Observation,
    plan,
    run_mission,
    safest_path,
    SearchOptions,
    SensorModel,
    Stop,
    targets,
    Team,
    Unknowns,
    World,
)
from kbnitp_ros.core.decision import decision as lanes
from kbnitp_ros.core.decision.goals import (
    expected_best,
    FlightState,
    information,
    information_on,
    readings_on,
)
from kbnitp_ros.core.decision.rounds import plan_round, why_worthless
from laws import for_each
import numpy as np
import pytest

SHAPES = ((3, 3), (4, 3), (4, 4))


def posterior(rng, width, height, model, deployments):
    """Return all states of the hazards and their probabilities after random deployments."""
    cells = width * height
    prior = rng.choice([0.0, 0.1, rng.uniform(), 0.9], cells)
    prior[0] = 0.0
    states = np.array(list(product((False, True), repeat=cells)))
    states = states[~(states & (prior == 0.0)).any(axis=1)]
    weight = np.where(states, prior, 1.0 - prior).prod(axis=1)
    for _ in range(deployments):
        path = random_path(rng, width, height, 0, int(rng.integers(1, 9)))
        survival = survivals(states, path, model)
        likelihood = survival if rng.random() < 0.5 else 1.0 - survival
        if (weight * likelihood).sum() > 1e-9:
            weight = weight * likelihood
            weight /= weight.sum()
    return states, weight


def survivals(states, path, model):
    chances = np.ones(len(states))
    for cell in path[1:]:
        chances *= np.where(states[:, cell], *reversed(step_survival(model)))
    return chances


def ways(width, height, to, most):
    """Return all simple paths from cell 0."""
    around = adjacent(width, height)
    found, open_ways = [], [(0,)]
    while open_ways:
        way = open_ways.pop()
        if way[-1] == to:
            found.append(way)
        elif len(way) <= most:
            open_ways += [(*way, cell) for cell in around[way[-1]] if cell not in way]
    return found


def entropy(p):
    return -sum(side * np.log(side) for side in (p, 1.0 - p) if side > 1e-15)


def state(grid, states, weight, model, belief=None):
    belief = belief or Belief.prior(grid, 0.2, 0.25, 0.8)
    draws = HazardDraws(states, inf, weight)
    return FlightState(grid, 0, draws, belief, model, SearchOptions(), weight[None])


@for_each('seed', range(300), every=1 if FULL else 3)
def test_probabilities_are_those_of_all_states(seed):
    rng = np.random.default_rng(seed)
    width, height = SHAPES[seed % 3]
    model = SensorModel(**random_sensors(rng))
    states, weight = posterior(rng, width, height, model, int(rng.integers(0, 5)))
    draws = HazardDraws(states, inf, weight)
    some = rng.choice(width * height, int(rng.integers(1, 6)), replace=False)
    count = states[:, some].sum(axis=1)
    assert draws.p_hazard() == pytest.approx(weight @ states, abs=1e-9)
    assert draws.p_free(some) == pytest.approx(weight[count == 0].sum(), abs=1e-9)
    remaining = [weight[count == n].sum() for n in range(some.size + 1)]
    assert draws.hazard_count(some) == pytest.approx(remaining, abs=1e-9)
    path = random_path(rng, width, height, 0, int(rng.integers(1, 9)))
    survived = survivals(states, path, model)
    assert draws.survival(path, model) == pytest.approx(weight @ survived, abs=1e-9)

    decision = Decision.about('area', draws, some, 0.5)
    assert decision.hazards_mean == pytest.approx(weight @ count, abs=1e-9)
    below = np.cumsum(remaining)
    for level, told in ((0.05, decision.hazards_5), (0.95, decision.hazards_95)):
        assert below[told] >= level - 1e-9
        assert told == 0 or below[told - 1] < level + 1e-9
    assert decision.reached == (decision.p_free >= 0.5)

    flights = [random_path(rng, width, height, 0, int(rng.integers(1, 9))) for _ in range(3)]
    lanes = [random_path(rng, width, height, 0, 3) for _ in range(3)]
    free = np.array([~states[:, lane].any(axis=1) for lane in lanes], dtype=float)
    chances = draws.survivals(flights, model)
    sent = state(Grid(width, height), states, weight, model).with_sent(path, model)
    best = expected_best(free, chances, sent.outcomes)
    certain = information_on(states[:, some].astype(float), chances, sent.outcomes)
    told = information(chances, sent.outcomes)
    of_lane = information_on(free[0, :, None], chances, sent.outcomes)
    for flight, own_best, own_certain, own_told, own_lane in zip(
        flights, best, certain, told, of_lane
    ):
        fate = survivals(states, flight, model)
        gained = fallen = heard = sure = 0.0
        for other in (weight * survived, weight * (1.0 - survived)):
            outcomes = (other * fate, other * (1.0 - fate))
            gained += sum((free @ outcome).max() for outcome in outcomes) - (free @ other).max()
            for each, sign in ((other, 1.0), *((each, -1.0) for each in outcomes)):
                if (total := each.sum()) > 1e-12:
                    fallen += (
                        sign * total * sum(entropy(p) for p in (each @ states[:, some]) / total)
                    )
                    sure += sign * total * entropy((each @ free[0]) / total)
            if (total := other.sum()) > 1e-12:
                heard += total * entropy((other @ fate) / total)
            heard -= sum(p * entropy(s) for p, s in zip(other, fate) if p > 0)
        assert own_best == pytest.approx(gained, abs=1e-9)
        assert own_certain == pytest.approx(fallen, abs=1e-9)
        assert own_told == pytest.approx(heard, abs=1e-9)
        assert own_lane == pytest.approx(sure, abs=1e-9)


@for_each('seed', range(30))
def test_cheapest_ways_cost_least_of_all_ways(seed):
    rng = np.random.default_rng([seed, 25])
    costs, to = rng.random((5, 9)), rng.integers(1, 9, 5)
    limits = [3, 8, 2]
    found = lanes.cheapest_lanes(Grid(3, 3), costs, 0, to, limits)
    for ways_within, limit in zip(found, limits, strict=True):
        for way, cost, goal in zip(ways_within, costs, to.tolist(), strict=True):
            all_ways = ways(3, 3, goal, limit)
            assert tuple(way) in all_ways
            least = min(cost[list(each[1:])].sum() for each in all_ways)
            assert cost[way[1:]].sum() == pytest.approx(least)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lanes, 'MAX_TOGETHER', 1)
        one_by_one = lanes.cheapest_lanes(Grid(3, 3), costs, 0, to, limits)
    assert [[*map(tuple, each)] for each in one_by_one] == [[*map(tuple, each)] for each in found]


@for_each('seed', range(10))
def test_safest_ways_are_the_cheapest_lanes_from_each_cell(seed):
    rng = np.random.default_rng(seed)
    blocked = rng.choice(np.arange(1, 30), 6, replace=False).tolist()
    grid = Grid(6, 5, blocked=blocked, connectivity=int(rng.choice([4, 8])))
    hazard = rng.choice([0.0, 0.1, rng.uniform(), 1.0], grid.cells)
    with np.errstate(divide='ignore'):
        cost = lanes.STEP_COST - np.log(1.0 - hazard).clip(min=lanes.LEAST)
    free = np.flatnonzero(grid.free).tolist()
    for start, before in zip(free, lanes.safest_ways(grid, hazard, free)):
        reached = grid.steps_from(start, grid.free) < grid.cells
        assert np.array_equal(before >= 0, reached & (np.arange(grid.cells) != start))
        for to in np.flatnonzero(before >= 0).tolist():
            [[best]] = lanes.cheapest_lanes(grid, cost[None], start, to, [grid.cells])
            way = [to]
            while way[0] != start:
                way.insert(0, int(before[way[0]]))
            assert cost[way[1:]].sum() == pytest.approx(cost[best[1:]].sum(), abs=1e-9)


@for_each('seed', range(60))
def test_information_of_readings_is_exact(seed):
    """The expected fall of the entropies, over all states, fates and readings."""
    rng = np.random.default_rng([seed, 26])
    model = SensorModel(**random_sensors(rng))
    states, weight = posterior(rng, 3, 3, model, 2)
    belief = Belief(rng.dirichlet(np.ones(4), 9).reshape(9, 2, 2))
    situation = state(Grid(3, 3), states, weight, model, belief)
    path = random_path(rng, 3, 3, 0, 6)
    visits = np.bincount(path[1:], minlength=9)
    survival = survivals(states, path, model)
    returned = weight * survival
    positive = np.array([model.false_positive, model.true_positive])

    def left(likelihood, event):
        both = returned * likelihood
        return both.sum() * entropy(both @ event / both.sum()) if both.sum() > 1e-12 else 0.0

    def told(cell, event):
        target = belief.joint[cell] / belief.joint[cell].sum(axis=1, keepdims=True)
        of_readings = 0.0
        for reading in product((0, 1), repeat=int(visits[cell])):
            each = [positive if is_read else 1.0 - positive for is_read in reading]
            p_reading = target @ np.prod([np.ones(2), *each], axis=0)
            of_readings += left(p_reading[states[:, cell].astype(int)], event)
        return left(1.0, event) - of_readings

    def found(cells, events):
        return readings_on(situation, [path], survival[None], cells, events)[0]

    cells = [1, 3, 4]
    of_cells = sum(told(cell, states[:, cell]) for cell in cells)
    assert found(cells, states[:, cells]) == pytest.approx(of_cells, abs=1e-9)
    free = ~states[:, cells].any(axis=1)
    assert found([1], free[:, None]) == pytest.approx(told(1, free), abs=1e-9)
    of_lane = min(sum(told(cell, free) for cell in cells), left(1.0, free))
    assert found(cells, free[:, None]) == pytest.approx(of_lane, abs=1e-9)


def test_readings_of_cells_alike_tell_at_most_the_entropy_of_a_lane():
    states = np.array([[False] * 9, [False] + [True] * 8])
    model = SensorModel(0.0, 0.0, 0.0, true_positive=1.0, false_positive=0.0)
    target_if_hazard = Belief([[[0.5, 0.0], [0.0, 0.5]]] * 9)
    situation = state(Grid(3, 3), states, np.array([0.5, 0.5]), model, target_if_hazard)
    paths, free = [np.array([0, 1, 2, 1, 0])], ~states[:, [1]]
    assert readings_on(situation, paths, np.ones((1, 2)), [1, 2], free) == np.log(2.0)


def test_safest_path_is_the_best_of_all_ways_nearly_always():
    best_found = 0
    cases = range(60)
    for seed in cases:
        rng = np.random.default_rng(seed)
        model = SensorModel(**random_sensors(rng))
        states, weight = posterior(rng, 3, 3, model, 3)
        draws = HazardDraws(states, inf, weight)
        most = int(rng.integers(2, 6))
        found = safest_path(Grid(3, 3), draws, model, 0, 8, most)
        probability = {
            way: weight[~states[:, way].any(axis=1)].sum() for way in ways(3, 3, 8, most)
        }
        assert found.p_free == pytest.approx(probability[tuple(found.path)], abs=1e-9)
        survived = survivals(states, found.path, model)
        assert found.survival == pytest.approx(weight @ survived, abs=1e-9)
        best_found += found.p_free >= max(probability.values()) - 1e-9
    assert best_found >= 0.95 * len(cases)


PATHS = ([0, 1, 2, 1, 0], [0, 3, 4, 1, 0], [0, 1, 4, 3, 0], [0, 4, 8, 4, 0])


@pytest.mark.parametrize('method', ['kappa_bnitp_sampled', 'kappa_bnitp'])
def test_draws_follow_the_belief_or_the_joint_posterior_of_sampling(method):
    hazard = np.array([0.0, *[0.3] * 8])
    prior = Belief.from_maps(hazard, hazard, np.full(9, 0.5))
    model = SensorModel(0.7)
    estimator = Estimator(prior, model, method)
    states = np.array(list(product((False, True), repeat=9)))
    weight = np.where(states, hazard, 1.0 - hazard).prod(axis=1)
    for path in PATHS:
        estimator.assimilate(Observation(path, False))
        weight *= 1.0 - survivals(states, path, model)
    exact = HazardDraws(states, inf, weight / weight.sum())
    draws = HazardDraws.of(estimator, len(PATHS), 20_000)
    again = HazardDraws.of(estimator, len(PATHS), 20_000)
    assert np.array_equal(draws.hazardous, again.hazardous)
    assert 5_000 < draws.independent <= 20_000
    error = 5.0 / np.sqrt(draws.independent)
    assert draws.p_hazard() == pytest.approx(estimator.belief.hazard, abs=error)
    lane = [0, 1, 4, 8]
    assert estimator.draws_are_exact == (method == 'kappa_bnitp_sampled')
    if estimator.draws_are_exact:
        assert draws.p_free(lane) == pytest.approx(exact.p_free(lane), abs=error)
        assert draws.hazard_count(range(9)) == pytest.approx(
            exact.hazard_count(range(9)), abs=error
        )
    if method == 'kappa_bnitp':
        product_of_cells = np.prod(1.0 - estimator.belief.hazard[lane])
        assert draws.p_free(lane) == pytest.approx(product_of_cells, abs=error)


def uniform(grid, hazard):
    """Return a prior with the same hazard in all cells but the base."""
    maps = np.full(grid.cells, hazard)
    maps[grid.base] = 0.0
    return Belief.from_maps(maps, 0.8 * maps, np.full(grid.cells, 0.8))


GRID = Grid(5, 5)
PRIOR = uniform(GRID, 0.15)
MODEL = SensorModel(0.6)
NEAR = SearchOptions('relaxed', 12)


@pytest.mark.parametrize('goal', [Lane(24), Area([6, 7, 12])])
def test_a_mission_with_a_goal_is_decided_after_each_deployment(goal):
    world = World.random(GRID, np.random.default_rng(1), 0.15, 0.8, 0.1)
    robots = 6
    first, again = (
        run_mission(GRID, PRIOR, MODEL, world, robots, 7, options=NEAR, goal=goal)
        for _ in range(2)
    )
    assert len(first) == robots
    for each, other in zip(first, again):
        assert not each.decision.reached
        assert 0.0 <= each.decision.p_free <= 1.0
        assert np.array_equal(each.plan.path, other.plan.path)
        assert each.decision.p_free == other.decision.p_free
        GRID.check_path(each.plan.path, 12)
        if isinstance(goal, Lane):
            path = each.decision.path
            assert (path[0], path[-1]) == (0, 24)
            assert len(path) - 1 <= 12
        else:
            assert each.decision.path.size == 0
    assert not run_mission(GRID, PRIOR, MODEL, world, 0, 7, options=NEAR, goal=goal)


@pytest.mark.parametrize('goal', [Lane(24, 0.95), Area([6, 7, 12], 0.95)])
@pytest.mark.parametrize('reach', [0.3, None])
def test_a_goal_is_reached_where_hazards_may_reach(goal, reach):
    safe = World(np.zeros(25, bool), np.zeros(25, bool), GRID)
    believed = SensorModel(0.9, malfunction=0.001, reach=reach or 0.0)
    learning = Learning(Unknowns(reach=(0.0, 0.6)) if reach is None else Unknowns())
    mission = run_mission(
        GRID, PRIOR.on(GRID), believed, safe, 20, 7, options=NEAR, learning=learning, goal=goal
    )
    assert mission[-1].decision.reached
    assert len(mission) < 20


def test_missions_stop_by_themselves():
    safe = World(np.zeros(25, bool), np.zeros(25, bool))
    certain = SensorModel(0.9, malfunction=0.0, false_negative=0.0)

    def mission(goal=None, stop=None, world=safe, **own):
        search = SearchOptions('relaxed', 12, **own)
        told = {'options': search, 'goal': goal, 'stop': stop}
        return run_mission(GRID, PRIOR, certain, world, 40, 1, **told)

    reached = mission(Lane(24, 0.9))
    assert 0 < len(reached) < 40
    assert reached[-1].decision.reached
    assert reached[-1].decision.p_free >= 0.9
    assert not any(each.decision.reached for each in reached[:-1])
    deadly = World(np.arange(25) > 0, np.zeros(25, bool))
    lost = mission(Lane(24), Stop(losses=3), deadly)
    assert [each.observation.survived for each in lost].count(False) == 3
    assert not lost[-1].observation.survived
    assert not mission(stop=Stop(gain=1e6))
    assert not mission(Lane(24), minimum_survival=0.999)
    for deployment in mission(minimum_survival=0.6, stop=Stop(losses=1)):
        assert deployment.plan.survival >= 0.6
    with pytest.raises(NoPathError, match='minimum_survival'):
        plan(GRID, PRIOR, certain, SearchOptions(max_steps=12, minimum_survival=1.0))


def test_robots_of_a_round_add_to_each_other():
    # No lane is probably free, so not all robots fly along the same.
    prior = Belief.prior(GRID, 0.3, 0.35, 0.8)
    draws = HazardDraws.of(Estimator(prior, MODEL), 0)
    planned = plan_round(Lane(24), draws, GRID, prior, MODEL, Team(8), NEAR)
    assert len(planned) == 8
    assert len({plan.path.tobytes() for plan in planned}) > 1


def test_a_round_is_worth_as_much_as_the_best_of_its_plans():
    planned = plan_round(None, None, GRID, PRIOR, MODEL, Team(2), NEAR)
    most = max(plan.information / (1.0 - plan.survival) for plan in planned)
    assert not why_worthless(planned, 0.0)
    assert not why_worthless(planned, 0.999 * most)
    assert 'loss_cost' in why_worthless(planned, 1.001 * most)
    known = plan_round(None, None, GRID, uniform(GRID, 0.0), MODEL, Team(2), NEAR)
    assert 'no plan is expected to bring more' in why_worthless(known, 0.0)


def test_targets_have_their_looks_and_misses():
    belief = Belief.from_maps([0.0, 0.2, 0.2], [0.1, 0.5, 0.3], [0.1, 0.5, 0.5])
    model = SensorModel(0.5, true_positive=0.9)
    seen = Observation([0, 1, 2, 1, 0], True, [True, False, -1, False])
    lost = Observation([0, 2, 0], False)
    first, second, third = targets(belief, model, [seen, lost])
    assert [first[:4], second[:4], third[:4]] == [
        (1, pytest.approx(0.5), 1, 1),
        (2, pytest.approx(0.3), 1, 0),
        (0, pytest.approx(0.1), 1, 0),
    ]
    assert first.missed == pytest.approx(0.1)
    assert targets(belief, model, [], least=0.4)[0].missed == 1.0
    assert len(targets(belief, model, [], least=0.4)) == 1
