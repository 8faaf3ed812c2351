# SPDX-License-Identifier: Apache-2.0
"""
Compare the speed of another version of the package with this one.

    python3 benchmarks/versions.py 245539b
    python3 benchmarks/versions.py ../another/tree

Writes a table into docs/performance.md. Versions take turns in this one's environment, after a
first time that loads or compiles kernels.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import gzip
import json
import os
from pathlib import Path
from statistics import median
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import Any

from cases import in_words, write
from tqdm import tqdm

ROOT = Path(__file__).parents[1]

# Both versions have all that is named here.
SETUP = """
from functools import cache
from hashlib import sha256
import json, os, shutil, subprocess, sys, time
from kbnitp_ros.core import Belief, Grid, plan_team, run_mission, SearchOptions
from kbnitp_ros.core import SensorModel, Team, World
import numpy as np

MODEL = SensorModel(0.5)

def fly(side, steps, planner, robots, **team):
    grid = Grid(side, side)
    world = World.random(grid, np.random.default_rng(1), 0.15, 0.8, 0.1)
    prior = Belief.prior(grid, 0.15, 0.205, 0.8)
    rng, options = np.random.default_rng(2), SearchOptions(planner, steps)
    return run_mission(grid, prior, MODEL, world, robots, rng, options=options, **team)

@cache
def belief(side, steps):
    return fly(side, steps, 'relaxed', 3)[-1].belief

def mission(*arguments, **team):
    bits = sha256()
    for each in fly(*arguments, **team):
        bits.update(each.plan.path.tobytes() + each.belief.joint.tobytes())
    return bits.hexdigest()

def search(side, steps):
    options = SearchOptions(max_steps=steps)
    plan_team(Grid(side, side), belief(side, steps), MODEL, Team(1), options)

def team(robots):
    plan_team(Grid(9, 9), belief(9, 18), MODEL, Team(robots), SearchOptions())

def command(*words):
    shutil.rmtree('out', ignore_errors=True)
    subprocess.run([sys.executable, '-m', 'kbnitp_ros', *words], check=True, capture_output=True)

seconds = lambda: time.process_time() + sum(os.times()[2:4])
for line in sys.stdin:
    before = seconds()
    found = eval(line)
    print(json.dumps([seconds() - before, found]), flush=True)
"""

# By name; what both versions return must be equal.
CASES = {
    'mission of 100 robots, `relaxed`': "mission(9, 18, 'relaxed', 100)",
    'mission of 50 pairs, `relaxed`': "len(fly(9, 18, 'relaxed', 100, team=Team(2)))",
    'mission of 20 robots, `beam`': "fly(9, 18, 'beam', 20) and None",
    'plan of `beam`, 9x9 cells, 18 steps': 'search(9, 18)',
    'plan of `beam`, 30x30 cells, 60 steps': 'search(30, 60)',
    'plan of `beam`, 100x100 cells, 200 steps': 'search(100, 200)',
    'plans of `beam` for 2 robots': 'team(2)',
    'plans of `beam` for 64 robots': 'team(64)',
    'report of a log': "command('report', 'log.mcap', '--out', 'out')",
    '`demo --help`': "command('demo', '--help')",
    '`study --help`': "command('study', '--help')",
}


@contextmanager
def tree(version: str, folder: Path) -> Iterator[Path]:
    """Yield the tree of a version: the folder itself, or a commit's in a folder of its own."""
    if Path(version).is_dir():
        yield Path(version).resolve()
        return
    git = ['git', '-C', str(ROOT), 'worktree']
    subprocess.run([*git, 'add', '--quiet', '--detach', str(folder), version], check=True)
    try:
        yield folder
    finally:
        subprocess.run([*git, 'remove', '--force', str(folder)], check=True)


def start_worker(root: Path, folder: str) -> subprocess.Popen[str]:
    """Start a process that times what it is asked for in one version."""
    one = dict.fromkeys(('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS'), '1')
    paths = f'{root}:{os.environ.get("PYTHONPATH", "")}'
    return subprocess.Popen(
        [sys.executable, '-c', SETUP],
        cwd=folder,
        env={**os.environ, **one, 'PYTHONPATH': paths},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def ask(process: subprocess.Popen[str], case: str) -> list[Any]:
    """Return the processor time of a case, s, and what it returns."""
    print(case, file=process.stdin, flush=True)
    return json.loads(process.stdout.readline())


def main() -> int:
    """Compare, print and write the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('version', help='a commit, or the folder of a tree')
    parser.add_argument('--turns', type=int, default=9)
    options, lines = parser.parse_args(), ['| | before | now | ratio |', '|---|---|---|---|']
    with TemporaryDirectory() as out, tree(options.version, Path(out, 'tree')) as before:
        log = ROOT / 'test/log/recorded/kappa_bnitp.mcap.gz'
        Path(out, 'log.mcap').write_bytes(gzip.decompress(log.read_bytes()))
        workers = [start_worker(root, out) for root in (before, ROOT)]
        for name, case in tqdm(CASES.items(), unit='case', disable=None):
            firsts = [ask(each, case)[1] for each in workers]
            assert firsts[0] == firsts[1], f'{name} has other bits'
            turns = [[ask(each, case)[0] for each in workers] for _ in range(options.turns)]
            old, new = (in_words(median(times)) for times in zip(*turns))
            lines.append(f'| {name} | {old} | {new} | {median(n / o for o, n in turns):.2g} |')
        for worker in workers:
            worker.communicate()
    write('versions', '\n'.join(lines))
    return 0


if __name__ == '__main__':
    sys.exit(main())
