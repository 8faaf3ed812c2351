# SPDX-License-Identifier: Apache-2.0
"""The core in the hands of its users: loops, planners and methods of their own."""

from copy import copy
from dataclasses import dataclass
from itertools import product

import brute_force
from kbnitp_ros import core, plugins
from kbnitp_ros.core import (
    Belief,
    Candidate,
    Dynamics,
    Estimator,
    Execution,
    Grid,
    Lane,
    Learning,
    METHODS,
    Mission,
    Observation,
    path_information,
    PathFinder,
    Plan,
    plan,
    RobotType,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    update,
    World,
)
from kbnitp_ros.testing import check_planner
from laws import for_each
import numpy as np
import pytest

GRID = Grid(5, 4, base=7, blocked=(3, 12))
PRIOR = Belief.prior(GRID, 0.2, 0.24, 0.8)
MODEL = SensorModel(0.6)
WORLD = World.random(GRID, 3, 0.2, 0.8, 0.1)
OPTIONS = SearchOptions(max_steps=8)


def walk(rng, steps=8, grid=GRID, max_visits=20):
    """Draw a closed path by the cells into which it can go on."""
    finder = PathFinder(grid, SearchOptions(max_steps=steps, max_visits=max_visits))
    path = [grid.base]
    while (following := finder.next_cells(path)).size:
        path.append(int(rng.choice(following)))
    return path


def same(one, other):
    """Compare missions to the bit, but for the plans that their makers told."""
    assert len(one) == len(other) > 0
    for first, second in zip(one, other):
        assert first.observation == second.observation
        assert first.belief == second.belief
        assert first.world == second.world
        assert first.plan == second.plan


@for_each('method, settings', product(METHODS, [
    {},
    {'truth': Truth(SensorModel(0.9), Execution(0.2, 0.1, 0.3, 0.1))},
    {'dynamics': Dynamics('changing', 0.05, 0.1)},
    {'learning': Learning(Unknowns(lethality=(0.1, 0.9)), seed=2)},
]))  # fmt: skip
def test_a_loop_over_send_gives_the_bits_of_run_mission(method, settings):
    try:
        planned = run_mission(GRID, PRIOR, MODEL, WORLD, 6, 4, method, OPTIONS, **settings)
    except ValueError:
        # The method does not take these settings.
        return
    by_hand = Mission(GRID, PRIOR, MODEL, WORLD, 4, method, OPTIONS, **settings)
    for _ in range(6):
        best = plan(GRID, by_hand.belief, by_hand.model, OPTIONS, visited=by_hand.visited)
        observation = by_hand.send(best)
        assert observation is by_hand[-1].observation
    same(planned, by_hand)
    # Paths alone, with no plans: their expected results are computed when they are sent.
    again = Mission(GRID, PRIOR, MODEL, WORLD, 4, method, OPTIONS, **settings)
    for deployment in planned:
        again.send(deployment.plan.path.tolist())
    same(planned, again)
    assert planned.estimator.belief == again.belief
    assert repr(again) == repr(planned) == f'Mission(6 robots, {planned.lost} lost)'


@for_each('method', METHODS, every=3)
def test_a_mission_goes_on_by_plans_by_hand_and_after_a_resume(method):
    goal = Lane(to=19)
    whole = run_mission(GRID, PRIOR, MODEL, WORLD, 6, 5, method, OPTIONS, goal=goal)
    rng = np.random.default_rng(5)
    begun = Mission(GRID, PRIOR, MODEL, WORLD, rng, method, OPTIONS, goal=goal).run(2)
    begun.send(whole[2].plan)
    before = begun.belief
    resumed = Mission.resume(
        GRID,
        begun.estimator,
        begun.world,
        rng,
        OPTIONS,
        before=[each.observation for each in begun],
        goal=goal,
    ).run(3)
    same(whole, [*begun, *resumed])
    assert begun.belief == before
    told = [[each.decision.p_free for each in one] for one in (whole, [*begun, *resumed])]
    assert told[0] == told[1]
    assert (resumed.sent, resumed.lost) == (6, whole.lost)
    assert whole.visited.tolist() == resumed.visited.tolist()


def test_robots_of_a_type_are_sent_from_their_base():
    grid = Grid(5, 4, other_bases=(19,))
    prior, world = Belief.prior(grid, 0.2, 0.24, 0.8), World(np.zeros(20), np.zeros(20))
    scout = RobotType(lethality=0.1, malfunction=0.0, base=19)
    mission = Mission(grid, prior, MODEL, world, 1)
    assert mission.send([19, 18, 19], scout).survived
    expected = update(prior, scout.model(MODEL), mission[0].observation)
    assert np.allclose(mission.belief.joint, expected.joint, rtol=0, atol=1e-15)
    with pytest.raises(ValueError, match='path must start at the base 0, not at cell 19'):
        mission.send([19, 18, 19])
    # A refused path takes no random numbers.
    other = Mission(grid, prior, MODEL, world, 1)
    other.send([19, 18, 19], scout)
    assert other.send([0, 1, 0]) == mission.send([0, 1, 0])


