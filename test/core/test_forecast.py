# SPDX-License-Identifier: Apache-2.0
"""A forecast runs missions in fields drawn from the belief."""

from extent import FULL
from kbnitp_ros.core import (
    Area,
    Belief,
    Estimator,
    forecast,
    Grid,
    Lane,
    METHODS,
    Observation,
    run_mission,
    SearchOptions,
    SensorModel,
    Stop,
    Truth,
    Unknowns,
    World,
)
from kbnitp_ros.core.forecast import wilson_interval
from laws import for_each
import numpy as np
import pytest

GRID = Grid(4, 4, blocked=(6,))
MODEL = SensorModel(0.5)
PRIOR = Belief.prior(GRID, 0.2, 0.24, 0.8)
OPTIONS = SearchOptions(max_steps=8)
NUMBERS = ('sent', 'lost', 'entropy', 'p_free', 'reached', 'free')


def some(rng, robots, method='kappa_bnitp', **options):
    world = World.random(GRID, rng, 0.2, 0.8, 0.1)
    return world, run_mission(GRID, PRIOR, MODEL, world, robots, rng, method, OPTIONS, **options)


def told(method, mission):
    estimator = Estimator(PRIOR, MODEL, method)
    for deployment in mission:
        estimator.assimilate(deployment.observation)
    return estimator


@for_each('method', METHODS, every=1 if FULL else 3)
def test_worlds_are_drawn_from_the_belief(method):
    estimator = told(method, some(np.random.default_rng(5), 6, method)[1])
    worlds = [world for world, _ in estimator.worlds(2560, np.random.default_rng(1))]
    for name in ('hazard', 'target'):
        share = np.mean([getattr(world, name) for world in worlds], axis=0)
        assert share == pytest.approx(getattr(estimator.belief, name), abs=0.06)
    for world in worlds[:20]:
        world.check(GRID)


def test_learnt_numbers_are_drawn_together_with_the_hazards():
    """A hazard in the one cell that robots often returned from is not lethal."""
    grid, prior = Grid(2, 1), Belief.from_maps([0.0, 0.5], [0.0, 0.0], [0.0, 0.0])
    model = SensorModel(0.5, malfunction=0.1, false_negative=0.0)
    estimator = Estimator(prior, model, 'kappa_bnitp_sampled', Unknowns(lethality=(0.0, 1.0)))
    fates = [True, False, True, True, False]
    for survived in fates:
        estimator.assimilate(Observation([0, 1, 0], survived, [0, 0] if survived else None))
    lethality = np.linspace(0.0, 1.0, 2001)
    back = 0.9**2 * (1.0 - lethality)
    likelihood = np.prod([back if survived else 1.0 - back for survived in fates], axis=0)
    drawn = estimator.worlds(5120, np.random.default_rng(2))
    there = [bool(world.hazard[1]) for world, _ in drawn]
    values = np.array([model.lethality for _, model in drawn])
    assert values[there].mean() == pytest.approx(
        (lethality * likelihood).sum() / likelihood.sum(), abs=0.03
    )
    assert values[np.logical_not(there)].mean() == pytest.approx(0.5, abs=0.03)
    assert grid.cells == drawn[0][0].hazard.size


@pytest.mark.slow
@for_each('goal', [None, Lane(to=15, confidence=0.8), Area([1, 2], confidence=0.8)])
def test_the_order_in_which_missions_are_run_changes_nothing(goal):
    def backwards(fly, worlds):
        return [fly(world) for world in reversed(worlds)][::-1]

    estimator = Estimator(PRIOR, MODEL)
    one, other = (
        forecast(GRID, estimator, 5, 6, 4, OPTIONS, goal=goal, run=run) for run in (map, backwards)
    )
    for name in NUMBERS:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    assert one.robots == 5
    assert (one.sent <= 5).all()
    assert (np.diff(one.lost, axis=1) >= 0).all()
    for mission, sent in enumerate(one.sent.tolist()):
        rest = one.lost[mission, sent:]
        assert (rest == rest[0]).all()
    assert np.isnan(one.p_free).all() == (goal is None)


def test_a_forecast_is_the_mission_in_the_drawn_world():
    goal, stop = Lane(to=15, confidence=0.9), Stop(losses=2)
    estimator = Estimator(PRIOR, MODEL)
    kept = []

    def keep(fly, worlds):
        kept.extend(worlds)
        return map(fly, worlds)

    found = forecast(GRID, estimator, 9, 4, 8, OPTIONS, goal=goal, stop=stop, run=keep)
    again = forecast(GRID, estimator, 9, 4, 8, OPTIONS, goal=goal, stop=stop)
    assert again.p_free.tobytes() == found.p_free.tobytes()
    drawn = estimator.worlds(4, np.random.default_rng(8))
    for number, ((world, model), possible) in enumerate(zip(drawn, kept)):
        assert world == possible.world
        mission = run_mission(
            GRID,
            PRIOR,
            MODEL,
            world,
            9,
            fresh(8, 4, number),
            options=OPTIONS,
            truth=Truth(model),
            goal=goal,
            stop=stop,
        )
        assert found.sent[number] == len(mission)
        assert found.lost[number, -1] == sum(not each.observation.survived for each in mission)
        if mission:
            last = mission[-1].decision
            assert found.p_free[number, -1] == last.p_free
            assert found.free[number] == (not world.hazard[last.path].any())


def fresh(seed, worlds, number):
    """Return the generator of a forecast's world, as it was before its mission."""
    return np.random.default_rng(seed).spawn(worlds)[number]


def test_a_proportion_has_the_wilson_interval():
    share = wilson_interval(np.array([1.0] * 17 + [0.0] * 3))
    # As statsmodels.stats.proportion.proportion_confint(17, 20, method='wilson') has it.
    assert share == pytest.approx((0.85, 0.63958, 0.94763), abs=1e-4)
    assert wilson_interval(np.zeros(10))[1] == 0.0
    assert wilson_interval(np.ones(10))[2] == 1.0
