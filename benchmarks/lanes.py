# SPDX-License-Identifier: Apache-2.0
"""Compare the goal of a lane with flights for the expected best lane: paired missions."""

import argparse
from functools import partial

from joblib import delayed, Parallel
from kbnitp_ros.core import (
    Belief,
    Grid,
    Lane,
    run_mission,
    SearchOptions,
    SensorModel,
    Truth,
    Unknowns,
    World,
)
from kbnitp_ros.core.decision import goals
from kbnitp_ros.core.mission import Learning
import numpy as np
from tqdm import tqdm

# Above every probability: all flights are for the expected best lane.
NEVER = 2.0
# Steps on a field with `side` cells a side: enough for the far corner and back.
MAX_STEPS = {5: 12, 9: 18, 15: 30}
MAX_ROBOTS = 60
LETHALITIES = 0.1, 0.3, 0.5, 0.9
UNKNOWN = Learning(Unknowns(lethality=(0.0, 1.0)))


def mission(side, lethality, threshold, seed):
    """Return robots sent and lost, whether the goal was reached, and whether the lane was free."""
    goals.PROBABLE = threshold
    grid, rng = Grid(side, side), np.random.default_rng([seed, 11])
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    prior = Belief.prior(grid, 0.15, 0.15 * 0.8 + 0.85 * 0.1, 0.8)
    truth = SensorModel(rng.uniform() if lethality is None else lethality)
    flown = run_mission(
        grid,
        prior,
        truth if lethality is not None else SensorModel(0.5),
        world,
        MAX_ROBOTS,
        rng,
        options=SearchOptions(max_steps=MAX_STEPS[side]),
        truth=Truth(model=truth),
        learning=UNKNOWN if lethality is None else None,
        goal=Lane(grid.cells - 1, confidence=0.9),
    )
    lost = sum(not deployment.observation.survived for deployment in flown)
    decision = flown[-1].decision
    is_free = not world.hazard[decision.path].any()
    return len(flown), lost, decision.reached, decision.reached and is_free


def compare(side, lethality, thresholds, worlds, processes):
    """Print robots, losses, goals reached and lanes free, and the effect of each threshold."""
    jobs = [(threshold, seed) for seed in range(worlds) for threshold in (NEVER, *thresholds)]
    fly = partial(mission, side, lethality)
    missions = Parallel(n_jobs=processes, return_as='generator')(
        delayed(fly)(*job) for job in jobs
    )
    shown = tqdm(missions, f'{side}x{side}, lethality {lethality}', len(jobs), mininterval=5.0)
    found = np.array(list(shown), dtype=float).reshape(worlds, -1, 4)
    for number, threshold in enumerate((NEVER, *thresholds)):
        change = found[:, number] - found[:, 0]
        error = change.std(axis=0, ddof=1) / worlds**0.5
        row = [f'{side}x{side}', 'unknown' if lethality is None else lethality]
        row += ['never' if threshold == NEVER else threshold]
        row += [f'{mean:.2f}' for mean in found[:, number].mean(axis=0)]
        row += [f'{mean:+.2f} ± {each:.2f}' for mean, each in zip(change.mean(axis=0), error)]
        print('|', ' | '.join(map(str, row)), '|', flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--worlds', type=int, default=200)
    parser.add_argument('--sides', type=int, nargs='+', default=list(MAX_STEPS))
    parser.add_argument('--lethalities', type=float, nargs='*', default=LETHALITIES)
    parser.add_argument('--unknown', action='store_true', help='also with lethality learnt')
    parser.add_argument('--thresholds', type=float, nargs='+', default=[goals.PROBABLE])
    parser.add_argument('--processes', type=int, default=-1)
    given = parser.parse_args()
    print('| field | lethality | information on the lane from | robots | lost | reached | free |')
    for side in given.sides:
        for lethality in [*given.lethalities, *([None] if given.unknown else [])]:
            compare(side, lethality, given.thresholds, given.worlds, given.processes)


if __name__ == '__main__':
    main()
