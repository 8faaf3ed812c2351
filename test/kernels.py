# SPDX-License-Identifier: Apache-2.0
"""Calls of all kernels, so that they are compiled once and not by each process of the tests."""

from concurrent.futures import ProcessPoolExecutor

from kbnitp_ros.core import (
    Belief,
    Clustering,
    Dynamics,
    Grid,
    Learning,
    plan,
    plan_team,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Unknowns,
    World,
)
import numpy as np

GRID, MODEL = Grid(4, 4), SensorModel(0.9)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)


def plans():
    """Return what planning comes to."""
    worth = []
    for objective, alpha in (('information', 1.0), ('behavioral', 2.0)):
        options = SearchOptions(max_steps=6, objective=objective, alpha=alpha)
        worth.append(plan_team(GRID, PRIOR, MODEL, Team(2), options).information)
    return worth, plan(GRID, PRIOR, MODEL, 6, bound=True).upper_bound


def missions():
    """Return the beliefs that missions come to, planned without most kernels."""
    beliefs = []
    for method, unknowns, effect in (
        ('kappa_bnitp_sampled', Unknowns(lethality=(0.0, 1.0)), 'static'),
    ):
        rng = np.random.default_rng(1)
        world = World.random(GRID, rng, 0.15, 0.8, 0.1)
        clustering = Clustering(GRID, 'learn') if unknowns.priors else None
        mission = run_mission(
            GRID, PRIOR, MODEL, world, 8, rng, method, SearchOptions('random', max_steps=6),
            dynamics=Dynamics(effect), learning=Learning(unknowns, clustering=clustering),
        )  # fmt: skip
        beliefs.append(mission[-1].belief.joint.tobytes().hex())
    return beliefs


if __name__ == '__main__':
    with ProcessPoolExecutor(2) as processes:
        for each in [processes.submit(plans), processes.submit(missions)]:
            each.result()