def test_many_paths_have_the_information_of_each():
    """Also that of all states and outcomes, written out."""
    rng = np.random.default_rng(8)
    joint, sensors, _ = brute_force.random_case(rng, 4, 5)
    model, belief = SensorModel(**sensors), Belief(joint)
    paths = [[0, *rng.integers(0, len(joint), n), 0] for n in rng.integers(1, 5, 30)]
    found = path_information(belief, model, paths)
    for path, information in zip(paths, found, strict=True):
        assert path_information(belief, model, path) == pytest.approx(
            information, rel=0, abs=1e-12
        )
        expected = brute_force.joint_information(joint, [model], [path])
        assert information == pytest.approx(expected, rel=0, abs=1e-9)


def test_paths_may_be_of_several_kinds():
    paths = [[7, 8, 7], np.array([7, 6, 6, 7], np.uint64)]
    each = [path_information(PRIOR, MODEL, path) for path in paths]
    for given in (paths, iter(paths), dict(enumerate(paths)).values()):
        assert path_information(PRIOR, MODEL, given).tolist() == pytest.approx(each, rel=1e-12)
    assert path_information(PRIOR, MODEL, np.empty((0, 5), int)).shape == (0,)


def closed_paths(grid, steps):
    """Return all closed paths of at most so many steps."""
    paths, open_paths = set(), {(grid.base,)}
    for _ in range(steps):
        open_paths = {(*p, int(c)) for p in open_paths for c in grid.neighbors(p[-1])}
        paths |= {path for path in open_paths if path[-1] == grid.base}
    return paths


@for_each('max_visits, max_distance, keepout', [
    (1, 0.0, ()),
    (2, 0.0, ()),
    (3, 0.0, [5]),
    (2, 3.5, ()),
])  # fmt: skip
def test_next_cells_are_those_of_all_closed_paths(max_visits, max_distance, keepout):
    grid = Grid(3, 2, base=1, blocked=(3,))
    options = SearchOptions(
        max_steps=5, max_visits=max_visits, max_distance=max_distance, keepout=keepout
    )
    finder, allowed = PathFinder(grid, options), set()
    for path in closed_paths(grid, 5):
        try:
            finder.check_path(path)
            allowed.add(path)
        except ValueError:
            continue
    goes_on = {}
    for path in allowed:
        for step in range(1, len(path)):
            goes_on.setdefault(path[:step], set()).add(path[step])
    assert goes_on
    for begun, following in goes_on.items():
        assert set(finder.next_cells(begun).tolist()) == following
    for path in closed_paths(grid, 4) - goes_on.keys():
        if path in allowed:
            assert finder.next_cells(path).size == 0


def test_a_copy_is_a_mission_of_its_own():
    mission = Mission(GRID, PRIOR, MODEL, WORLD, 1, options=OPTIONS).run(2)
    other = copy(mission)
    same(mission.run(2), other.run(2))
    assert mission.rng is not other.rng
    with pytest.raises(ValueError, match='read-only'):
        mission.visited[0] = 1


def test_a_belief_of_other_bases_is_refused():
    with pytest.raises(
        ValueError, match=r'with the bases \[7\]: the grid has \[8\]; make it with'
    ):
        Mission(Grid(5, 4, base=8), PRIOR, MODEL, WORLD, 1)
    before = [Observation([7, 19, 7], False)]
    with pytest.raises(ValueError, match='path jumps at step 1'):
        Mission.resume(GRID, Estimator(PRIOR, MODEL), WORLD, 1, before=before)


def test_cells_are_named_by_row_and_column():
    for cell in range(GRID.cells):
        row, col = GRID.row_col(cell)
        assert (row, col) == divmod(cell, 5)
        assert GRID.cell(row, col) == cell
        assert type(GRID.cell(np.int64(row), np.float32(col))) is int


@for_each('shape', ((20,), (4, 5)))
def test_a_mask_stands_for_its_cells(shape):
    mask = np.zeros(20, bool)
    mask[[3, 12]] = True
    for given in (mask.reshape(shape), mask.reshape(shape).tolist()):
        assert Grid(5, 4, base=7, blocked=given) == GRID
        options = SearchOptions(max_steps=8, keepout=given)
        assert hash(options) == hash(SearchOptions(max_steps=8, keepout=given))
        by_numbers = SearchOptions(max_steps=8, keepout=[3, 12])
        bare = Grid(5, 4, base=7)
        assert PathFinder(bare, options).grid == PathFinder(bare, by_numbers).grid == GRID
        one, other = (run_mission(bare, PRIOR, MODEL, WORLD, 3, 1, options=each)
                      for each in (options, by_numbers))  # fmt: skip
        same(one, other)
        assert not {3, 12} & {cell for each in one for cell in each.plan.path.tolist()}


