# SPDX-License-Identifier: Apache-2.0
"""
Make the golden data of inference: recorded outcomes, and the beliefs of version 1.0.

``PYTHONPATH=TREE:test/core/inference python3 benchmarks/golden.py`` writes golden.npz there; TREE
is a clone of version 1.0 (e5db353a).
"""

from itertools import compress
import json

from kbnitp_ros.core import Observation, run_mission, SearchOptions, Team, World
import numpy as np
from test_golden import CLOSED, FILE, fold, LEARNT, MODEL, PRIORS, TYPES


def record(prior):
    """Yield the outcome of each robot of a mission as arguments of `Observation`."""
    grid, rng = prior.grid, np.random.default_rng(prior.cells)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    options, team = SearchOptions('relaxed', 2 * grid.width), Team(2, types=TYPES)
    mission = run_mission(grid, prior, MODEL, world, 25, rng, options=options, team=team)
    for number, seen in enumerate(each.observation for each in mission):
        outcome, some = {'path': seen.path, 'survived': seen.survived}, rng.random(seen.steps)
        if seen.survived:
            outcome['readings'] = np.where(some < 0.1, -1, seen.readings)
            if number % 3:
                outcome['entered'] = np.append(some[1:] < 0.8, True)
        elif number % 3 == 1:
            outcome['lost_at'] = some
        elif number % 3 == 2:
            outcome['steps_survived'] = seen.steps // 2
        yield {name: np.asarray(value).tolist() for name, value in outcome.items()}


def steps_entered(path, entered=None, readings=None, **outcome):
    """Return an observation of the steps that count, since version 1.0 does not know `entered`."""
    if entered:
        path, readings = [path[0], *compress(path[1:], entered)], [*compress(readings, entered)]
    return Observation(path, readings=readings, **outcome)


if __name__ == '__main__':
    golden = {}
    for name, prior in PRIORS.items():
        outcomes = [*record(prior)]
        golden[f'{name} outcomes'] = json.dumps(outcomes)
        for case in CLOSED | LEARNT:
            golden |= fold(name, case, [steps_entered(**each) for each in outcomes])
    np.savez_compressed(FILE, **golden)
