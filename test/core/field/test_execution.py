# SPDX-License-Identifier: Apache-2.0
"""Robots that depart from their orders make walks all the same, and tell what they may."""

from itertools import product

from kbnitp_ros.core import Belief, Execution, Grid, plan, SensorModel, World
from laws import for_each
import numpy as np
import pytest

GRID = Grid(5, 4, base=6, blocked=(8, 13), through_corners=False)
MODEL = SensorModel(lethality=0.5, malfunction=0.02)
WORLD = World.random(GRID, np.random.default_rng(3), 0.3, 0.8, 0.2)
PATH = [6, 7, 2, 3, 4, 4, 3, 2, 1, 6]


def runs(execution, count=400, model=MODEL):
    return [
        execution.traverse(WORLD, GRID, PATH, model, np.random.default_rng(seed))
        for seed in range(count)
    ]


def test_who_obeys_fares_as_by_the_world_alone():
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
def test_every_walk_is_one(execution):
    made = runs(execution)
    for each in made:
        walk = GRID.check_path(each.walk)
        if each.observation.survived:
            assert each.observation.path.tolist() == walk.tolist()
        else:
            assert each.observation.path.tolist() == PATH
            assert each.steps_made < len(walk) - 1
    assert {each.observation.survived for each in made} == {True, False}
    assert len({tuple(each.walk) for each in made}) > 5


def test_a_detour_passes_every_cell_of_the_path():
    longer = [made.walk.tolist() for made in runs(Execution(detour=0.3))]
    for walk in longer:
        rest = iter(walk)
        assert all(cell in rest for cell in PATH)
    assert max(map(len, longer)) > len(PATH) + 2


def test_who_turns_back_takes_a_shortest_way_home():
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


def test_certain_contact_tells_each_step():
    for made in runs(Execution(contact=1.0)):
        if not made.observation.survived:
            assert made.observation.steps_survived == made.steps_made
            expected = np.arange(len(PATH) - 1) == made.steps_made
            if made.steps_made < len(PATH) - 2:
                assert (made.observation.lost_at == expected).all()


@pytest.mark.slow
def test_silence_tells_that_a_robot_was_lost_soon():
    """Of all that were heard of last after the same step, as many are lost in each as is said."""
    contact, safe = 0.4, SensorModel(lethality=0.0, malfunction=0.2)
    counts = np.zeros(len(PATH) - 1)
    for made in runs(Execution(contact=contact), 8000, safe):
        if not made.observation.survived and made.observation.steps_survived == 1:
            counts[made.steps_made] += 1
            lost_at = made.observation.lost_at
    # The chance to be lost in a step falls by malfunctions as well.
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


def test_what_robots_do_is_drawn_as_often_as_told():
    safe = SensorModel(lethality=0.0, malfunction=0.0)
    walks = [made.walk for made in runs(Execution(early_return=0.25), 4000, safe)]
    kept = np.mean([len(walk) == len(PATH) for walk in walks])
    # The last step home is the same whether it turned back or not.
    assert kept == pytest.approx(0.75**7, abs=0.02)


def test_the_same_seed_gives_the_same_walk():
    execution = Execution(0.3, 0.1, 0.3, 0.1)
    for first, second in zip(runs(execution, 30), runs(execution, 30)):
        assert first.walk.tolist() == second.walk.tolist()
        assert first.steps_made == second.steps_made
        assert first.observation.steps_survived == second.observation.steps_survived


@for_each(
    'name, value',
    product(['detour', 'early_return', 'contact', 'camera_failure'], [-0.1, 1.1, float('nan')]),
)
def test_probabilities_are_checked(name, value):
    with pytest.raises(ValueError, match=name):
        Execution(**{name: value})


def test_orders_must_be_a_path():
    with pytest.raises(ValueError, match='jumps'):
        Execution().traverse(WORLD, GRID, [6, 9, 6], MODEL, np.random.default_rng(1))


def test_plans_are_orders():
    belief = Belief.prior(GRID, hazard=0.3, target=0.4, kappa=0.8)
    orders = plan(GRID, belief, MODEL, max_steps=8).path
    made = Execution(detour=0.5).traverse(WORLD, GRID, orders, MODEL, np.random.default_rng(1))
    assert made.walk[0] == made.walk[-1] == GRID.base
