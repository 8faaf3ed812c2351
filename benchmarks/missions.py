# SPDX-License-Identifier: Apache-2.0
"""
Compare missions of two versions of the package, paired: same worlds, same random numbers.

    PYTHONPATH=OLD python3 benchmarks/missions.py fly old.csv
    PYTHONPATH=NEW python3 benchmarks/missions.py fly new.csv
    python3 benchmarks/missions.py compare old.csv new.csv

Each mission sends 100 robots into a field of 9x9 cells with a right prior. `compare` prints the
mean difference new - old of log losses (nats) and robots lost, its standard error, and the ratio
of processor times, by lethality.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
import sys
import time

from kbnitp_ros.core import (
    Belief,
    Grid,
    log_loss,
    run_mission,
    SearchOptions,
    SensorModel,
    World,
)
import numpy as np
from tqdm import tqdm

LETHALITIES = (0.1, 0.3, 0.5, 0.9)
AFTER = (25, 50, 100)


def fly(arguments: argparse.Namespace) -> None:
    """Fly missions and write one row each."""
    grid = Grid(9, 9)
    prior = Belief.prior(grid, 0.15, 0.15 * 0.8 + 0.85 * 0.1, 0.8)
    options = SearchOptions(planner=arguments.planner)
    keys = [(world, lethality) for world in range(arguments.worlds) for lethality in LETHALITIES]
    with arguments.file.open('w', newline='') as file:
        rows = csv.writer(file)
        after = [f'log_loss_{robots}' for robots in AFTER]
        rows.writerow(['world', 'lethality', *after, 'lost', 'seconds'])
        for seed, lethality in tqdm(keys, unit='mission', disable=None):
            world = World.random(grid, np.random.default_rng([seed, 1]), 0.15, 0.8, 0.1)
            began = time.process_time()
            mission = run_mission(
                grid,
                prior,
                SensorModel(lethality),
                world,
                AFTER[-1],
                np.random.default_rng([seed, 2]),
                arguments.method,
                options,
            )
            seconds = time.process_time() - began
            losses = []
            for robots in AFTER:
                belief = mission[robots - 1].belief
                losses.append(
                    log_loss(belief.hazard, world.hazard) + log_loss(belief.target, world.target)
                )
            lost = sum(not each.observation.survived for each in mission)
            rows.writerow([seed, lethality, *losses, lost, seconds])
            file.flush()


def compare(arguments: argparse.Namespace) -> None:
    """Print paired differences."""
    old, new = read(arguments.old), read(arguments.new)
    names = [*(f'log_loss_{robots}' for robots in AFTER), 'lost']
    print('| lethality | worlds | ' + ' | '.join(names) + ' | time |')
    print('|---|---|' + '---|' * (len(names) + 1))
    for lethality in LETHALITIES:
        keys = sorted(key for key in old.keys() & new.keys() if key[1] == lethality)
        if len(keys) < 2:
            continue
        cells = []
        for name in names:
            gained = np.array([new[key][name] - old[key][name] for key in keys])
            error = gained.std(ddof=1) / np.sqrt(gained.size)
            cells.append(f'{gained.mean():+.2f} +- {error:.2f}')
        ratio = sum(new[key]['seconds'] for key in keys) / sum(old[key]['seconds'] for key in keys)
        print(f'| {lethality} | {len(keys)} | {" | ".join(cells)} | {ratio:.2f} |')


def read(file: Path) -> dict[tuple[int, float], dict[str, float]]:
    """Return the rows of a file by world and lethality."""
    with file.open(newline='') as lines:
        return {
            (int(row['world']), float(row['lethality'])): {
                name: float(value) for name, value in row.items()
            }
            for row in csv.DictReader(lines)
        }


def main() -> int:
    """Run a command; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    commands = parser.add_subparsers(required=True)
    flying = commands.add_parser('fly', help='fly missions')
    flying.add_argument('file', type=Path)
    flying.add_argument('--worlds', type=int, default=60)
    flying.add_argument('--method', default='kappa_bnitp')
    flying.add_argument('--planner', default='beam')
    flying.set_defaults(run=fly)
    comparing = commands.add_parser('compare', help='compare two files')
    comparing.add_argument('old', type=Path)
    comparing.add_argument('new', type=Path)
    comparing.set_defaults(run=compare)
    arguments = parser.parse_args()
    arguments.run(arguments)
    return 0


if __name__ == '__main__':
    sys.exit(main())
