# SPDX-License-Identifier: Apache-2.0
"""
Loops of the Lagrangian dual that cuts off sums which no closed walk has.

Cells go by their rank in `Reach`: the base has rank 0, and those within so many steps of it are
the first so many. The multipliers of equation :eq:`bound-cut` are one array of shape (cells + 2,):
the price of a visit to each cell, then lambda and mu.
"""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

from kbnitp_ros.core.field import compiled
import numpy as np


class Walks(NamedTuple):
    """
    Closed walks from the base and the visits that they may make.

    Attributes
    ----------
    neighbors : ndarray of int, shape (cells, 9)
        Ranks of the cells one step away, -1 where there is none.
    within : ndarray of int, shape (max_steps + 1,)
        How many cells are within so many steps of the base, up to half of them.
    added : ndarray, shape (cells, visits + 1, 3)
        As of `VisitSums`.
    fewest, most : ndarray of int, shape (cells,)
        Of the visits to each cell.

    """

    neighbors: Any
    within: Any
    added: Any
    fewest: Any
    most: Any


class Memory(NamedTuple):
    """
    What the dual writes while it is minimised.

    Attributes
    ----------
    value : ndarray, shape (2, cells)
        The greatest sum of prices of a walk to each cell, at two steps in turn.
    origin : ndarray of int8, shape (max_steps + 1, cells)
        The column of `neighbors` from which that walk comes.
    gradient : ndarray, shape (cells + 2,)
        A subgradient by the multipliers.
    share : ndarray, shape (cells,)
        The share of the best walks that visit each cell, the last ones most.

    """

    value: Any
    origin: Any
    gradient: Any
    share: Any


@compiled
def best_walk(walks: Walks, steps: int, multipliers: Any, memory: Memory) -> Any:
    r"""
    Return the greatest sum of prices of a closed walk; its visits become the gradient.

    The first maximum of equation :eq:`bound-cut`, by

    .. math:: v_t(j) = \pi_j + \max_{k \text{ next to } j} v_{t-1}(k) .
    """
    before = 1
    memory.value[0, 0] = 0.0
    for t in range(1, steps + 1):
        now = walks.within[min(t, steps - t)]
        here, there = t % 2, (t - 1) % 2
        for cell in range(now):
            best, column = -inf, 0
            for k in range(9):
                origin = walks.neighbors[cell, k]
                if 0 <= origin < before and memory.value[there, origin] > best:
                    best, column = memory.value[there, origin], k
            memory.value[here, cell] = best + multipliers[cell]
            memory.origin[t, cell] = column
        before = now
    memory.gradient[:] = 0.0
    cell = 0
    for t in range(steps, 0, -1):
        memory.gradient[cell] += 1.0
        cell = walks.neighbors[cell, memory.origin[t, cell]]
    return memory.value[steps % 2, 0]


@compiled
def best_visits(walks: Walks, multipliers: Any, gradient: Any) -> float:
    """
    Return the sum of the most that the visits to each cell bring beyond their price.

    The second maximum of equation :eq:`bound-cut`. What these visits have of each sum is taken
    from the gradient.
    """
    total, cells = 0.0, walks.most.size
    for cell in range(cells):
        best, count = -inf, 0
        for n in range(walks.fewest[cell], walks.most[cell] + 1):
            gain = walks.added[cell, n, 0] - n * multipliers[cell]
            gain -= multipliers[cells] * walks.added[cell, n, 1]
            gain -= multipliers[cells + 1] * walks.added[cell, n, 2]
            if gain > best:
                best, count = gain, n
        total += best
        gradient[cell] -= count
        gradient[cells] -= walks.added[cell, count, 1]
        gradient[cells + 1] -= walks.added[cell, count, 2]
    return total


@compiled
def minimise(
    walks: Walks, steps: int, multipliers: Any, r: float, r2: float, enough: float, memory: Memory
) -> Any:
    """
    Find multipliers with a low cut at a point, by deflected subgradients.

    The step is Polyak's towards a level below the best value, by a span that is halved when it is
    not reached (Camerini, Fratta and Maffioli 1975; Goffin and Kiwiel 1999).

    Parameters
    ----------
    walks : Walks
        What may be visited.
    steps : int
        Of the walks, at least 1.
    multipliers : ndarray, shape (cells + 2,)
        Where to start; then the best.
    r, r2 : float
        The point.
    enough : float
        A value of the cut at the point that need not be lowered.
    memory : Memory
        Is written.

    Returns
    -------
    float
        D of the cut with the multipliers.

    """
    cells = walks.most.size
    tried, direction = multipliers.copy(), np.zeros(cells + 2)
    best, reference, span, stalled = inf, inf, 0.0, 0
    memory.share[:] = 0.5
    for round_ in range(400):
        value = best_walk(walks, steps, tried, memory)
        for cell in range(cells):
            visited = 1.0 if memory.gradient[cell] > 0.0 else 0.0
            memory.share[cell] += 0.05 * (visited - memory.share[cell])
        value += best_visits(walks, tried, memory.gradient)
        value += tried[cells] * r + tried[cells + 1] * r2
        memory.gradient[cells] += r
        memory.gradient[cells + 1] += r2
        if round_ == 0:
            span = max(0.5 * (value - enough), 1e-3)
        if value < best:
            best = value
            multipliers[:] = tried
        if best <= enough:
            break
        stalled += 1
        if best < reference - 0.5 * span:
            reference, stalled = best, 0
        elif stalled > 12:
            span *= 0.5
            if span < 1e-5:
                break
            reference, stalled = best, 0
            tried[:] = multipliers
            direction[:] = 0.0
            continue
        along, old = 0.0, 0.0
        for k in range(cells + 2):
            along += memory.gradient[k] * direction[k]
            old += direction[k] * direction[k]
        deflection = -1.5 * along / old if along < 0.0 else 0.0
        norm = 0.0
        for k in range(cells + 2):
            direction[k] = memory.gradient[k] + deflection * direction[k]
            norm += direction[k] * direction[k]
        if norm == 0.0:
            break
        step = (value - max(enough, best - span)) / norm
        for k in range(cells + 2):
            tried[k] -= step * direction[k]
    return best - multipliers[cells] * r - multipliers[cells + 1] * r2
