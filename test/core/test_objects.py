# SPDX-License-Identifier: Apache-2.0
"""Objects of the core are copied, compared and shown, and leave their caller's arrays alone."""

from copy import deepcopy
import pickle

from kbnitp_ros import core
from kbnitp_ros.core import (
    Belief,
    Estimator,
    Grid,
    Learning,
    Observation,
    plan_team,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Unknowns,
    update,
    World,
)
from kbnitp_ros.core.field.unknowns import Bins
from kbnitp_ros.figures import plot
from laws import for_each
import numpy as np
import pytest

GRID = Grid(4, 4, blocked=[6])
PRIOR = Belief.from_maps(
    np.where(np.arange(16) > 0, 0.15, 0.0), np.full(16, 0.2), np.full(16, 0.8)
)
MODEL = SensorModel(0.5)
WORLD = World.random(GRID, 1, 0.15, 0.8, 0.1)
OPTIONS = SearchOptions(max_steps=8)


def mission(method='kappa_bnitp', options=OPTIONS, robots=4, **other):
    return run_mission(GRID, PRIOR, MODEL, WORLD, robots, 1, method, options, **other)


LEARNING = Learning(Unknowns(lethality=(0.0, 1.0)))


@pytest.fixture(scope='module')
def learnt():
    return mission('kappa_bnitp_sampled', learning=LEARNING)


def test_a_copy_is_equal_and_another_value_is_not(learnt):
    for value in (
        GRID,
        PRIOR,
        MODEL,
        WORLD,
        OPTIONS,
        LEARNING,
        learnt,
        learnt[0],
        learnt[0].parameters['lethality'],
        learnt[0].observation,
        *plan_team(GRID, PRIOR, MODEL, Team(2, 'voronoi'), OPTIONS),
        Team(2),
        core.Execution(detour=0.1).traverse(WORLD, GRID, learnt[0].plan.path, MODEL, 3),
        core.Truth(),
        core.RobotType(),
    ):
        for copied in (pickle.loads(pickle.dumps(value)), deepcopy(value)):
            assert (copied == value) is True
            assert type(copied) is type(value)
        assert (value == object()) is False
        assert len(repr(value)) < 700


def test_values_and_their_arrays_cannot_be_changed(learnt):
    path, joint = np.array([0, 1, 0]), PRIOR.joint.copy()
    observation, belief = Observation(path, True, [1, 0]), Belief(joint)
    for value, fields, arrays in (
        (GRID, ['base'], []),
        (MODEL, ['lethality'], []),
        (belief, ['joint'], ['joint']),
        (WORLD, ['hazard'], ['hazard', 'target']),
        (observation, ['survived'], ['path', 'readings']),
        (learnt[0].plan, ['information'], ['path']),
    ):
        for field in fields:
            with pytest.raises(AttributeError):
                setattr(value, field, getattr(value, field))
        for array in arrays:
            with pytest.raises(ValueError, match='read-only'):
                getattr(value, array)[0] = 0
    path[1], joint[3] = 2, 0.25
    assert observation.path.tolist() == [0, 1, 0]
    assert belief == PRIOR


def fold(path):
    core.Ledger(GRID, 4, Estimator(PRIOR, MODEL)).record_path(core.DeploymentKey('a', 1), path)


PATH, READ = np.array([0, 1, 0]), np.array([True, False])
MAPS = [np.full(16, 0.2), np.full(16, 0.4), np.full(16, 0.7)]


@for_each('use, arrays', [
    (lambda path, *given: Observation(path, True, given[0], entered=given[1]), [PATH, READ, READ]),
    (lambda path, at: Observation(path, False, lost_at=at), [PATH, np.array([0.5, 1.0])]),
    (World, [READ.repeat(8), READ.repeat(8)]),
    (Belief, [PRIOR.joint]),
    (Belief.from_maps, MAPS),
    (lambda *maps: Belief.prior(GRID, *maps), MAPS),
    (lambda blocked: Grid(3, 3, blocked=blocked).free, [np.array([4])]),
    (lambda path: core.Plan(path, 1.0, 0.5), [PATH]),
    (lambda draws, weight: core.HazardDraws(draws, 4.0, weight),
     [np.zeros((4, 9), dtype=bool), np.full(4, 0.25)]),
    (Bins, [np.array([0.0, 1.0]), np.array([0.5]), np.zeros(1)]),
    (lambda path, read: update(PRIOR, MODEL, Observation(path, True, read)), [PATH, READ]),
    (fold, [PATH]),
    (lambda visited: core.plan(GRID, PRIOR, MODEL, visited=visited), [np.zeros(16, int)]),
])  # fmt: skip
def test_arrays_of_the_caller_stay_as_they_are(use, arrays):
    given = [array.copy() for array in arrays]
    use(*given)
    for array, before in zip(given, arrays):
        assert array.flags.writeable
        assert np.array_equal(array, before)
        array[...] = array


def test_beliefs_that_differ_in_the_last_bit_are_different(learnt):
    joint = PRIOR.joint.copy()
    joint[3] = np.nextafter(joint[3], 1.0)
    assert Belief(joint) != PRIOR
    assert learnt[0] != learnt[1]


def test_estimators_are_copied_with_their_state():
    for method in core.METHODS:
        estimator = Estimator(PRIOR, MODEL, method)
        lost = Observation([0, 1, 2, 1, 0], survived=False)
        estimator.assimilate(lost)
        for copied in (pickle.loads(pickle.dumps(estimator)), deepcopy(estimator)):
            again = estimator.copy()
            for copy in (copied, again):
                copy.assimilate(Observation([0, 1, 0], survived=True, readings=[1, 0]))
            assert copied.belief == again.belief, method
        assert method in repr(estimator)


def test_the_same_seed_is_the_same_world_as_its_generator():
    assert World.random(GRID, np.random.default_rng(1), 0.15, 0.8, 0.1) == WORLD
    path = [0, 1, 0]
    assert WORLD.traverse(path, MODEL, 5) == WORLD.traverse(path, MODEL, np.random.default_rng(5))


def test_a_mission_is_a_table(learnt):
    table = learnt.to_dataframe()
    assert table.index.tolist() == [1, 2, 3, 4]
    assert table['survived'].tolist() == [each.observation.survived for each in learnt]
    assert table['path'].tolist() == [each.plan.path.tolist() for each in learnt]
    assert table['lethality'].tolist() == [each.parameters['lethality'].mean for each in learnt]
    assert table['hazard_log_loss'].iloc[-1] == core.log_loss(
        learnt[-1].belief.hazard, WORLD.hazard
    )
    assert len(mission(robots=0).to_dataframe()) == 0


def test_a_belief_is_drawn_with_the_truth_and_paths(learnt):
    axes = plot(GRID, PRIOR, WORLD, [[0, 1, 0], learnt[0].observation])
    assert [axis.get_title() for axis in axes] == ['hazard', 'target', 'kappa']
    # The base, two paths and the true hazards.
    assert len(axes[0].lines) == 4
    with pytest.raises(ValueError, match='belief has 16 cells: the grid has 4'):
        plot(Grid(2, 2), PRIOR)
    with pytest.raises(ValueError, match='axes are 1: there must be 3'):
        plot(GRID, PRIOR, axes=axes[:1])
