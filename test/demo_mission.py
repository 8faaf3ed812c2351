# SPDX-License-Identifier: Apache-2.0
"""The mission of a demo, computed without nodes."""

from kbnitp_ros.cli.demo import parse
from kbnitp_ros.cli.demo_mission import chosen_parameters
from kbnitp_ros.configuration import make_estimator, make_grid
from kbnitp_ros.configuration.agents import make_sensor_model, make_unknowns
from kbnitp_ros.configuration.mission import make_prior, search_options
from kbnitp_ros.core import Belief, Deployment, Learning, run_mission, Truth, World
from kbnitp_ros.report.mission import true_numbers
import numpy as np


def demo_mission(*options: str) -> tuple[Belief, list[Deployment], World, dict[str, float]]:
    """Return the first belief, deployments, world and true numbers of a demo."""
    parameters = chosen_parameters(parse(options))
    agent, estimator = parameters['agent'], parameters['estimator']
    grid, seed = make_grid(agent), agent['seed']
    rng = np.random.default_rng(seed)
    numbers = [agent[f'world.{name}'] for name in ('hazard_density', 'kappa', 'target_background')]
    world = World.random(grid, rng, *numbers)
    deployments = run_mission(
        grid, make_prior(estimator, grid), make_sensor_model(estimator), world,
        parameters['planner']['robots'], rng, estimator['method'],
        search_options(parameters['planner']),
        truth=Truth(make_sensor_model(agent)), learning=Learning(make_unknowns(estimator), seed),
    )  # fmt: skip
    return (
        make_estimator(estimator, grid).belief,
        deployments,
        world,
        true_numbers(agent, estimator),
    )
