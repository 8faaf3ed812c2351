# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels that demo, nodes and studies use, in parallel, and say how far that is."""

from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, wait
import re

from kbnitp_ros.core import (
    Belief,
    Clustering,
    Grid,
    Learning,
    path_information,
    plan_team,
    run_mission,
    SearchOptions,
    SensorModel,
    Team,
    Unknowns,
    World,
)
from kbnitp_ros.core.field.compiled import cache_folder, PACKAGE
import numpy as np

GRID, MODEL = Grid(4, 4), SensorModel(0.9)
PRIOR = Belief.prior(GRID, 0.5, 0.45, 0.8)


def search() -> None:
    """Plan for two robots."""
    plan_team(GRID, PRIOR, MODEL, Team(2), SearchOptions(max_steps=6))
    path_information(PRIOR, MODEL, [0, 0])


def sample() -> None:
    """Infer by sampling, with a number and a coupling that are learnt."""
    rng = np.random.default_rng(1)
    world = World.random(GRID, rng, 0.15, 0.8, 0.1)
    unknowns = Unknowns(lethality=(0.0, 1.0))
    run_mission(
        GRID, PRIOR, MODEL, world, 8, rng, 'kappa_bnitp_sampled',
        SearchOptions('random', max_steps=6),
        learning=Learning(unknowns, clustering=Clustering(GRID, 'learn')),
    )  # fmt: skip


# The longest first. Kernels of both would be compiled twice.
CALLS: tuple[Callable[[], None], ...] = (search, sample)


def main() -> None:
    """Compile, and print once a second how many kernels are done."""
    sources = [path.read_text() for path in PACKAGE.rglob('*_kernels.py')]
    kernels = sum(len(re.findall(r'^@(?:compiled|inlined)$', each, re.M)) for each in sources)
    with ProcessPoolExecutor() as processes:
        left: set[Future[None]] = {processes.submit(each) for each in CALLS}
        while left:
            done, left = wait(left, timeout=1.0)
            for job in done:
                job.result()
            compiled = len([*cache_folder().rglob('*.nbi')])
            print(f'compiling {min(compiled, kernels)} of {kernels} kernels', flush=True)


if __name__ == '__main__':
    main()
