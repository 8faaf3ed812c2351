# SPDX-License-Identifier: Apache-2.0
"""Worlds, sensors, executions and observations of robots."""

import math

import brute_force
from kbnitp_ros.core import Execution, Grid, SensorModel, World
from laws import for_each
import numpy as np
import pytest

SIGMAS = 5


def assert_share(count, of, probability):
    spread = math.sqrt(of * probability * (1 - probability))
    assert abs(count - of * probability) <= SIGMAS * spread + 1e-9


def draw(grid, rng, **densities):
    return World.random(
        grid, rng, **{'hazard_density': 0.15, 'kappa': 0.8, 'target_background': 0.1, **densities}
    )


def test_random_worlds_have_the_densities_asked_for():
    grid = Grid(100, 100, base=42, blocked=(7, 9))
    world = draw(grid, np.random.default_rng(1))
    free = np.delete(np.arange(10000), [7, 9, 42])
    hazard, target = world.hazard[free], world.target[free]
    assert world.hazard.dtype == world.target.dtype == bool
    assert world.hazard.shape == world.target.shape == (10000,)
    assert_share(hazard.sum(), len(free), 0.15)
    assert_share(target[hazard].sum(), hazard.sum(), 0.8)
    assert_share(target[~hazard].sum(), (~hazard).sum(), 0.1)


def test_no_world_has_a_hazard_at_the_base_or_anything_in_a_blocked_cell():
    grid = Grid(3, 3, base=4, blocked=(0, 8))
    full = {'hazard_density': 1.0, 'kappa': 1.0, 'target_background': 1.0}
    world = draw(grid, np.random.default_rng(0), **full)
    assert world.hazard.tolist() == [False, True, True, True, False, True, True, True, False]
    assert world.target.tolist() == [False] + [True] * 7 + [False]


def test_the_base_holds_a_target_as_any_cell_without_hazard():
    rng = np.random.default_rng(2)
    targets = sum(draw(Grid(1, 1), rng, target_background=0.3).target[0] for _ in range(2000))
    assert_share(targets, 2000, 0.3)


HAZARD = [False, True, False, True]
TARGET = [False, True, True, False]


@pytest.mark.slow
@for_each('path', [[0, 1, 2, 0], [0, 1, 1, 3, 0], [0, 2, 2, 0], [0, 0]])
@for_each('sensors', [(0.3,), (0.6, 0.2, 0.3, 0.7, 0.4), (0.05, 0.0)])
def test_robots_return_and_report_as_often_as_predicted(path, sensors):
    world, model, runs = World(HAZARD, TARGET), SensorModel(*sensors), 1000
    rng = np.random.default_rng(7)
    seen = [world.traverse(path, model, rng) for _ in range(runs)]
    assert all(observation.path.tolist() == path for observation in seen)
    returned = [observation.readings for observation in seen if observation.survived]
    s0, s1 = brute_force.step_survival(model)
    assert_share(len(returned), runs, math.prod(s1 if HAZARD[cell] else s0 for cell in path[1:]))
    off, on = brute_force.detection(model)
    for step, cell in enumerate(path[1:]):
        positive = sum(bool(readings[step]) for readings in returned)
        assert_share(positive, len(returned), on if TARGET[cell] else off)
    assert all(o.readings is None for o in seen if not o.survived)


def test_readings_of_one_cell_are_drawn_afresh_each_visit():
    model = SensorModel(0.0, malfunction=0.0, true_positive=0.5)
    rng = np.random.default_rng(0)
    world = World([False, False], [False, True])
    pairs = [world.traverse([0, 1, 1, 0], model, rng).readings[:2] for _ in range(2000)]
    assert_share(sum(bool(a) == bool(b) for a, b in pairs), 2000, 0.5)


def test_defaults_are_those_of_the_paper():
    model = SensorModel(0.5)
    assert (model.lethality, model.malfunction, model.false_negative) == (0.5, 0.05, 0.05)
    assert (model.true_positive, model.false_positive) == (0.95, 0.05)


GRID = Grid(5, 4, base=6, blocked=(8, 13), through_corners=False)
MODEL = SensorModel(lethality=0.5, malfunction=0.02)
WORLD = World.random(GRID, np.random.default_rng(3), 0.3, 0.8, 0.2)
PATH = [6, 7, 2, 3, 4, 4, 3, 2, 1, 6]


