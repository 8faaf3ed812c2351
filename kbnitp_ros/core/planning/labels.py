# SPDX-License-Identifier: Apache-2.0
"""Label search: extend the best partial paths, then rank the best closed paths."""

from __future__ import annotations

from functools import lru_cache
from math import inf

from kbnitp_ros.core.field.check import Floats, Places
from kbnitp_ros.core.field.grid import Grid, longest
from kbnitp_ros.core.planning.information_kernels import exact_values, write_gains
from kbnitp_ros.core.planning.label_kernels import (
    Gains,
    LabelProblem,
    Reach,
    search,
    trace_closed,
)
from kbnitp_ros.core.planning.objective import (
    Candidate,
    DECIMALS,
    EXPONENTS,
    Objective,
    WEIGHTS,
)
from kbnitp_ros.core.planning.options import SearchOptions
import numpy as np
from numpy.typing import NDArray


# Cached, since a mission plans for the same few bases again and again.
@lru_cache(maxsize=8)
def find_reach(grid: Grid, max_steps: int, max_distance: float = 0.0) -> Reach:
    """Return the reach of paths within `max_steps` and `max_distance`."""
    cells = np.flatnonzero(grid.in_reach(max_steps, max_distance))
    cells = cells[np.argsort(grid.steps_to_base[cells], kind='stable')]
    rank = np.full(grid.cells + 1, -1)
    rank[cells] = np.arange(cells.size)
    step = np.arange(max_steps + 1)
    distance = grid.steps_to_base[cells]
    within = np.searchsorted(distance, np.minimum(step, max_steps - step), 'right')
    home = grid.distance_to_base[cells] if max_distance else np.zeros(cells.size)
    return Reach(
        cells,
        rank[grid.neighbor_table[cells]],
        within,
        np.append(0, np.cumsum(within)),
        grid.step_lengths.copy(),
        home,
        longest(max_distance),
    )


def visit_gains(objective: Objective, cells: Places, max_visits: int) -> Gains:
    """Return the gains of visits in `cells`, (n,) (:eq:`moment-power`, :eq:`moment-log`)."""
    log_survival, read = objective.of_visits(cells, max_visits)
    outcomes = len(log_survival)
    factors = EXPONENTS.size + outcomes
    sizes = (cells.size, max_visits)
    gains = Gains(np.empty((*sizes, factors)), np.empty((*sizes, 1 + outcomes)))
    hazard, interest = objective.belief.hazard[cells], objective.interest[cells]
    log_step = tuple(objective.model.log_survival.tolist())
    write_gains(log_survival, read, hazard, interest, log_step, EXPONENTS, gains)
    return gains


# Number of closed paths ranked by exact value for each label of a cell and step.
RANKED = 8


def best_paths(
    grid: Grid, objective: Objective, options: SearchOptions, kept: int
) -> list[Candidate]:
    """Search for closed paths of high value with `kept` labels; return them best first."""
    problem = label_problem(grid, objective, options)
    reach, count = problem.reach, RANKED * kept
    completions = np.empty((reach.start[-1] if kept > 1 else 0, problem.weight.size + 5))
    paths, steps = closed_paths(reach, count, *search(problem, 1, -inf, completions))
    if kept > 1:
        least = rounded_values(problem, objective, paths[:1], steps[:1])[0]
        least = least * problem.units - 1.0
        found = search(problem, kept, least, completions)
        more, more_steps = closed_paths(reach, count, *found)
        paths = np.concatenate([more, paths[:1]])
        steps = np.concatenate([more_steps, steps[:1]])
    if reach.cells.size > 1:
        paths, steps = leaving(reach, paths, steps)
    # Of paths with equal visits only the first is kept.
    is_visit = np.arange(1, paths.shape[1]) <= steps[:, None]
    marks = (problem.marks[paths[:, 1:]] * is_visit).sum(axis=1)
    first = np.sort(np.unique(marks, return_index=True)[1])
    paths, steps = paths[first], steps[first]
    values = rounded_values(problem, objective, paths, steps)
    return [
        Candidate(float(values[row]), reach.cells[paths[row, : steps[row] + 1]])
        for row in np.lexsort((steps, -values))
    ]


