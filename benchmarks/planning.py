# SPDX-License-Identifier: Apache-2.0
"""Time of plans, by size and steps, by width, and by robots in a round."""

from __future__ import annotations

from collections.abc import Callable

from cases import Benchmark, timed
from kbnitp_ros.core import (
    Belief,
    Estimator,
    Grid,
    plan,
    plan_team,
    SearchOptions,
    SensorModel,
    Team,
    World,
)
import numpy as np

# Malfunction per step, so that robots survive many steps.
MALFUNCTION = 0.001


def belief_of_a_mission(side: int, steps: int, robots: int) -> tuple[Grid, Belief, SensorModel]:
    """Return a field, the belief after some robots, and their model."""
    grid, rng, model = Grid(side, side), np.random.default_rng(1), SensorModel(0.5, MALFUNCTION)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    estimator = Estimator(Belief.prior(grid, 0.5, 0.45, 0.8), model)
    for _ in range(robots):
        planned = plan(grid, estimator.belief, model, SearchOptions('relaxed', steps))
        estimator.assimilate(world.traverse(planned.path, model, rng))
    return grid, estimator.belief, model


def one_plan(side: int, steps: int, width: int = 8) -> Callable[[], float]:
    """Return a function that times one plan."""

    def run() -> float:
        grid, belief, model = belief_of_a_mission(side, steps, 3)
        return timed(
            lambda: plan(grid, belief, model, SearchOptions(max_steps=steps, width=width))
        )

    return run


def one_round(robots: int) -> Callable[[], float]:
    """Return a function that times the plans of a round."""

    def run() -> float:
        grid, belief, model = belief_of_a_mission(9, 18, 10)
        return timed(lambda: plan_team(grid, belief, model, Team(robots), SearchOptions()))

    return run


BENCHMARKS = (
    Benchmark(
        'A plan by size and steps',
        'The planner `beam` of width 8, after three deployments.',
        {
            f'{side}x{side} cells, {steps} steps': one_plan(side, steps)
            for side, steps in ((9, 18), (30, 60), (50, 100), (100, 200))
        }
        | {'300x300 cells, 60 steps': one_plan(300, 60)},
    ),
    Benchmark(
        'A plan by width',
        'The planner `beam` on 30x30 cells with 60 steps.',
        {f'width {width}': one_plan(30, 60, width) for width in (8, 16, 32, 64)},
    ),
    Benchmark(
        "A round's plans by robots",
        'The allocation `greedy` on 9x9 cells with 18 steps.',
        {f'{robots} robots': one_round(robots) for robots in (1, 2, 8, 64)},
    ),
)
