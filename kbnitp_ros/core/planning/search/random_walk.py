# SPDX-License-Identifier: Apache-2.0
"""A closed walk drawn at random, to compare planners with."""

from __future__ import annotations

from hashlib import sha256

from kbnitp_ros.core.planning.search.label_kernels import Reach
import numpy as np
from numpy.typing import NDArray

# How often a walk of so many steps is begun anew when it comes to where it cannot go on.
ATTEMPTS = 100

# The most bytes that counting the ways home may take.
MOST_MEMORY = 1 << 30


def random_walk(reach: Reach, max_visits: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """
    Draw a closed walk of as many steps as there may be.

    Each step is drawn in proportion to the number of ways home that it leaves, so that all closed
    walks of this length are equally likely; of a cell that was entered `max_visits` times, no step
    leads into it. Where no walk of the length comes about, it is a step shorter.
    """
    ways = ways_home(reach)
    for steps in range(reach.within.size - 1, 1, -1):
        for _ in range(ATTEMPTS):
            walk = one_walk(reach.neighbors, ways[:steps], max_visits, rng)
            if len(walk) > steps:
                return reach.cells[walk]
    return reach.cells[[0, 0]]


def ways_home(reach: Reach) -> list[NDArray[np.float64]]:
    """
    Return how many walks of 0, 1, ... steps lead home from each cell, as shares of the most.

    Equation :eq:`walks`.
    """
    ways: list[NDArray[np.float64]] = [np.zeros(reach.cells.size)]
    ways[0][0] = 1.0
    for _ in range(reach.within.size - 2):
        onward = np.where(reach.neighbors >= 0, ways[-1][reach.neighbors], 0.0).sum(axis=1)
        ways.append(onward / onward.max())
    return ways


def one_walk(
    neighbors: NDArray[np.intp],
    ways: list[NDArray[np.float64]],
    max_visits: int,
    rng: np.random.Generator,
) -> list[int]:
    """Return a walk as ranks, one step for each of the `ways`; cut off where it cannot go on."""
    walk, entered = [0], np.zeros(len(neighbors), dtype=np.intp)
    for left in reversed(ways):
        onward = neighbors[walk[-1]]
        onward = onward[onward >= 0]
        weight = np.cumsum(np.where(entered[onward] < max_visits, left[onward], 0.0))
        if weight[-1] == 0.0:
            break
        step = int(onward[np.searchsorted(weight, rng.random() * weight[-1], side='right')])
        entered[step] += 1
        walk.append(step)
    return walk


def check_walk_memory(reach: Reach) -> None:
    """Check that the ways home can have the memory that they take."""
    estimate = 8 * reach.within.size * reach.cells.size
    if estimate > MOST_MEMORY:
        raise ValueError(
            f'random walks of max_steps = {reach.within.size - 1} take about {estimate / 1e9:.1f} '
            f'GB, and {MOST_MEMORY / 1e9:.1f} GB are allowed: lower it'
        )


def generator_of(*known: NDArray[np.generic]) -> np.random.Generator:
    """Return a generator that is the same for the same arrays."""
    digest = sha256()
    for each in known:
        digest.update(each.tobytes())
    return np.random.default_rng(np.frombuffer(digest.digest(), dtype='<u4'))
