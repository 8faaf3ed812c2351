# SPDX-License-Identifier: Apache-2.0
"""
Compare two versions of the package: their missions, paired, and the times of their plans.

    OLD/.venv/bin/python benchmarks/versions.py fly old.csv
    NEW/.venv/bin/python benchmarks/versions.py fly new.csv
    python3 benchmarks/versions.py compare old.csv new.csv
    python3 benchmarks/versions.py plans OLD/.venv/bin/python NEW/.venv/bin/python

`fly` sends 100 robots into fields of 9x9 cells, with a right prior; the same worlds and random
numbers every time. `compare` prints the mean difference new - old of log losses (nats) and of
robots lost, its standard error, and the ratio of processor times. `plans` plans on the same
beliefs in both versions in turn, and prints the ratios new / old of times and of information.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import csv
from itertools import product
import json
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from kbnitp_ros.core import (
    Belief,
    Grid,
    log_loss,
    plan,
    run_mission,
    SearchOptions,
    SensorModel,
    World,
)
import numpy as np
from tqdm import tqdm

LETHALITIES = (0.1, 0.3, 0.5, 0.9)
AFTER = (25, 50, 100)

# Sides and steps of fields whose plans are timed, and after how many robots.
FIELDS = ((9, 18, (0, 5, 20, 50, 100)), (30, 60, (0, 20, 100)), (100, 200, (0, 30)))


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


def plans(arguments: argparse.Namespace) -> None:
    """Time plans in both versions in turn, and print the ratios by field and malfunction."""
    print('| cells | steps | malfunction | beliefs | time | most | information | least |')
    print('|---|---|---|---|---|---|---|---|')
    with TemporaryDirectory() as folder:
        file = Path(folder, 'beliefs.npz')
        workers = [
            subprocess.Popen(
                [python, __file__, 'answer', str(file)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for python in (arguments.old, arguments.new)
        ]
        for (side, steps, robots), malfunction in product(FIELDS, (0.001, 0.05)):
            ratios = []
            for lethality in LETHALITIES:
                model = SensorModel(lethality, malfunction)
                for joint in tqdm(beliefs_of_missions(side, steps, robots, model), disable=None):
                    np.savez(file, joint=joint)
                    request = json.dumps([side, steps, lethality, malfunction])
                    (old, old_value), (new, new_value) = [
                        ask(worker, request) for worker in workers
                    ]
                    ratios.append((new / old, new_value / old_value))
            times, values = np.array(ratios).T
            print(
                f'| {side}x{side} | {steps} | {malfunction} | {len(ratios)} | {times.mean():.3f} '
                f'| {times.max():.3f} | {values.mean():.4f} | {values.min():.4f} |'
            )
        for worker in workers:
            worker.communicate()


def beliefs_of_missions(
    side: int, steps: int, robots: Sequence[int], model: SensorModel
) -> list[np.ndarray]:
    """Return the joints believed after so many robots of one mission."""
    grid = Grid(side, side)
    prior = Belief.prior(grid, 0.15, 0.15 * 0.8 + 0.85 * 0.1, 0.8)
    world = World.random(grid, np.random.default_rng([side, 1]), 0.15, 0.8, 0.1)
    options = SearchOptions('relaxed', steps)
    rng = np.random.default_rng([side, 2])
    mission = run_mission(grid, prior, model, world, max(robots), rng, options=options)
    return [(mission[count - 1].belief if count else prior).joint for count in robots]


def ask(worker: subprocess.Popen[str], request: str) -> tuple[float, float]:
    """Return the seconds and the information of a plan that a worker makes."""
    assert worker.stdin
    assert worker.stdout
    worker.stdin.write(request + '\n')
    worker.stdin.flush()
    seconds, information = json.loads(worker.stdout.readline())
    return seconds, information


def answer(arguments: argparse.Namespace) -> None:
    """Plan on the belief in a file at each request; time the best of up to five plans."""
    # The first plan compiles kernels.
    plan(Grid(3, 3), Belief.prior(Grid(3, 3), 0.3, 0.3, 0.5), SensorModel(0.5), 6)
    for request in sys.stdin:
        side, steps, lethality, malfunction = json.loads(request)
        grid, model = Grid(side, side), SensorModel(lethality, malfunction)
        belief = Belief(np.load(arguments.file)['joint'])
        best, spent = np.inf, 0.0
        for _ in range(5):
            if spent < 3.0:
                began = time.process_time()
                found = plan(grid, belief, model, steps)
                seconds = time.process_time() - began
                best, spent = min(best, seconds), spent + seconds
        print(json.dumps([best, found.information]), flush=True)


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
    timing = commands.add_parser('plans', help='time plans')
    timing.add_argument('old', help='the python of one version')
    timing.add_argument('new', help='that of another')
    timing.set_defaults(run=plans)
    answering = commands.add_parser('answer')
    answering.add_argument('file', type=Path)
    answering.set_defaults(run=answer)
    arguments = parser.parse_args()
    arguments.run(arguments)
    return 0


if __name__ == '__main__':
    sys.exit(main())
