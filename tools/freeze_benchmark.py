#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""
Make the beliefs of a new version of the benchmark.

``python3 tools/freeze_benchmark.py FILE.npz`` takes them from missions, with a proven bound for
each. What is frozen is the file: other processors and later planners make other beliefs.
"""

from itertools import product
from pathlib import Path
import sys

from kbnitp_ros.core import Belief, Grid, plan, run_mission, SearchOptions, SensorModel, World
import numpy as np

LETHALITIES = (0.1, 0.3, 0.5, 0.9)
# After so many robots, in a world each.
ROBOTS = (0, 5, 15, 40)
STEPS, BRANCHES = 18, 20


def freeze(path: Path) -> None:
    """Write the beliefs, lethalities and bounds to a file."""
    grid = Grid(9, 9, base=40)
    prior = Belief.prior(grid, hazard=0.15, target=0.205, kappa=0.8)
    options = SearchOptions(max_steps=STEPS)
    joints, lethalities, bounds = [], [], []
    for number, (lethality, robots) in enumerate(product(LETHALITIES, ROBOTS)):
        model = SensorModel(lethality)
        world = World.random(grid, [1, number], 0.15, 0.8, 0.1)
        mission = run_mission(grid, prior, model, world, robots, number, options=options)
        belief = mission[-1].belief if mission else prior
        proven = plan(grid, belief, model, STEPS, 'exact', branches=BRANCHES)
        joints.append(belief.joint)
        lethalities.append(lethality)
        bounds.append(proven.upper_bound)
        print(number, lethality, robots, proven.information, proven.gap, proven.ended_by)
    np.savez_compressed(path, joint=joints, lethality=lethalities, bound=bounds)


if __name__ == '__main__':
    freeze(Path(sys.argv[1]))
