# SPDX-License-Identifier: Apache-2.0
"""A wrong argument is refused by its name, its value, and what it may be."""

from functools import partial
from itertools import product
from math import inf, nan

from kbnitp_ros import core
from kbnitp_ros.core import (
    Area,
    Belief,
    Beta,
    brier_score,
    Clustering,
    Dynamics,
    Estimator,
    Execution,
    Grid,
    HazardDraws,
    Lane,
    Learning,
    log_loss,
    METHODS,
    Mixture,
    Observation,
    RobotType,
    run_mission,
    SearchOptions,
    SensorModel,
    Stop,
    Team,
    Truth,
    Unknowns,
    update,
    World,
)
from kbnitp_ros.plugins import PluginError
from laws import for_each
import numpy as np
import pytest
from rounds import LEARN_FROM_LOSSES

GRID = Grid(4, 4, blocked=[6])
PRIOR = Belief.prior(GRID, 0.15, 0.2, 0.8)
MODEL = SensorModel(0.5)
WORLD = World.random(GRID, 1, 0.15, 0.8, 0.1)
TWO_BASES = Grid(6, 5, base=0, other_bases=(29,))
FREE = Belief(PRIOR.joint)
DRAWS = HazardDraws.of(Estimator(PRIOR, MODEL), 0, 8)
SAMPLED = 'kappa_bnitp_sampled'
SENSORS = ('lethality', 'malfunction', 'false_negative', 'true_positive', 'false_positive')


def grid(width=4, height=3, **others):
    return Grid(width, height, **others)


def path(cells):
    return Grid(4, 3, base=5, blocked=(9,)).check_path(cells, max_steps=5)


def at_cells(**values):
    """Return the belief of uniform maps with other values in two cells."""
    maps = {name: np.full(12, 0.5) for name in ('hazard', 'target', 'kappa')}
    for name, value in values.items():
        maps[name][[7, 9]] = value
    return Belief.from_maps(**maps)


def prior(**others):
    usual = {'hazard': 0.5, 'target': 0.45, 'kappa': 0.8}
    return Belief.prior(Grid(3, 2, base=4), **usual | others)


def draw(**densities):
    usual = {'hazard_density': 0.15, 'kappa': 0.8, 'target_background': 0.1}
    return World.random(GRID, 1, **usual | densities)


def fits(hazard, target):
    World(hazard, target).check(Grid(2, 2, base=1, blocked=(3,)))


def wide(side, densities):
    possible = np.ones(side**2, dtype=bool)
    possible[[5, 77]] = False
    return Clustering(Grid(side, side), 0.5).fields(possible, np.full(densities, 0.2))


def clustered(method=SAMPLED, hazard=0.2, **others):
    belief = Belief.prior(GRID, hazard, 0.5, 0.8)
    given = {'clustering': Clustering(GRID, 0.5)} | others
    return Estimator(belief, MODEL, method, **given)


def mission(robots=4, rng=1, method='kappa_bnitp', grid=GRID, world=WORLD, **others):
    belief = Belief.prior(grid, 0.15, 0.2, 0.8)
    given = {'options': SearchOptions(max_steps=8)} | others
    return run_mission(grid, belief, MODEL, world, robots, rng, method, **given)


def goal(sought, **options):
    """Run a mission for a goal in a field whose cell 4 no way leads to."""
    walled, world = Grid(5, 5, blocked=(3, 8, 9)), World(np.zeros(25, bool), np.zeros(25, bool))
    options = {'options': SearchOptions(max_steps=3), **options}
    return mission(2, grid=walled, world=world, goal=sought, **options)


def forecast(**changes):
    usual = {'robots': 4, 'worlds': 2, 'rng': 1, 'options': SearchOptions(max_steps=8)}
    return core.forecast(GRID, Estimator(PRIOR, MODEL), **usual | changes)


def begun(grid=GRID, world=WORLD, rng=1, **others):
    return core.Mission(grid, PRIOR, MODEL, world, rng, **others)


def sent(path, *robot_type):
    return begun().send(path, *robot_type)


def informed(paths):
    return core.path_information(PRIOR, MODEL, paths)


def together(path):
    return core.team_information(PRIOR, MODEL, [[0, 1, 0], path])


def following(path):
    return core.PathFinder(GRID, SearchOptions(max_steps=4)).next_cells(path)


def planned(**options):
    return core.plan(GRID, PRIOR, MODEL, SearchOptions(max_steps=4, **options))


def team(agents=2, allocation='greedy', types=(), grid=GRID, **others):
    search = SearchOptions(max_steps=4)
    return core.plan_team(grid, PRIOR, MODEL, Team(agents, allocation, types), search, **others)


def observed(cells, survived, readings=None, **others):
    return partial(Observation, cells, survived, readings, **others)


def seen_by(method, sensors, hazard, readings):
    belief = Belief.from_maps([0.0, hazard], [0.5, 0.5], [0.5, 0.5])
    model = SensorModel(**{'lethality': 0.5} | sensors)
    observation = Observation([0, 1, 1, 0], readings is not None, readings)
    Estimator(belief, model, method).assimilate(observation)


def lost(**told):
    return observed([0, 1, 2, 0], False, **told)


def back(readings, **told):
    return observed([0, 1, 2, 0], True, readings, **told)


def moving():
    return Dynamics('moving', move=(0.01, 0.3))


def learner(unknowns, hazard=0.5, target=0.5, kappa=0.5, method=SAMPLED, **sensors):
    """Return a function that starts to learn numbers in a field with these densities."""
    belief = Belief.prior(Grid(2, 2), hazard, target, kappa)
    return lambda: Estimator(belief, SensorModel(0.5, **sensors), method, Unknowns(**unknowns))


NO_PROBABILITIES = [
    (partial(make, **{name: value}), ValueError, rf'{name} .*is {value}.*\[0, 1\]')
    for make, names in (
        (partial(SensorModel, lethality=0.5), SENSORS),
        (Execution, ('detour', 'early_return', 'contact', 'camera_failure')),
        (draw, ('hazard_density', 'kappa', 'target_background')),
        (at_cells, ('hazard', 'target', 'kappa')),
    )
    for name, value in product(names, (-0.1, 1.1, nan, inf, -inf))
]


