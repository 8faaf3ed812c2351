# SPDX-License-Identifier: Apache-2.0
"""
Loops that go through the closed walks which may be worth more than the best path known.

Cells go by their rank in `Reach`, as in `bound_dual_kernels`.
"""

from __future__ import annotations

from math import exp, inf
from typing import Any, NamedTuple

from kbnitp_ros.core.field import compiled
from kbnitp_ros.core.planning.search.bound_dual_kernels import Walks
from kbnitp_ros.core.planning.search.bound_maximum_kernels import entropy_of
from kbnitp_ros.core.planning.search.label_kernels import Reach
import numpy as np


class Worth(NamedTuple):
    """
    What the values of paths of so many steps are computed from.

    Attributes
    ----------
    hazard : ndarray, shape (cells,)
        P(Z = 1).
    lost : ndarray, shape (steps + 1,)
        (p - 1) ln (1 - p), with the chance p to survive so many exposures to hazards.
    loss_cost : float
        Nats.
    most : float
        Of the sum r that a path may have.

    """

    hazard: Any
    lost: Any
    loss_cost: float
    most: float


@compiled
def value_of(visits: Any, added: Any, worth: Worth) -> float:
    """
    Return the value of a path with such visits to each cell, shape (cells,), nats.

    Equation :eq:`bound-value`, for which exposures are counted as in :eq:`exposures`.
    """
    w, r, most = 0.0, 0.0, 0
    chance = np.zeros(worth.lost.size)
    chance[0] = 1.0
    for cell in range(visits.size):
        n, z = visits[cell], worth.hazard[cell]
        if n == 0:
            continue
        w += added[cell, n, 0]
        r += added[cell, n, 1]
        most += n
        for c in range(most, n - 1, -1):
            chance[c] = (1.0 - z) * chance[c] + z * chance[c - n]
        for c in range(n):
            chance[c] *= 1.0 - z
    survival = exp(-r)
    value = entropy_of(survival) + survival * (w + worth.loss_cost) - worth.loss_cost
    for c in range(chance.size):
        value -= chance[c] * worth.lost[c]
    return value


@compiled
def prices_home(walks: Walks, steps: int, multipliers: Any) -> Any:
    """Return the greatest sum of prices of so many steps home from a cell, by both."""
    cells = walks.most.size
    prices = np.full((steps + 1, cells), -inf)
    prices[0, 0] = 0.0
    for left in range(1, steps + 1):
        for cell in range(cells):
            for column in range(9):
                there = walks.neighbors[cell, column]
                if there >= 0:
                    price = prices[left - 1, there] + multipliers[there]
                    prices[left, cell] = max(prices[left, cell], price)
    return prices


@compiled
def best_from(walks: Walks, multipliers: Any) -> Any:
    """Return the most that so many visits or more bring beyond their price, by cell and visits."""
    cells, visits = walks.added.shape[:2]
    best = np.full((cells, visits), -inf)
    for cell in range(cells):
        for n in range(visits - 1, -1, -1):
            if n + 1 < visits:
                best[cell, n] = best[cell, n + 1]
            if walks.fewest[cell] <= n <= walks.most[cell]:
                gain = walks.added[cell, n, 0] - n * multipliers[cell]
                gain -= multipliers[cells] * walks.added[cell, n, 1]
                gain -= multipliers[cells + 1] * walks.added[cell, n, 2]
                best[cell, n] = max(best[cell, n], gain)
    return best


@compiled
def go_through(
    walks: Walks,
    reach: Reach,
    multipliers: Any,
    worthless: float,
    worth: Worth,
    known: float,
    most: int,
    best: Any,
) -> Any:
    """
    Find the best closed walk by going through those that may be better than what is known.

    Equation :eq:`bound-walk`, depth first.

    Parameters
    ----------
    walks : Walks
        What may be visited.
    reach : Reach
        Of the paths: how long they may be.
    multipliers : ndarray, shape (cells + 2,)
        Of a cut.
    worthless : float
        With such a D of that cut no value is of interest.
    worth : Worth
        Of walks of so many steps.
    known : float
        The best value known, nats.
    most : int
        How many steps may be taken in all; a walk that is begun is left when they were.
    best : ndarray of int, shape (steps + 1,)
        The best walk, ranks; unchanged unless it is better than what is known.

    Returns
    -------
    value : float
        The best known now, nats.
    taken : int
        How many steps were taken: more than `most` if they were not enough.

    """
    steps, cells = best.size - 1, walks.most.size
    home, beyond = prices_home(walks, steps, multipliers), best_from(walks, multipliers)
    visits = np.zeros(cells, np.int64)
    walk, column = np.zeros(steps + 1, np.int64), np.zeros(steps + 1, np.int64)
    # What the visits so far leave to the sums of the cut, but for the way home.
    left, r = np.zeros(steps + 1), np.zeros(steps + 1)
    length = np.zeros(steps + 1)
    for cell in range(cells):
        left[0] += beyond[cell, 0]
    step, taken = 0, 0
    while step >= 0 and taken <= most:
        if column[step] == 9 or step == steps:
            visits[walk[step]] -= 1
            step -= 1
            continue
        there = walks.neighbors[walk[step], column[step]]
        column[step] += 1
        if there < 0 or visits[there] >= walks.most[there]:
            continue
        n = visits[there]
        after = left[step] + multipliers[there] + beyond[there, n + 1] - beyond[there, n]
        r[step + 1] = r[step] + walks.added[there, n + 1, 1] - walks.added[there, n, 1]
        if r[step + 1] > worth.most:
            continue
        if after + home[steps - step - 1, there] <= worthless:
            continue
        length[step + 1] = length[step] + reach.length[column[step] - 1]
        if length[step + 1] + reach.home[there] > reach.longest:
            continue
        taken += 1
        step += 1
        visits[there] += 1
        walk[step], left[step], column[step] = there, after, 0
        if step == steps:
            value = value_of(visits, walks.added, worth)
            if value > known:
                known = value
                best[:] = walk
    return known, taken
