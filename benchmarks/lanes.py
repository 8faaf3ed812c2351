# SPDX-License-Identifier: Apache-2.0
"""Compare thresholds of probability from which on flights are for information on one lane."""

import argparse
from functools import partial

from joblib import delayed, Parallel
from kbnitp_ros.core import Belief, Grid, Lane, run_mission, SearchOptions, SensorModel, World
from kbnitp_ros.core.decision import goals
import numpy as np

# A threshold that no probability reaches: flights are for the expected best lane throughout.
NEVER = 2.0


def mission(side, lethality, seed, threshold):
    """Return the robots sent and lost, and whether the goal was reached and the lane free."""
    goals.PROBABLE = threshold
    grid, rng = Grid(side, side), np.random.default_rng([seed, 11])
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    prior = Belief.prior(grid, 0.15, 0.15 * 0.8 + 0.85 * 0.1, 0.8)
    options = SearchOptions(max_steps=18 if side > 5 else 12)
    goal = Lane(grid.cells - 1, confidence=0.9)
    flown = run_mission(
        grid, prior, SensorModel(lethality), world, 60, rng, options=options, goal=goal
    )
    lost = sum(not each.observation.survived for each in flown)
    decision = flown[-1].decision
    is_free = not world.hazard[decision.path].any()
    return len(flown), lost, decision.reached, decision.reached and is_free


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--worlds', type=int, default=60)
    parser.add_argument('--side', type=int, default=5)
    parser.add_argument('--lethality', type=float, default=0.5)
    given = parser.parse_args()
    fly = partial(mission, given.side, given.lethality)
    seeds, found = range(given.worlds), {}
    for threshold in (NEVER, 0.3, 0.45, 0.6):
        jobs = (delayed(fly)(seed, threshold) for seed in seeds)
        found[threshold] = np.array(Parallel(n_jobs=-1)(jobs), dtype=float)
    for threshold, each in found.items():
        change = each - found[NEVER]
        error = change.std(axis=0, ddof=1) / given.worlds**0.5
        mean = ', '.join(f'{value:.2f}' for value in each.mean(axis=0))
        words = ', '.join(f'{m:+.2f} +- {e:.2f}' for m, e in zip(change.mean(axis=0), error))
        print(f'{threshold}: robots, lost, reached, free {mean}; change {words}')


if __name__ == '__main__':
    main()