def rambling(finder, objective, rng):
    """Return a random closed path."""
    path = walk(rng, finder.options.max_steps, finder.grid, finder.options.max_visits)
    return [Candidate.along(path, objective)]


def test_a_planner_gets_the_generator_of_the_mission():
    options = SearchOptions(rambling, 8)

    def paths(seed):
        mission = run_mission(GRID, PRIOR, MODEL, WORLD, 5, seed, options=options)
        return [each.plan.path.tolist() for each in mission]

    assert paths(1) == paths(1) != paths(2)
    assert len(set(map(tuple, paths(1)))) > 1
    # Robots keep their own generators, whatever a planner draws.
    mission = run_mission(GRID, PRIOR, MODEL, WORLD, 5, 1, options=options)
    again = Mission(GRID, PRIOR, MODEL, WORLD, 1)
    for deployment in mission:
        again.send(deployment.plan)
    same(mission, again)
    # Without a mission equal searches get equal generators.
    assert plan(GRID, PRIOR, MODEL, options) == plan(GRID, PRIOR, MODEL, options)
    rng = np.random.default_rng(3)
    assert plan(GRID, PRIOR, MODEL, options, rng=rng) != plan(GRID, PRIOR, MODEL, options, rng=rng)
    check_planner(rambling, cases=5)


def test_a_planner_is_inspected_once(monkeypatch):
    looked = []
    signature = plugins.signature
    monkeypatch.setattr(plugins, 'signature', lambda each: looked.append(each) or signature(each))

    def mine(finder, objective):
        return [Candidate.along([7, 8, 7], objective)]

    run_mission(GRID, PRIOR, MODEL, WORLD, 2, 1, options=SearchOptions(mine, 8))
    few = len(looked)
    run_mission(GRID, PRIOR, MODEL, WORLD, 20, 1, options=SearchOptions(mine, 8))
    assert len(looked) == few <= 3


@dataclass(frozen=True)
class ByTable:
    """A planner with an array, which has no hash."""

    paths: np.ndarray

    def __call__(self, finder, objective):
        return [Candidate.along(self.paths[0], objective)]


def test_a_planner_may_be_an_object():
    options = SearchOptions(ByTable(np.array([[7, 8, 7]])), 8)
    mission = run_mission(GRID, PRIOR, MODEL, WORLD, 2, 1, options=options)
    assert mission[1].plan.path.tolist() == [7, 8, 7]


def test_a_list_stays_as_it_is():
    path = [7, 8, 9, 8, 7]
    kept, mission = [*path], Mission(GRID, PRIOR, MODEL, WORLD, 1)
    mission.send(path)
    planned = Plan.along(path, PRIOR, MODEL)
    candidate = Candidate.along(path, core.planning.objective.Objective.of(PRIOR, MODEL))
    path_information(PRIOR, MODEL, path)
    assert path == kept
    path[1] = 6
    held = mission[0].plan.path, mission[0].observation.path, planned.path, candidate.path
    assert [each.tolist() for each in held] == [kept] * 4


@for_each('kind', (np.float32, np.float16))
def test_beliefs_are_made_from_coarse_numbers(kind):
    rng = np.random.default_rng(1)
    hazard, kappa, background = rng.random((3, 400))
    target = hazard * kappa + (1 - hazard) * np.where(rng.random(400) < 0.3, 0.0, background)
    exact = Belief.from_maps(hazard, target, kappa)
    coarse = Belief.from_maps(*(each.astype(kind) for each in (hazard, target, kappa)))
    again = Belief(exact.joint.astype(kind))
    for belief in (coarse, again):
        assert np.abs(belief.joint - exact.joint).max() < 4 * np.finfo(kind).eps
        assert np.abs(belief.joint.sum(axis=(1, 2)) - 1).max() < 1e-15
    with pytest.raises(ValueError, match='no joint distribution at cell'):
        Belief.from_maps(*(each.astype(kind) for each in (hazard, target * 0.5, kappa)))


def test_numbers_of_numpy_are_numbers():
    for make in (np.float32, np.float64, np.array):
        assert SensorModel(make(0.5)) == SensorModel(0.5)
        assert Dynamics('changing', vanish=make(0.5)) == Dynamics('changing', vanish=0.5)
        assert Grid(3, 3, resolution=make(0.5)) == Grid(3, 3, resolution=0.5)
        assert core.Beta(make(2.0), make(3.0)) == core.Beta(2.0, 3.0)
        assert SearchOptions(loss_cost=make(0.5)) == SearchOptions(loss_cost=0.5)
    for make in (np.int64, np.uint8, np.float32, np.array):
        assert SearchOptions(max_steps=make(9)) == SearchOptions(max_steps=9)
        assert Grid(make(3), make(3), make(4), connectivity=make(4)) == Grid(
            3, 3, 4, connectivity=4
        )
        assert len(run_mission(GRID, PRIOR, MODEL, WORLD, make(2), 1, options=OPTIONS)) == 2
    assert len({Estimator(PRIOR, MODEL, seed=np.int64(3)).seed, 3}) == 1