def leaving(reach: Reach, paths: Places, steps: Places) -> tuple[Places, Places]:
    """Return the paths that leave the base, at their first step; with the shortest ones added."""
    # The value depends only on the visits, so stays before the first step may come last.
    stays = np.argmax(paths > 0, axis=1) - 1
    leaves = stays >= 0
    moved = [
        np.append(path[wait:], path[:wait]) for path, wait in zip(paths[leaves], stays[leaves])
    ]
    around = reach.neighbors[0][reach.neighbors[0] > 0]
    # Where a loss costs much, every path that was found may stay at the base.
    short = np.zeros((around.size if reach.within.size > 2 else 0, paths.shape[1]), dtype=np.intp)
    short[:, 1:2] = around[: len(short), None]
    if reach.longest:
        short = short[2.0 * reach.home[short[:, 1]] <= reach.longest]
    paths = np.concatenate([np.reshape(moved, (-1, paths.shape[1])).astype(np.intp), short])
    return paths, np.append(steps[leaves], np.full(len(short), 2))


def label_problem(grid: Grid, objective: Objective, options: SearchOptions) -> LabelProblem:
    """Return the label search for an objective."""
    max_steps, chance = options.max_steps, objective.outcomes.probability
    reach = find_reach(grid, max_steps, options.max_distance)
    gains = visit_gains(objective, reach.cells, min(options.max_visits, max_steps))
    unread = unread_after(gains, WEIGHTS.size, max_steps)
    return LabelProblem(
        reach,
        scattered(reach.cells.size, 62 - max_steps.bit_length()),
        gains,
        WEIGHTS,
        chance,
        objective.loss_cost,
        10.0**DECIMALS,
        unread,
    )


def closed_paths(
    reach: Reach, count: int, origins: NDArray[np.int32], values: Floats
) -> tuple[Places, Places]:
    """Return the best `count` closed paths of ranks, a row each, and their numbers of steps."""
    best = np.argsort(-values, axis=None, kind='stable')[:count]
    steps, slots = np.divmod(best[values.flat[best] > -inf], values.shape[1])
    paths = np.zeros((steps.size, reach.within.size), dtype=np.intp)
    trace_closed(reach, origins, steps, slots, paths)
    return paths, steps


def rounded_values(
    problem: LabelProblem, objective: Objective, paths: Places, steps: Places
) -> Floats:
    """Return the exact values of closed paths of ranks, rounded."""
    cells = problem.reach.cells
    hazard, log_survival = objective.belief.hazard[cells], objective.model.log_survival
    return exact_values(problem, paths, steps, hazard, *log_survival).round(DECIMALS)


def unread_after(gains: Gains, powers: int, max_steps: int) -> Floats:
    """Return an upper bound on readings' information in the remaining steps (:eq:`unread`)."""
    survival = gains.factor[..., powers:]
    with np.errstate(divide='ignore', invalid='ignore'):
        risk = -np.log(survival)
        read = np.where(survival > 0.0, gains.term[..., 1:] - risk, 0.0)
    read, risk = read.max(axis=-1).ravel(), risk.min(axis=-1).ravel()
    read, risk = read[read > 0.0], risk[read > 0.0].clip(min=1e-300)
    order = np.argsort(-read / risk)
    survived = np.exp(-np.append(0.0, risk[order].cumsum()))
    survived[-1] = 0.0
    by_ratio = read[order].cumsum()
    by_size = np.append(0.0, np.sort(read)[::-1].cumsum())
    most = by_size[np.minimum(np.arange(max_steps, -1, -1), read.size)]
    # Both factors of min(by_ratio, most) * survived are monotonic.
    before = np.maximum.accumulate(np.append(0.0, by_ratio * survived[:-1]))
    place = by_ratio.searchsorted(most)
    bounds: Floats = np.maximum(before[place], most * survived[place])
    return bounds


@lru_cache(maxsize=8)
def scattered(cells: int, bits: int) -> NDArray[np.int64]:
    """Return a random hash for each cell, whose sums identify visits (splitmix)."""
    x = np.arange(1, cells + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((x ^ (x >> np.uint64(31))) >> np.uint64(64 - bits)).astype(np.int64)