def runs(execution, count=400, model=MODEL):
    return [
        execution.traverse(WORLD, GRID, PATH, model, np.random.default_rng(seed))
        for seed in range(count)
    ]


def test_an_obedient_robot_has_the_fate_of_the_world_alone():
    for seed, made in enumerate(runs(Execution(), 100)):
        expected = WORLD.traverse(PATH, MODEL, np.random.default_rng(seed))
        found = made.observation
        assert made.walk.tolist() == PATH
        assert (found.survived, found.steps_survived) == (expected.survived, 0)
        if expected.survived:
            assert found.readings.tolist() == expected.readings.tolist()
            assert made.steps_made == len(PATH) - 1


@for_each(
    'execution',
    [Execution(detour=0.4), Execution(early_return=0.2), Execution(0.3, 0.1, 0.3, 0.1)],
)
def test_every_walk_is_a_path(execution):
    made = runs(execution)
    for run in made:
        walk = GRID.check_path(run.walk)
        if run.observation.survived:
            assert run.observation.path.tolist() == walk.tolist()
        else:
            assert run.observation.path.tolist() == PATH
            assert run.steps_made < len(walk) - 1
    assert {deployment.observation.survived for deployment in made} == {True, False}
    assert len({tuple(each.walk) for each in made}) > 5


def test_a_detour_passes_every_cell_of_the_path():
    longer = [made.walk.tolist() for made in runs(Execution(detour=0.3))]
    for walk in longer:
        rest = iter(walk)
        assert all(cell in rest for cell in PATH)
    assert max(map(len, longer)) > len(PATH) + 2


def test_a_robot_that_turns_back_takes_a_shortest_way_home():
    walks = [made.walk.tolist() for made in runs(Execution(early_return=0.3))]
    for walk in walks:
        assert walk == PATH or any(
            walk[: i + 1] == PATH[: i + 1] and len(walk) - 1 - i == GRID.steps_to_base[PATH[i]]
            for i in range(1, len(walk))
        )
    assert len({len(walk) for walk in walks}) > 3


def test_a_last_contact_is_never_wrong():
    heard = [made for made in runs(Execution(0.3, 0.05, 0.5)) if not made.observation.survived]
    for made in heard:
        known = made.observation.steps_survived
        rest = iter(made.walk[: made.steps_made + 1].tolist())
        assert all(cell in rest for cell in PATH[: known + 1])
    assert len({made.observation.steps_survived for made in heard}) > 3


def test_certain_contact_states_each_step():
    for made in runs(Execution(contact=1.0)):
        if not made.observation.survived:
            assert made.observation.steps_survived == made.steps_made
            expected = np.arange(len(PATH) - 1) == made.steps_made
            if made.steps_made < len(PATH) - 2:
                assert (made.observation.lost_at == expected).all()


@pytest.mark.slow
def test_silence_after_a_contact_has_the_right_probabilities():
    """After the same last contact, losses in each step are as frequent as `lost_at` says."""
    contact, safe = 0.4, SensorModel(lethality=0.0, malfunction=0.2)
    counts = np.zeros(len(PATH) - 1)
    for made in runs(Execution(contact=contact), 8000, safe):
        if not made.observation.survived and made.observation.steps_survived == 1:
            counts[made.steps_made] += 1
            lost_at = made.observation.lost_at
    # Malfunctions also reduce the probability to be lost in a later step.
    expected = lost_at * 0.8 ** np.arange(lost_at.size)
    assert counts / counts.sum() == pytest.approx(expected / expected.sum(), abs=0.03)
    assert lost_at[1:] / lost_at[1] == pytest.approx((1 - contact) ** np.arange(len(PATH) - 2))


def test_a_camera_fails_for_the_rest_of_the_way():
    read = [
        made.observation.readings
        for made in runs(Execution(camera_failure=0.2))
        if made.observation.survived
    ]
    for readings in read:
        unseen = (readings == -1).tolist()
        assert unseen == sorted(unseen)
    assert {(-1 in readings) for readings in read} == {True, False}


def test_deviations_are_as_frequent_as_stated():
    safe = SensorModel(lethality=0.0, malfunction=0.0)
    walks = [made.walk for made in runs(Execution(early_return=0.25), 4000, safe)]
    kept = np.mean([len(walk) == len(PATH) for walk in walks])
    # The last step home is the same with and without turning back.
    assert kept == pytest.approx(0.75**7, abs=0.02)
