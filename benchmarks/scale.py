# SPDX-License-Identifier: Apache-2.0
"""
Draw the memory and the time of long missions in the library and over ROS.

    python3 benchmarks/scale.py

Writes docs/images/benchmark_scale.png and a table into docs/performance.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import os
import time

from cases import in_words, PAGE, write
from kbnitp_ros.core import (
    Belief,
    Dynamics,
    Estimator,
    Grid,
    plan,
    SearchOptions,
    SensorModel,
    World,
)
from kbnitp_ros.figures import LETTERS, save, SERIES, WIDTH
from matplotlib import rc_context
from matplotlib.figure import Figure
import nodes
import numpy as np
from numpy.typing import NDArray

# Side of the field in cells, steps of a path, deployments in the library and over ROS.
SIZES = ((9, 18, 10_000, 10_000), (50, 60, 1_000, 1_000))
PARTS = 25
# Where nothing changes all is known after 2,000 deployments on 9x9 cells, and robots stay at home.
CHANGING = Dynamics('changing', appear=0.002, vanish=0.01)


def in_library(side: int, steps: int, deployments: int) -> list[tuple[int, float, float]]:
    """Return deployments, bytes and seconds at moments of a mission that keeps its last belief."""
    rng, grid, model = np.random.default_rng(1), Grid(side, side), SensorModel(0.5)
    world = World.random(grid, rng, 0.15, 0.8, 0.1)
    estimator = Estimator(Belief.prior(grid, 0.15, 0.205, 0.8), model, dynamics=CHANGING)
    course = []
    for deployment in range(1, deployments + 1):
        found = plan(grid, estimator.belief, model, SearchOptions('relaxed', steps))
        estimator.assimilate(world.traverse(found.path, model, rng))
        world = world.after_change(CHANGING, grid, grid.may_be_hazardous, rng)
        if deployment % max(1, deployments // 100) == 0:
            course.append((deployment, nodes.memory(os.getpid())['Pss'], time.monotonic()))
    return course


def over_ros(side: int, steps: int, deployments: int) -> list[tuple[int, float, float]]:
    """Return the same for the four nodes together."""
    rates = {f'hazards.{name}': getattr(CHANGING, name) for name in ('appear', 'vanish')}
    field = {'grid.width': side, 'grid.height': side, 'max_steps': steps}
    samples = nodes.run_nodes(deployments, **field, **rates, **{'hazards.dynamics': 'changing'})
    return [
        (sample.deployments, sum(node['Pss'] for node in sample.memory.values()), sample.time)
        for sample in samples
    ]


def by_part(course: Sequence[tuple[int, float, float]]) -> NDArray[np.float64]:
    """Return deployments, MiB and seconds a deployment in `PARTS` parts of a mission."""
    deployments, memory, seconds = np.array(course).T
    ends = np.linspace(deployments[0], deployments[-1], PARTS + 1)
    took = np.diff(np.interp(ends, deployments, seconds)) / np.diff(ends)
    return np.stack([ends[1:], np.interp(ends[1:], deployments, memory) / 2**20, took])


def main() -> None:
    """Run all missions, write the figure and the table."""
    found = {}
    for side, steps, alone, with_nodes in SIZES:
        # In a new process, whose memory is of this mission alone.
        with ProcessPoolExecutor(1, get_context('spawn')) as pool:
            course = pool.submit(in_library, side, steps, alone).result()
        found[f'{side}x{side} cells, {steps} steps, library'] = by_part(course)
        found[f'{side}x{side} cells, {steps} steps, ROS'] = by_part(
            over_ros(side, steps, with_nodes)
        )
    lines = [
        '| | deployments | memory early | late | time early | late |',
        '|---|---|---|---|---|---|',
    ]
    with rc_context(LETTERS):
        figure = Figure(figsize=(WIDTH, 2.6), layout='constrained')
        panels = figure.subplots(1, 2)
        for (name, (deployments, memory, took)), style in zip(found.items(), SERIES):
            for panel, values in zip(panels, (memory, took * 1e3)):
                panel.plot(deployments, values, label=name, **style.line(PARTS))
            early, late = (f'{mean:.0f} MiB' for mean in (memory[:5].mean(), memory[-5:].mean()))
            lines.append(
                f'| {name} | {deployments[-1]:,.0f} | {early} | {late} '
                f'| {in_words(took[:5].mean())} | {in_words(took[-5:].mean())} |'
            )
        for panel, label in zip(panels, ('memory (MiB)', 'time of a deployment (ms)')):
            panel.set(xscale='log', yscale='log', xlabel='deployments', ylabel=label)
        figure.legend(*panels[0].get_legend_handles_labels(), loc='outside lower center', ncols=2)
        save(figure, PAGE.parent / 'images' / 'benchmark_scale.png', 'png')
    write('scale', '\n'.join(lines))


if __name__ == '__main__':
    main()