@for_each('make, error, words', [
    # Grids, and points and paths on them.
    (lambda: grid(width=0), ValueError, 'width is 0.*at least 1'),
    (lambda: grid(height=-2), ValueError, 'height is -2.*at least 1'),
    (lambda: grid(width=2.5), ValueError, 'width is 2.5.*whole number'),
    (lambda: grid(width=nan), ValueError, 'width is nan.*whole number'),
    (lambda: grid('4'), TypeError, "grid width is '4': it must be a number"),
    (lambda: grid(base=12), ValueError, 'base is 12.*0 to 11'),
    (lambda: grid(base=1.5), ValueError, 'base is 1.5.*0 to 11'),
    (lambda: grid(base=5, blocked=(4, 5)), ValueError, 'base is 5.*must be a free cell.*blocked'),
    (lambda: grid(blocked=(3, 12)), ValueError, 'blocked.*12.*0 to 11'),
    (lambda: grid(blocked=(2.5,)), ValueError, 'blocked.*2.5.*0 to 11'),
    (lambda: grid(blocked=6), TypeError, 'blocked is 6: it must be a list'),
    (lambda: grid(other_bases=(3,), blocked=(3,)), ValueError, 'base is 3: it must be a free'),
    (lambda: grid(other_bases=(20,)), ValueError, 'base is 20.*from 0 to 11'),
    (lambda: grid(other_bases=(-1,)), ValueError, 'base is -1.*from 0 to 11'),
    (lambda: grid(other_bases=(1.5,)), ValueError, 'base is 1.5.*whole number'),
    (lambda: grid(resolution=0.0), ValueError, 'resolution is 0.*positive'),
    (lambda: grid(resolution=nan), ValueError, 'resolution is nan.*positive'),
    (lambda: grid(resolution=inf), ValueError, 'resolution is inf'),
    (lambda: grid(origin=(0.0, nan)), ValueError, 'origin.*nan.*finite'),
    (lambda: grid(origin=(0.0, 0.0, 0.0)), ValueError, 'origin.*two'),
    (lambda: grid(origin=(1e16, 0.0)), ValueError, r'origin is \(1e\+16, 0.0\): cells of 1.0 m'),
    (lambda: grid(origin=(0.0, -1e308)), ValueError, 'cannot be told apart.* within 4.5e'),
    (lambda: grid(connectivity=6), ValueError, 'connectivity is 6.*4 or 8'),
    (lambda: grid(yaw=inf), ValueError, 'yaw is inf.*finite'),
    *((partial(grid().neighbors, cell), ValueError, f'cell is {cell}.*0 to 11')
      for cell in (-1, 12, 1.5)),
    (lambda: grid().cells_at([(-0.01, 0.5)]), ValueError, r'\(-0.01, 0.5\) is outside.*4 x 3'),
    *((partial(grid().cells_at, [(x, y)]), ValueError, rf'\({x}, {y}\).*4 x 3')
      for x, y in ((0.5, -0.01), (4.01, 0.5), (0.5, 3.01), (nan, 0.5), (-inf, inf))),
    (lambda: grid(yaw=np.pi / 2).cells_at([(0.5, 0.5)]), ValueError, 'outside.*turned by 1.57'),
    (lambda: grid().cells_at(np.full(6, 0.5)), ValueError, r'points have shape \(6,\)'),
    (lambda: grid().cells_at(np.full((3, 3), 0.5)), ValueError, r'points have shape \(3, 3\)'),
    (lambda: TWO_BASES.at(4), ValueError, r'base 4 is not a base.*which has \[0, 29\].*other'),
    *((partial(path, cells), ValueError, 'path.*at least two') for cells in ([], [5], 5)),
    (lambda: path([[5, 5], [5, 5]]), ValueError, 'path'),
    (lambda: path([5, 12, 5]), ValueError, 'path leaves the grid.*12.*0 to 11'),
    (lambda: path([5, -1, 5]), ValueError, 'path leaves the grid.*-1.*0 to 11'),
    (lambda: path([5, 7, 5]), ValueError, 'path jumps.*5 to 7'),
    (lambda: path([5, 4, 3, 4, 5]), ValueError, 'path jumps.*4 to 3'),
    (lambda: path([4, 5]), ValueError, 'path must start at the base 5.*4'),
    (lambda: path([5, 4]), ValueError, 'path must end at the base 5.*4'),
    (lambda: path([5, 9, 5]), ValueError, 'path enters a blocked cell.*9'),
    (lambda: path([5, 5, 5, 5, 5, 5, 5]), ValueError, 'path has 6 steps.*5'),
    *((partial(path, cells), ValueError, 'path.*whole numbers')
      for cells in ([5.0, 6.5, 5.0], [5, nan, 5], [True, True], ['5', '6', '5'])),
    # Clusters.
    *((partial(Clustering, GRID, coupling), ValueError,
       rf"coupling is {coupling!r}.*in \[0, 1.7\] or 'learn'")
      for coupling in (-0.1, 1.8, nan, 'strong', None)),
    (lambda: Clustering(0.5, GRID), TypeError, 'grid is 0.5: it must be Grid'),
    (lambda: wide(17, 1), ValueError, 'obstacles, its shorter side may have at most 16 cells'),
    (lambda: wide(13, 2), ValueError, 'hazard_density is unknown'),
    (lambda: clustered('kappa_bnitp'), ValueError,
     'kappa_bnitp does not take clustered.*kappa_bnitp_sampled'),
    (lambda: clustered(dynamics=Dynamics('used_up')), ValueError,
     'does not take hazards that are used_up'),
    (lambda: clustered(clustering=Clustering(Grid(3, 3), 0.5)), ValueError,
     'grid of 3 x 3 cells: the prior has 4 x 4'),
    (lambda: clustered(hazard=np.linspace(0.0, 0.5, 16)), ValueError,
     'prior hazards differ between cells'),
    # Beliefs, and their scores. A cell's hazardous targets are at most its targets or hazards.
    (lambda: at_cells(hazard=0.5, target=0.1, kappa=0.8), ValueError, r'cell 7\b.*0.5.*0.8.*0.1'),
    (lambda: at_cells(hazard=0.5, target=0.9, kappa=0.2), ValueError, r'cell 7\b.*0.5.*0.2.*0.9'),
    (lambda: at_cells(hazard=1.0, target=0.3, kappa=0.8), ValueError, r'cell 7\b.*1.0.*0.8.*0.3'),
    (lambda: Belief.from_maps(*map(np.ones, (3, 3, 4))), ValueError, r'kappa.*shape \(4,\)'),
    (lambda: Belief.from_maps(*map(np.ones, (3, 2, 3))), ValueError, r'target.*shape \(2,\)'),
    (lambda: Belief.from_maps(*map(np.ones, (1, 3, 3))), ValueError, r'target.*shape \(3,\)'),
    (lambda: Belief.from_maps([], [], []), ValueError, r'hazard.*shape \(0,\)'),
    (lambda: Belief.from_maps(*np.ones((3, 3, 1))), ValueError, r'hazard.*shape \(3, 1\)'),
    (lambda: Belief(np.full((3, 4), 0.25)), ValueError, r'joint.*shape.*\(3, 4\)'),
    (lambda: Belief(np.full((0, 2, 2), 0.25)), ValueError, 'joint.*shape'),
    (lambda: Belief([[[1, 0], [0, 0]], [[0.5, 0.7], [-0.2, 0]]]), ValueError, 'joint.*cell 1'),
    (lambda: Belief([[[1, 0], [0, 0]], [[0.5, 0.5], [0.5, 0.5]]]), ValueError, 'joint.*cell 1'),
    (lambda: Belief([[[1, 0], [0, 0]], [[0.5, nan], [0.5, 0]]]), ValueError, 'joint.*cell 1'),
    (lambda: prior(hazard=1.5), ValueError, r'hazard.*1.5.*\[0, 1\]'),
    (lambda: prior(hazard=[0.5, 0.5]), ValueError, r'hazard.*shape \(2,\).*6'),
    (lambda: prior(hazard='0.5'), TypeError, "hazard is '0.5': it must be a number"),
    (lambda: prior(kappa=True), TypeError, 'kappa is True: it must be a number'),
    (lambda: prior(kappa=['0.8'] * 6), TypeError,
     r"kappa is \['0.8'.*: it must be an array of num"),
    (lambda: prior(kappa=['0.8', None] * 3), TypeError, 'kappa is .*: it must be an array of num'),
    (lambda: prior(hazard=[[0.1], [0.1, 0.2]]), TypeError,
     r'hazard is \[\[.*: it must be an array'),
    (lambda: prior(hazard=np.zeros(6, bool)), TypeError, r'hazard is a mask.*astype\(float\)'),
    (lambda: prior(target=np.ma.array([0.45] * 6, mask=[0, 1, 0, 0, 0, 0])), TypeError,
     r'target has masked values: give values to them, as with .filled\(0\)'),
    (lambda: prior(target=0.1), ValueError, 'cell 0'),
    (lambda: prior(hazard=[0, 0, 0, 0, 1, 0], target=0.8), ValueError, 'hazard of cell 4 is 1'),
    (lambda: Belief.prior(0.2, 0.3, 0.8, GRID), TypeError, 'grid is 0.2: it must be Grid'),
    (lambda: log_loss(np.full(3, 0.5), [True]), ValueError, 'truth has shape'),
    (lambda: brier_score(np.full(3, 0.5), [True]), ValueError, 'truth has shape'),
    (lambda: log_loss(PRIOR, WORLD.hazard), TypeError, 'probability is Belief.*Belief.hazard'),
    (lambda: log_loss(np.array([1.5]), [True]), ValueError, 'probability of cell 0 is 1.5'),
    (lambda: brier_score(np.array([nan]), [True]), ValueError, 'probability of cell 0 is nan'),
    # Sensors.
    (lambda: SensorModel('a'), TypeError, "lethality is 'a': it must be a number"),
    (lambda: SensorModel(0.5, None), TypeError, 'malfunction is None: it must be a number'),
    (lambda: MODEL.survival(['0.5']), TypeError,
     r"hazard is \['0.5'\]: it must be an array of nu"),
    (lambda: MODEL.reading(2), ValueError, r'target is 2.0: it must be a probability in \[0, 1\]'),
    (lambda: RobotType().model(0.5), TypeError, 'common is 0.5: it must be SensorModel'),
    # Worlds and executions.
    (lambda: World([False] * 3, [False] * 4), ValueError, 'target.*4.*3'),
    (lambda: World([], []), ValueError, 'hazard.*shape'),
    (lambda: World([[False], [True]], [[False], [True]]), ValueError, 'hazard.*shape'),
    (lambda: World([0.5, 0.0], [False, True]), ValueError, 'hazard.*0.5'),
    (lambda: World([False, True], [2, 0]), ValueError, 'target.*2'),
    (lambda: World([nan, 0.0], [False, True]), ValueError, 'hazard.*nan'),
    (lambda: fits([0, 0, 0], [0, 0, 0]), ValueError, 'world.*3 cells.*2 x 2'),
    (lambda: fits([0, 1, 0, 0], [0, 0, 0, 0]), ValueError, 'hazard.*base 1'),
    (lambda: fits([0, 0, 0, 1], [0, 0, 0, 0]), ValueError, 'cell 3.*blocked'),
    (lambda: fits([0, 0, 0, 0], [0, 0, 0, 1]), ValueError, 'cell 3.*blocked'),
    (lambda: World.random(GRID, 0.2, 0.8, 0.1, 1), TypeError, 'rng is 0.2: it must be a seed'),
    (lambda: WORLD.traverse([0, 16, 0], MODEL, 1), ValueError, 'path.*16.*0 to 15'),
    (lambda: Execution().traverse(WORLD, GRID, [0, 3, 0], MODEL, 1), ValueError, 'jumps'),
    (lambda: Execution().traverse(WORLD, Grid(5, 5), [0], MODEL, 1), ValueError, 'world has 16'),
    (lambda: Execution().traverse(WORLD, GRID, [0, 1, 0], 0.5, 1), TypeError, 'model is 0.5'),
    (lambda: Execution().traverse(WORLD, GRID, [0, 1, 0], MODEL, 1, changing=[1]), ValueError,
     r'changing has shape \(1,\): it must be \(16,\)'),
    # Observations.
    (observed([0, 1, 0], True), ValueError, 'readings.*missing.*each step'),
    (observed([0, 1, 0], True, [True]), ValueError, r'readings.*\(1,\).*2'),
    (observed([0, 1, 0], True, [[True, False]]), ValueError, r'readings.*\(1, 2\).*2'),
    (observed([0, 1, 0], True, [0.5, 1.0]), ValueError, r'readings.*0\.5.*True or False'),
    (observed([0, 1, 0], True, [nan, 0.0]), ValueError, 'readings.*nan.*True or False'),
    (observed([0, 1, 0], False, [True, False]), ValueError, 'readings.*lost.*none'),
    (observed([0, 1, 0], False, 'x'), ValueError, 'readings.*lost.*none'),
    (observed([0, 1, 0], True, [[1], [0, 1]]), TypeError, r'readings is .*: it must be an array'),
    (observed([0, 1, 0], [], [0, 0]), TypeError, r'survived is \[\]: it must be True or False'),
    (observed([0, 1, 0], False, lost_at='x'), TypeError, "lost_at is 'x': it must be an array"),
    (observed([0, -1, 0], False), ValueError, 'path.*-1.*from 0'),
    (observed([0, 1, 2], False), ValueError, 'path.*0.*2.*base'),
    *((observed([0, 1, 0], one), ValueError, 'survived') for one in (2, -1, 0.5, nan, 'y', None)),
    (observed([0, 1, 0], False, entered=[1, 1]), ValueError, 'entered is given, but .* was lost'),
    (observed([0, 1, 0], True, [1, 1], entered=[1]), ValueError,
     r'entered has shape \(1,\): it must be \(2,\)'),
    (observed([0, 1, 0], True, [1, 1], entered=[1, 2]), ValueError, 'entered'),
    (observed([0, 1, 0], True, [1, 1], entered=['x', 'y']), ValueError, 'entered'),
    (lost(lost_at=[1, 2]), ValueError, r'lost_at has shape \(2,\): it must be \(3,\)'),
    (lost(lost_at=[1, -2, 1]), ValueError, r'lost_at\[1\] is -2.0: it must be .* at least 0'),
    (lost(lost_at=[1, 1, nan]), ValueError, r'lost_at\[2\] is nan'),
    (lost(lost_at=[0, 0, 0]), ValueError, 'lost_at is 0 in all steps'),
    (lost(lost_at=[1, 0, 0], steps_survived=1), ValueError, 'lost_at is 0 in all .*the first 1,'),
    (lost(steps_survived=3), ValueError, 'steps_survived is 3.*at most 2'),
    (lost(steps_survived=-1), ValueError, 'steps_survived is -1.*at least 0'),
    (lost(steps_survived=1.5), ValueError, 'steps_survived is 1.5'),
    (back([1, 0, 1], lost_at=[1, 1, 2]), ValueError, 'lost_at is given, but the robot returned'),
    (back([1, 0, 1], steps_survived=1), ValueError, 'steps_survived is 1.*returned'),
    (back([1, 0, -2]), ValueError, 'readings is -2'),
    (back([-1, 0]), ValueError, 'readings has shape'),
    # Hazards that change, distributions, and types of robots.
    (lambda: Dynamics('growing'), ValueError, 'growing'),
    (lambda: Dynamics('static', appear=0.1), ValueError, 'appear is 0.1'),
    (lambda: Dynamics('used_up', vanish=0.1), ValueError, 'vanish is 0.1'),
    (lambda: Dynamics('changing', appear=-0.1), ValueError, 'appear is -0.1'),
    (lambda: Dynamics('changing', vanish=nan), ValueError, 'vanish is nan'),
    (lambda: Dynamics('changing', move=0.1), ValueError,
     'move is 0.1 and hazards are changing: only moving'),
    (lambda: Dynamics('moving', appear=0.1), ValueError,
     'appear is 0.1 and hazards are moving: only changing'),
    (lambda: Dynamics('moving', move=1.5), ValueError, 'move is 1.5'),
    (lambda: Dynamics('learn').known_rates(), ValueError, "dynamics is 'learn'"),
    (lambda: moving().known_rates(), ValueError, 'move is unknown, from 0.01 to 0.3: a world'),
    (lambda: Dynamics('changing', vanish=(0.2, 0.1)), ValueError,
     r'vanish is unknown within \(0.2, 0.1'),
    (lambda: Dynamics('changing', vanish=(0.0, 0.1)), ValueError,
     'it must satisfy 0 < low < high'),
    (lambda: Dynamics('moving', move=(0.5, 1.5)), ValueError, 'move is 1.5'),
    (lambda: Dynamics('changing', appear=(0.1, 0.2)), ValueError,
     'appear is .* it must be a number'),
    (lambda: Dynamics('static', vanish=(0.1, 0.2)), ValueError, 'only changing hazards use it'),
    (lambda: Estimator(FREE, MODEL, dynamics=Dynamics('learn')), ValueError,
     'moving hazards cannot be weighed: the prior has no grid'),
    (lambda: Estimator(FREE, MODEL, dynamics=Dynamics('moving', move=0.1)), ValueError,
     r'moving.*no grid.*Belief.prior\(grid'),
    (lambda: Estimator(PRIOR, MODEL, 'relaxed_bnitp', dynamics=Dynamics('learn')), ValueError,
     'relaxed_bnitp does not take hazards that are of an unknown kind: use relaxed_itp'),
    (lambda: Estimator(PRIOR, MODEL, SAMPLED, dynamics=Dynamics('learn')), ValueError,
     'kappa_bnitp_sampled does not take hazards that are of an unknown kind'),
    (lambda: mission(dynamics=moving()), ValueError,
     'move is unknown, from 0.01 to 0.3: a world needs a number'),
    *((partial(Unknowns, lethality=given), ValueError, words) for given, words in (
        ((0.2, 1.1), r'lethality is unknown within \(0.2, 1.1\): high is 1.1.*\[0, 1\]'),
        ((-0.1, 0.5), 'low is -0.1'),
        ((0.5, 0.5), 'from 0.5 to 0.5: it must end above its start'),
        ((0.1, nan), 'high is nan'),
        ((0.1, 0.2, 0.3), 'two numbers'),
        (0.5, 'two numbers'),
        (('a', 'b'), "low is 'a': it must be a number"),
    )),
    (learner({'hazard_density': (0, 1)}, 0.0), ValueError, 'hazard_density.*decides every cell'),
    (learner({'kappa': (0, 1)}, 0.5, 0.7, 1.0), ValueError, 'kappa.*decides every cell'),
    (learner({'kappa': (0, 1)}, 0.0), ValueError, 'kappa.*decides every cell'),
    (learner({'target_background': (0, 1)}, 0.5, 0.4, 0.8), ValueError,
     'target_background.*decides every cell'),
    (learner({'lethality': (0, 1)}, false_negative=1.0), ValueError, 'lethality.*strike'),
    (learner({'kappa': (0, 1)}, method='relaxed_itp'), ValueError,
     'kappa cannot be learnt by a method without kappa'),
    *((learner({'lethality': (0, 1)}, method=method), ValueError,
       'as given and cannot learn lethality')
      for method in ('relaxed_bnitp', 'kappa_bnitp_published')),
    *((partial(Beta, *given), ValueError, 'of a Beta is .*: it must be above 0')
      for given in ((0, 1), (1, -2), (inf, 1), (1, nan))),
    (lambda: RobotType(lethality=1.5), ValueError, 'lethality is 1.5.*probability'),
    (lambda: RobotType(false_positive=nan), ValueError, 'false_positive is nan.*probability'),
    (lambda: RobotType(max_steps=0), ValueError, 'max_steps is 0.*at least 1'),
    (lambda: RobotType(max_steps=2.5), ValueError, 'max_steps is 2.5.*whole'),
    (lambda: RobotType(loss_cost=-1.0), ValueError, 'loss_cost is -1.0.*at least 0'),
    *((partial(make, max_distance=wrong), ValueError, 'max_distance is .*: it must be at least 0')
      for make, wrong in product((SearchOptions, RobotType), (-1.0, inf, nan, 2e9))),
    # Methods and plans.
    *((partial(use, FREE, MODEL, seen), ValueError, 'path.*77.*0 to 15') for use, seen in (
        (update, Observation([0, 77, 0], False)), (core.path_information, [0, 77, 0]),
    )),
    # Impossible outcomes: losses that nothing explains, and returns and readings that cannot be.
    *((partial(seen_by, method, *case), ValueError, 'impossible')
      for method, case in product(LEARN_FROM_LOSSES, (
          ({'malfunction': 0.0}, 0.0, None),
          ({'malfunction': 0.0, 'lethality': 0.0}, 0.5, None),
          ({'malfunction': 1.0}, 0.5, [1, 1, 1]),
          ({'false_negative': 0.0, 'lethality': 1.0}, 1.0, [1, 1, 1]),
          ({'true_positive': 1.0, 'false_positive': 0.0}, 0.5, [1, 0, 1]),
      ))),
    (lambda: update(PRIOR, MODEL, [0, 1, 0]), TypeError, r'observation is \[0, 1, 0\]: it must'),
    (lambda: Estimator(GRID, MODEL), TypeError, 'belief is Grid.*: it must be Belief'),
    (lambda: Estimator(PRIOR, MODEL, unknowns='x'), TypeError, "unknowns is 'x': it must"),
    (lambda: Estimator(PRIOR, MODEL).assimilate([0]), TypeError, 'observation is .*: it must be'),
    (lambda: update(PRIOR, MODEL, observed([0, 1, 0], False)(), []), ValueError,
     r'method is \[\]'),
    (lambda: Estimator(PRIOR, MODEL).worlds(2, np.random.RandomState(1)), TypeError,
     'rng is Rand'),
    (lambda: METHODS['magic'], KeyError, "method is 'magic': known are relaxed_itp"),
    (lambda: METHODS[[]], KeyError, r'method is \[\]: known are relaxed_itp'),
    (lambda: clustered(clustering=Clustering(Grid(2, 8), 0.5)), ValueError,
     'clustering is of a grid of 2 x 8 cells: the prior has 4 x 4 cells'),
    (lambda: Estimator(PRIOR, MODEL, dict), TypeError, 'method dict: it must'),
    *((partial(Estimator, PRIOR, MODEL, SAMPLED, seed=seed), ValueError,
       f'seed is {seed}') for seed in (-1, 0.5)),
    (lambda: SearchOptions('baem'), ValueError, "planner is 'baem': known are relaxed, beam"),
    (lambda: SearchOptions(18), ValueError, 'planner is 18: known are relaxed, beam'),
    (lambda: SearchOptions(max_steps=0), ValueError, 'max_steps is 0.*at least 1'),
    (lambda: SearchOptions(max_steps=2.5), ValueError, 'max_steps is 2.5.*whole number'),
    (lambda: SearchOptions(max_visits=0), ValueError, 'max_visits is 0.*at least 1'),
    (lambda: SearchOptions(loss_cost=-1), ValueError, 'loss_cost is -1.*at least 0'),
    (lambda: SearchOptions(loss_cost=nan), ValueError, 'loss_cost is nan.*at most 1e9'),
    (lambda: SearchOptions(loss_cost=1e300), ValueError, r'loss_cost is 1e\+300.*at most 1e9'),
    (lambda: SearchOptions(max_steps=[3]), TypeError, 'max_steps is .3.: it must be a number'),
    (lambda: core.PathFinder(GRID, 'beam'), TypeError, "options is 'beam': it must be SearchOpt"),
    (lambda: core.plan((4, 4), PRIOR, MODEL), TypeError, r'grid is \(4, 4\): it must be Grid'),
    (lambda: core.plan(GRID, PRIOR, MODEL, 8), TypeError,
     r'options is 8: it must be SearchOptions\(max_steps=...\)'),
    (lambda: core.path_information(PRIOR, 0.5, [0, 1, 0]), TypeError, 'model is 0.5: it must be'),
    (lambda: core.path_information(PRIOR, MODEL, core.plan(GRID, PRIOR, MODEL)), ValueError,
     r'path is Plan\(.*: it must list at least two cells'),
    (lambda: planned(objective='behavioral'), ValueError,
     "'behavioral': it must be one of information, information_per_loss"),
    (lambda: planned(objective='information_per_loss', loss_cost=1.0), ValueError,
     'loss_cost is 1.0, and the objective information_per_loss finds it'),
    (lambda: planned(objective='information_per_loss', planner='random'), ValueError,
     'information_per_loss, but the planner random does not seek'),
    (lambda: mission(options=SearchOptions(objective='information_per_loss'),
                     team=Team(types=(RobotType(loss_cost=1.0),))), ValueError,
     'loss_cost is 1.0'),
    *((partial(planned, planner=name, max_distance=4.0), ValueError,
       f'but the planner {name} does not keep to it: choose')
      for name in ('random', 'coverage', 'shortest_unvisited')),
    *((partial(core.plan, GRID, PRIOR, MODEL, visited=visited), ValueError,
       'visited has shape .*for each of the 16 cells')
      for visited in ([1, 2], [-1] * 16, [0.5] * 16, np.zeros((4, 4), dtype=int))),
    *((partial(planned, planner=name, objective='information_per_loss'), ValueError,
       f'{name} does not seek it: choose the planner beam or relax')
      for name in ('random', 'coverage', 'shortest_unvisited')),
    (lambda: team(0), ValueError, 'agents is 0.*at least 1'),
    (lambda: team(1.5), ValueError, 'agents is 1.5.*whole number'),
    (lambda: team(16), ValueError, 'agents is 16.*15.*free cell'),
    (lambda: team(allocation='auction'), ValueError,
     'allocation.*auction(?=.*voronoi)(?=.*greedy)'),
    (lambda: team(in_flight=[([0, 16, 0], RobotType())]), ValueError,
     'path leaves the grid.*16'),
    (lambda: team(in_flight=[([0, 1, 0], RobotType()), ([0, 10, 0], RobotType())]), ValueError,
     'path jumps.*from cell 0 to 10'),
    (lambda: team(grid=Grid(5, 4)), ValueError, 'belief.*16.*20'),
    (lambda: Team(allocation='auction'), ValueError, "allocation is 'auction': known are indep"),
    (lambda: team(in_flight=3), TypeError, 'in_flight is 3: it must be a list'),
    (lambda: team(in_flight=[[0, 1, 0]]), TypeError,
     r'in_flight has \[0, 1, 0\]: it must have \(path, RobotType\(...\)\)'),
    (lambda: team(in_flight=[([0, 1, 0], None)]), TypeError, r'in_flight has \(\[0, 1, 0\], None'),
    (lambda: team(rng='x'), TypeError, "rng is 'x': it must be a seed"),
    (lambda: together([0, 3, 0]), ValueError, r'path\[1\] jumps at step 1, from cell 0 to 3'),
    (lambda: together([0, 1]), ValueError,
     r'path\[1\] starts at cell 0 and ends at 1: it must re'),
    (lambda: together([0, 5, 6, 5, 0]), ValueError, r'path\[1\] enters a blocked cell'),
    (lambda: together(None), ValueError, r'path\[1\] is None: it must list at least two cells'),
    (lambda: core.team_information(PRIOR, MODEL, 3), ValueError, 'path is 3: it must list'),
    (lambda: core.Plan.along([0, 3, 0], PRIOR, MODEL), ValueError, 'path jumps at step 1'),
    (lambda: core.Plan([0, 1, 0], 'x', 0.5), TypeError, "information is 'x': it must be a number"),
    (lambda: core.Plan([0, 1, 0], 1.0, 1.5), ValueError, 'survival is 1.5: .* a probability'),
    (lambda: core.Plan([0, 1, 0], 1.0, 0.5, nan), ValueError, 'gain is nan: it must be finite'),
    (lambda: team(types=[RobotType(loss_cost=1.0)]), ValueError,
     'has 1 values: it must have 2, one for each robot'),
    (lambda: team(7, types=[RobotType(true_positive=0.9 + n / 100) for n in range(7)]),
     ValueError, '7 different cameras.*at most 6'),
    # Goals and stops.
    (lambda: mission(options=SearchOptions(max_steps=6, max_distance=5.0), goal=Area([1, 2])),
     ValueError, 'max_distance is 5 m, but paths for the goal area do'),
    (lambda: goal(Lane(24, 1.0)), ValueError, 'confidence is 1.0'),
    (lambda: goal(Area([3], 0.0)), ValueError, 'confidence is 0.0'),
    (lambda: goal(Area([])), ValueError, 'without cells'),
    (lambda: Area(3), TypeError, 'cells is 3: it must be a list'),
    (lambda: Area(b'x'), TypeError, "cells is b'x': it must be a list"),
    (lambda: Lane(3, '0.9'), TypeError, "confidence is '0.9': it must be a number"),
    (lambda: core.safest_path(GRID, 3, MODEL, 0, 5, 4), TypeError,
     'draws is 3: it must be Hazard'),
    (lambda: core.safest_path(Grid(5, 5), DRAWS, MODEL, 0, 5, 4), ValueError,
     'draws are of 16 cells: the grid has 25'),
    (lambda: DRAWS.p_free([-1]), ValueError, 'cells has the cell -1: .* the cells 0 to 15'),
    (lambda: DRAWS.hazard_count(['a']), TypeError, r"cells is \['a'\]: it must be of cells"),
    (lambda: DRAWS.survival([0, 16, 0], MODEL), ValueError, 'path has the cell 16'),
    (lambda: HazardDraws([[True]], 1.0), TypeError,
     r'hazardous is \[\[True\]\]: it must be bools'),
    (lambda: HazardDraws(DRAWS.hazardous, 'x'), TypeError, "independent is 'x': it must be a num"),
    (lambda: HazardDraws.of(PRIOR, 0), TypeError, r'estimator is Belief.*: it must be Estimator'),
    (lambda: core.targets(PRIOR, MODEL, [0]), TypeError, 'observations has 0: it must have Obs'),
    (lambda: core.targets(PRIOR, MODEL, [], 'x'), TypeError, "least is 'x': it must be a number"),
    (lambda: goal(Lane(0)), ValueError, 'the base'),
    (lambda: goal(Lane(25)), ValueError, 'off the map'),
    (lambda: goal(Lane(3)), ValueError, 'obstacle'),
    (lambda: goal(Lane(4)), ValueError, 'no way leads'),
    (lambda: goal(Lane(20)), ValueError, 'max_steps = 3'),
    (lambda: goal(Area([20])), ValueError, 'max_steps = 3'),
    (lambda: goal(Lane(6, 0.999), method='kappa_bnitp_sampled'), ValueError,
     'confidence is 0.999: with draws of the hazards .* ask for at most 0.998'),
    (lambda: goal(Lane(6, 0.9999), learning=Learning(Unknowns(lethality=(0.0, 1.0)))), ValueError,
     'with 192 particles of the learnt numbers .* ask for at most 0.9995'),
    (lambda: Mixture([0.5], [1.0]), ValueError, r'hazard has shape \(1,\): it must be \(hypoth'),
    (lambda: Mixture([[0.5]], [0.5, 0.5]), ValueError, r'weights has shape \(2,\): it must be'),
    (lambda: Mixture([[0.5]], [0.9]), ValueError, 'weights has the sum 0.9: it must be 1'),
    (lambda: Mixture([[1.5]], [1.0]), ValueError, 'hazard is 1.5'),
    (lambda: Stop(gain=-1.0), ValueError, 'stop.gain is -1.0'),
    (lambda: Stop(losses=-1), ValueError, 'stop.losses is -1'),
    (lambda: Stop(losses=1.5), ValueError, 'stop.losses is 1.5'),
    # Missions and forecasts.
    (lambda: mission(-1), ValueError, 'robots is -1.*at least 0'),
    (lambda: mission(1.5), ValueError, 'robots is 1.5.*whole number'),
    (lambda: mission(rng='a'), TypeError, "rng is 'a': it must be a seed"),
    (lambda: mission(method='magic'), ValueError, 'method.*magic.*kappa_bnitp'),
    (lambda: mission(team=Team(0)), ValueError, 'agents is 0.*at least 1'),
    (lambda: mission(team=Team(16)), ValueError, 'agents is 16.*15.*free cell'),
    (lambda: mission(grid=Grid(5, 5)), ValueError, 'world.*16 cells.*5 x 5'),
    (lambda: mission(2, stop=Stop(losses=9)), ValueError, 'stop.losses is 9'),
    (lambda: mission(goal='lane'), TypeError, r"goal is 'lane': it must be Lane\(...\) or Area"),
    (lambda: mission(goal=Lane), TypeError, r'goal is <class.*: it must be Lane\(...\) or Area'),
    (lambda: mission(stop=0.9), TypeError, r'stop is 0.9: it must be Stop\(...\)'),
    (lambda: mission(team=2), TypeError, r'team is 2: it must be Team\(...\)'),
    (lambda: mission(options='beam'), TypeError, "options is 'beam': it must be SearchOptions"),
    (lambda: mission(truth=MODEL), TypeError, 'truth is SensorModel.*: it must be Truth'),
    (lambda: mission(learning=Unknowns()), TypeError, 'learning is Unknowns.*: it must be Lear'),
    (lambda: mission(dynamics='changing'), TypeError, "dynamics is 'changing': it must be Dyn"),
    (lambda: run_mission(PRIOR, GRID, MODEL, WORLD, 1, 1), TypeError, 'grid is Belief.*: it must'),
    (lambda: Truth(0.5), TypeError, 'model is 0.5: it must be SensorModel'),
    (lambda: Learning({'kappa': (0, 1)}), TypeError, r'unknowns is \{.kappa.*: it must be Unk'),
    (lambda: Learning(seed='x'), TypeError, "seed is 'x': it must be a number"),
    (lambda: forecast(before=3), TypeError, 'before is 3: it must be a list of Observation'),
    (lambda: forecast(run=3), TypeError, 'run is 3: it must be callable, as map is'),
    (lambda: core.forecast(Grid(5, 5), Estimator(PRIOR, MODEL), 1, 1, 1, goal=Lane(5)),
     ValueError, 'belief has 16 cells: the grid has 25'),
    (lambda: core.Ledger(3, 4, None), TypeError, 'grid is 3: it must be Grid'),
    (lambda: core.Ledger(GRID, 4, None, {'a': 3}), TypeError, 'robot type is 3: it must be Robot'),
    (lambda: core.Ledger(GRID, 4, None).record_path('a', [0, 1, 0]), TypeError,
     "key is 'a': it must be DeploymentKey"),
    (lambda: forecast(robots=0), ValueError, 'robots is 0: .*at least 1'),
    (lambda: forecast(worlds=0), ValueError, 'worlds is 0: .*at least 1'),
    (lambda: forecast(goal=Lane(6)), ValueError, 'cell 6, an obstacle'),
    (lambda: forecast(goal=Lane(15), options=SearchOptions(max_steps=2)), ValueError,
     'at most max_steps = 2'),
    (lambda: forecast(stop=Stop(losses=9)), ValueError, 'stop.losses is 9'),
    (lambda: core.forecast(GRID, PRIOR, 3, 2, 1), TypeError, 'estimator is Belief.*: it must be'),
    # Functions in place of names.
    (lambda: mission(options=SearchOptions(lambda: 3, 8)), TypeError,
     r'planner .*<lambda>: it must be callable with \(finder'),
    (lambda: mission(options=SearchOptions(lambda f, o: [], 8)), PluginError,
     'planner .*<lambda>.* of test_arguments returns no path'),
    (lambda: mission(options=SearchOptions(lambda f, o: [0, 1, 0], 8)), PluginError,
     r'finds 0: it must return a list of Candidate.along\(path, objective\)'),
    (lambda: mission(options=SearchOptions(lambda f, o: [[0, 1, 0]], 8)), PluginError,
     r'finds \[0, 1, 0\]: it must return a list of Candidate'),
    (lambda: mission(options=SearchOptions(lambda f, o: np.array([0, 1, 0]), 8)), PluginError,
     r'returns array\(\[0, 1, 0\]\): it must be a list of Candidate'),
    # What users write loops with: missions, paths, cells, masks and generators.
    (lambda: sent('beam'), ValueError, "path is 'beam': it must list at least two cells"),
    (lambda: sent([[0, 1, 0]]), ValueError, r'path is \[\[0, 1, 0\]\]: it must list at least two'),
    (lambda: sent([0, [1, 2], 0]), ValueError, 'path is .* it must list at least two cells'),
    (lambda: sent([0, 1.5, 0]), ValueError, 'path is of type float64: cells are whole numbers'),
    (lambda: sent([0, 1]), ValueError, 'path must end at the base 0, not at cell 1'),
    (lambda: sent([0, 3, 0]), ValueError, r'path jumps at step 1.* one of \[0, 1, 4, 5\]'),
    (lambda: sent([0, 16, 0]), ValueError, 'path leaves the grid.*16, allowed are 0 to 15'),
    (lambda: sent([0, 1, 0], 'scout'), TypeError, r"robot_type is 'scout': it must be RobotType"),
    (lambda: sent([0, 1, 0], RobotType(base=3)), ValueError, 'base 3 is not a base.*add it'),
    (lambda: begun().run(-1), ValueError, 'robots is -1: .*at least 0'),
    (lambda: begun().run(True), TypeError, 'robots is True: it must be a number'),
    (lambda: begun().run(1, team=2), TypeError, r'team is 2: it must be Team\(...\)'),
    (lambda: begun(options='beam'), TypeError, "options is 'beam': it must be SearchOptions"),
    (lambda: begun(rng=None), TypeError, 'rng is None: .*default_rng'),
    (lambda: begun(rng=True), TypeError, 'rng is True: it must be a seed'),
    (lambda: begun(rng=np.random.RandomState(1)), TypeError,
     'rng is RandomState.*: it must be a seed.* numpy.random.default_rng'),
    (lambda: Estimator(PRIOR, MODEL).draws(2, np.random.RandomState(1)), TypeError, 'rng is Rand'),
    (lambda: core.plan(GRID, PRIOR, MODEL, rng='x'), TypeError, "rng is 'x': it must be a seed"),
    (lambda: begun(grid=Grid(2, 8), world=World(*np.zeros((2, 16)))), ValueError,
     r'belief is of a grid of 4 x 4 cells: the grid has 2 x 8; make it with Belief.prior'),
    (lambda: core.Mission.resume(GRID, PRIOR, WORLD, 1), TypeError, 'estimator is Belief'),
    (lambda: core.Mission.resume(GRID, Estimator(PRIOR, MODEL), WORLD, 1, before=[[0, 1, 0]]),
     TypeError, r'before has \[0, 1, 0\]: it must have Observation'),
    (lambda: informed([0, 1]), ValueError, 'path starts at cell 0 and ends at 1: it must return'),
    (lambda: informed([0, 3, 0]), ValueError, r'path jumps at step 1.*one of \[0, 1, 4, 5\]'),
    (lambda: informed([0, 16, 0]), ValueError, 'path has the cell 16: .* 0 to 15'),
    (lambda: informed([[0, 0], [0, 3, 0]]), ValueError, r'path\[1\] jumps at step 1'),
    (lambda: informed([[0, 0], [0, 5, 6, 5, 0]]), ValueError, r'path\[1\] enters a blocked cell'),
    (lambda: informed([[0, 0], [0, -1, 0]]), ValueError, r'path\[1\] has the cell -1'),
    (lambda: informed([[0, 0], [0, 1.0, 0]]), ValueError, r'path\[1\] is of type float64'),
    (lambda: informed([[0, 0], [0]]), ValueError, r'path\[1\] is \[0\]: it must list at least'),
    (lambda: informed([[0, 0], 5]), ValueError, r'path\[1\] is 5: it must list at least'),
    (lambda: informed(np.zeros((2, 3))), ValueError, r'path\[0\] is of type float64'),
    (lambda: informed([]), ValueError, r'path is \[\]: it must list at least two'),
    (lambda: informed(None), ValueError, 'path is None: it must list at least two'),
    (lambda: GRID.cell(4, 0), ValueError, 'row is 4: it must be a whole number from 0 to 3'),
    (lambda: GRID.cell(0, -1), ValueError, 'col is -1: .*from 0 to 3'),
    (lambda: GRID.row_col(16), ValueError, 'cell is 16: .*from 0 to 15'),
    (lambda: following([]), ValueError, r'path is \[\]: it must list cells, the base first'),
    (lambda: following([1, 2]), ValueError, 'path is .*must start at the base 0'),
    (lambda: following([0] * 6), ValueError, 'path is .*at most max_steps = 4'),
    (lambda: following([0, 3]), ValueError, 'path jumps at step 1'),
    (lambda: core.PathFinder(GRID, SearchOptions(), rng='x'), TypeError, "rng is 'x': it must"),
    (lambda: GRID.at([]), TypeError, r'base is \[\]: it must be a number'),
    (lambda: GRID.check_path([0, 1, 0], 'x'), TypeError, "max_steps is 'x': it must be a number"),
    (lambda: GRID.check_path([0, 1, 0], 4, nan), ValueError, 'max_distance is nan: it must be at'),
    (lambda: GRID.in_reach(None), TypeError, 'max_steps is None: it must be a number'),
    (lambda: GRID.centers([16]), ValueError, 'cells has the cell 16: .* the cells 0 to 15'),
    (lambda: GRID.centers([1.5]), TypeError, r'cells is \[1.5\]: it must be of cells, whole num'),
    (lambda: GRID.cells_at('x'), TypeError, "points is 'x': it must be an array of numbers"),
    (lambda: grid(blocked=np.zeros(11, bool)), ValueError,
     r'blocked is a mask of shape \(11,\): it must be \(12,\) or \(3, 4\), or a list of cell'),
    (lambda: grid(blocked=np.zeros((4, 3), bool)), ValueError, r'shape \(4, 3\).*\(3, 4\)'),
    (lambda: grid(blocked=np.zeros(12)), ValueError, 'blocked is a mask of numbers.*astype.bool'),
    (lambda: grid(blocked=[True, 3]), TypeError, 'blocked cell is True: it must be a number'),
    (lambda: planned(keepout=np.zeros(15, bool)), ValueError, r'keepout is a mask.*\(16,\) or'),
    (lambda: planned(keepout=[99]), ValueError, 'keepout cell is 99: .*from 0 to 15'),
    (lambda: planned(keepout=[0]), ValueError, 'base is 0: it must be a free cell'),
    (lambda: SearchOptions(keepout=3), TypeError, 'keepout is 3: it must be a list'),
    (lambda: SearchOptions(keepout='ab'), TypeError, "keepout is 'ab': it must be a list"),
    (lambda: SearchOptions(keepout=['a']), TypeError, "keepout cell is 'a': it must be a number"),
    (lambda: SearchOptions(keepout=[-1]), ValueError, 'keepout cell is -1: .* at least 0'),
    (lambda: SearchOptions(keepout=[0.5]), ValueError, 'keepout cell is 0.5: .* at least 0'),
    (lambda: SearchOptions(keepout=[True, 2]), TypeError, 'keepout cell is True: it must be a nu'),
    (lambda: SearchOptions(keepout=np.zeros((4, 4))), TypeError, r'keepout cell is \[0.0, '),
    (lambda: SearchOptions(objective=[]), ValueError, r'objective is \[\]: it must be one of'),
    (lambda: SearchOptions(width=0), ValueError, 'width is 0: .* labels of each cell and step'),
    (lambda: SearchOptions(width=2.5), ValueError, 'width is 2.5: .* labels of each cell'),
    (lambda: SensorModel(True), TypeError, 'lethality is True: it must be a number'),
    (lambda: SensorModel(np.array([0.5])), TypeError, r'lethality is array\('),
    (lambda: grid(resolution='a'), TypeError, "resolution is 'a': it must be a number"),
    (lambda: grid(origin=3), ValueError, 'origin is 3: it must be two finite numbers'),
    (lambda: grid(yaw=None), TypeError, 'yaw is None: it must be a number'),
    (lambda: grid(origin=[[0, 1], [0]]), TypeError, r'origin is \[0, 1\]: it must be a number'),
    (lambda: grid(connectivity=[4, 8]), TypeError, r'connectivity is \[4, 8\]: it must be a num'),
    (lambda: grid(through_corners=[]), TypeError, r'through_corners is \[\]: it must be True or'),
    (lambda: grid(blocked='x'), TypeError, "blocked is 'x': it must be a list"),
    (lambda: Dynamics(np.zeros(2)), ValueError, 'dynamics is array.*: it must be one of static'),
    (lambda: Dynamics('changing', [[0], [0, 1]]), ValueError, 'appear is .*: it must be a number'),
    (lambda: grid(through_corners='no'), ValueError, 'through_corners is no: it must be True or'),
    (lambda: Beta('a'), TypeError, "a of a Beta is 'a': it must be a number"),
    (lambda: Belief('x'), TypeError, "joint is 'x': it must be an array of numbers"),
    (lambda: Belief(PRIOR.joint, Grid(3, 3)), ValueError, 'grid is Grid.*: .* 16 cells'),
    (lambda: PRIOR.on(Grid(5, 5)), ValueError, 'belief has 16 cells: the grid has 25'),
    (lambda: Team(2, types=['a', 'b']), TypeError, "robot type is 'a': it must be RobotType"),
    (lambda: Team(types=3), TypeError, 'robot_types is 3: it must be a list of RobotType'),
    (lambda: core.Plan.along([0, 1, 0], PRIOR, 0.5), TypeError, 'model is 0.5: it must be Sensor'),
    *NO_PROBABILITIES,
])  # fmt: skip
def test_a_wrong_argument_is_refused(make, error, words):
    with pytest.raises(error, match=words) as refused:
        make()
    assert '\n' not in str(refused.value)
