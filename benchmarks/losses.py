# SPDX-License-Identifier: Apache-2.0
"""Compare the objective information_per_loss with information: the same worlds and randomness."""

import argparse
from functools import partial

from joblib import delayed, Parallel
from kbnitp_ros.core import Belief, Grid, log_loss, run_mission, SearchOptions, SensorModel, World
import numpy as np

GRID = Grid(9, 9)
ROBOTS = 100
LOSSES = (10, 20, 30, 40)


def curves(lethality, world_seed, objective):
    """Return the robots lost and the log loss of both maps after each robot of a mission."""
    rng = np.random.default_rng([world_seed, 7])
    world = World.random(GRID, rng, 0.15, 0.8, 0.1)
    prior = Belief.prior(GRID, 0.15, 0.15 * 0.8 + 0.85 * 0.1, 0.8)
    options = SearchOptions(objective=objective)
    mission = run_mission(
        GRID, prior, SensorModel(lethality), world, ROBOTS + 30, rng, options=options
    )
    lost = np.cumsum([not each.observation.survived for each in mission])
    beliefs = [each.belief for each in mission]
    loss = [log_loss(b.hazard, world.hazard) + log_loss(b.target, world.target) for b in beliefs]
    return lost, np.array(loss)


def differences(lethality, world_seed):
    """Return how log loss and robots differ at equal losses, and both at equal robots."""
    (lost, loss), (lost_less, loss_less) = (
        curves(lethality, world_seed, each) for each in ('information', 'information_per_loss')
    )
    found = []
    for most in LOSSES:
        one, other = (np.flatnonzero(each <= most)[-1] for each in (lost, lost_less))
        found += [loss_less[other] - loss[one], (other + 1) / (one + 1)]
    last = ROBOTS - 1
    return [*found, loss_less[last] - loss[last], lost_less[last] - lost[last]]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--worlds', type=int, default=14)
    worlds = parser.parse_args().worlds
    for lethality in (0.3, 0.5, 0.9):
        jobs = map(delayed(partial(differences, lethality)), range(worlds))
        found = np.array(Parallel(n_jobs=-1)(jobs))
        mean, error = found.mean(axis=0), found.std(axis=0, ddof=1) / worlds**0.5
        for place, most in enumerate(LOSSES):
            print(
                f'{lethality}: at {most} lost: log loss {mean[2 * place]:+.2f} +- '
                f'{error[2 * place]:.2f} nats, {mean[2 * place + 1]:.2f} times the robots'
            )
        print(
            f'{lethality}: after {ROBOTS} robots: log loss {mean[-2]:+.2f} +- {error[-2]:.2f} '
            f'nats, {mean[-1]:+.1f} +- {error[-1]:.1f} robots lost'
        )


if __name__ == '__main__':
    main()
