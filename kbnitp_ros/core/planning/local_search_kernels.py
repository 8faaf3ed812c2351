# SPDX-License-Identifier: Apache-2.0
"""
Kernels of the local search that improves closed paths, and of exact values.

The value of a label is the value of the whole path with the label's cells in the gap.
"""

from __future__ import annotations

from math import floor, inf
from typing import NamedTuple

from kbnitp_ros.core.field.compiled import compiled, inlined
from kbnitp_ros.core.planning.information_kernels import exposed, left_open
from kbnitp_ros.core.planning.label_kernels import (
    averaged_value,
    Floats,
    Gains,
    label_value,
    LabelProblem,
    new_products,
    Places,
    Products,
    Reach,
    surprisal,
    visit,
)
import numpy as np


class Gap(NamedTuple):
    """A gap in a closed path, to be filled with cells."""

    # Maximum number of cells in the gap.
    most: int
    # The cells before and after the gap.
    start: int
    end: int
    # The first and last cells removed; -1 for none. They are not tried in their old places: paths
    # that keep them have a shorter gap.
    old_first: int
    old_last: int
    # Length of the path without the gap, metres.
    length: float


class GapLabels(NamedTuple):
    """Work space: the path outside the gap in row 0, and labels with cells in the gap."""

    # Visits of the path outside the gap, and of the cells tried in it, shape (cells,).
    visits: Places
    # Metres of the step from each cell to the end of the gap, inf if it is no neighbour, shape
    # (cells,).
    closing: Floats
    # Products and sums of labels; row 0 is the label of the path outside the gap.
    products: Products
    # Length of the path outside the gap, and of each label, metres, shape (rows,).
    length: Floats
    # Last cell of each label, and the next column of `Reach.neighbors` to extend it to, shape
    # (rows,).
    cell: Places
    column: Places
    # The best cells for the gap, shape (rows,).
    best: Places


@inlined
def value_after(
    products: Products, row: int, problem: LabelProblem, rank: int, before: int
) -> float:
    """Return the `label_value` after a `visit`, without writing the label."""
    factor, term, gains = products.factor, products.term, problem.gains
    weight, chance = problem.weight, problem.chance
    powers = weight.size
    left_open, mean = 0.0, factor[row, 0] * gains.factor[rank, before, 0]
    for k in range(powers):
        left_open += weight[k] * (factor[row, k] * gains.factor[rank, before, k])
    left_open -= mean * (term[row, 0] + gains.term[rank, before, 0])
    lost, lost_square, brought = 0.0, 0.0, 0.0
    for outcome in range(chance.size):
        survival = factor[row, powers + outcome] * gains.factor[rank, before, powers + outcome]
        loss = chance[outcome] * (1.0 - survival)
        lost += loss
        lost_square += loss * (1.0 - survival)
        readings = term[row, 1 + outcome] + gains.term[rank, before, 1 + outcome]
        brought += chance[outcome] * survival * readings
    value: float = averaged_value(brought, lost, lost_square, problem.loss_cost) - left_open
    return floor(value * problem.units + 0.5)


@inlined
def visit_all(
    path: Places, first: int, last: int, gains: Gains, visits: Places, to: Products
) -> None:
    """Extend the label in row 0 of `to`, and the visit counts, by a stretch of a path."""
    for step in range(first, last + 1):
        cell = path[step]
        visit(to, 0, gains, cell, visits[cell], to, 0)
        visits[cell] += 1


@compiled
def take(path: Places, gains: Gains, visits: Places, to: Products) -> None:
    """Write the label of a closed path of ranks into row 0, and count its visits."""
    visits[:] = 0
    to.factor[0], to.term[0] = 1.0, 0.0
    visit_all(path, 1, path.size - 1, gains, visits, to)


@compiled
def exact_values(
    problem: LabelProblem,
    paths: Places,
    steps: Places,
    hazard: Floats,
    log_safe: float,
    log_deadly: float,
) -> Floats:
    """Return the exact values of closed paths, nats (:eq:`objective-value`)."""
    chance, powers = problem.chance, problem.weight.size
    values = np.empty(steps.size)
    products, visits = new_products(1, problem.gains), np.empty(hazard.size, np.int64)
    for k in range(steps.size):
        path = paths[k, : steps[k] + 1]
        take(path, problem.gains, visits, products)
        value = -problem.loss_cost
        for outcome in range(chance.size):
            survival = products.factor[0, powers + outcome]
            readings = products.term[0, 1 + outcome] + problem.loss_cost
            value += chance[outcome] * (survival * readings + surprisal(1.0 - survival))
        chances, log_survival = exposed(path[1:], hazard, log_safe, log_deadly)
        values[k] = value - left_open(chances, log_survival)
    return values


@compiled
def length_to(reach: Reach, cell: int, other: int) -> float:
    """Return the length of the step between two cells, metres; inf if not neighbours."""
    length = inf
    for column in range(9):
        if reach.neighbors[cell, column] == other:
            length = reach.length[column]
    return length


@compiled
def measure(path: Places, reach: Reach, walked: Floats) -> None:
    """Write the length of a path up to each index, metres."""
    walked[0] = 0.0
    for step in range(1, path.size):
        walked[step] = walked[step - 1] + length_to(reach, path[step - 1], path[step])


@inlined
def fill(problem: LabelProblem, gap: Gap, room: GapLabels, least: float) -> tuple[float, int]:
    """Find the best cells for a gap by depth-first search; return value and number of cells."""
    reach, gains = problem.reach, problem.gains
    visits, closing, products = room.visits, room.closing, room.products
    length, cell, column, best = room.length, room.cell, room.column, room.best
    max_visits = gains.factor.shape[1]
    value, found, depth = least, -1, 0
    cell[0], column[0], length[0] = gap.start, 0, gap.length
    while depth >= 0:
        if column[depth] == 9 or gap.most == 0:
            if depth > 0:
                visits[cell[depth]] -= 1
            depth -= 1
            continue
        there = reach.neighbors[cell[depth], column[depth]]
        metres = length[depth] + reach.length[column[depth]]
        column[depth] += 1
        if there < 0 or visits[there] >= max_visits or (depth == 0 and there == gap.old_first):
            continue
        if metres + closing[there] <= reach.longest and there != gap.old_last:
            closed = value_after(products, depth, problem, there, visits[there])
            if closed > value:
                value, found = closed, depth + 1
                for place in range(depth):
                    best[place] = cell[place + 1]
                best[depth] = there
        if depth + 1 < gap.most:
            visit(products, depth, gains, there, visits[there], products, depth + 1)
            visits[there] += 1
            depth += 1
            cell[depth], column[depth], length[depth] = there, 0, metres
    return value, found


@compiled
def improve(problem: LabelProblem, path: Places, steps: int, most_between: int) -> int:
    """Improve a path in place by replacing runs of cells; return its number of steps."""
    reach, gains = problem.reach, problem.gains
    cells, rows = reach.neighbors.shape[0], 1 + most_between
    room = GapLabels(
        np.zeros(cells, np.int64),
        np.full(cells, inf),
        new_products(rows, gains),
        np.empty(rows),
        np.empty(rows, np.int64),
        np.empty(rows, np.int64),
        np.empty(rows, np.int64),
    )
    # Length of the path up to each index, metres.
    walked = np.zeros(path.size)
    measure(path[: steps + 1], reach, walked)
    take(path[: steps + 1], gains, room.visits, room.products)
    best_value = label_value(room.products, 0, problem)
    # The label of the first `reached` steps.
    before, visits_before, reached = new_products(1, gains), np.zeros_like(room.visits), path.size
    # Start of the gap, and number of starts tried since the last replacement.
    first, unchanged = 0, 0
    while unchanged < steps:
        if reached > first:
            before.factor[0], before.term[0] = 1.0, 0.0
            visits_before[:] = 0
            reached = 0
        visit_all(path, reached + 1, first, gains, visits_before, before)
        reached = first
        found, last = -1, first
        while found < 0 and last < min(first + most_between + 1, steps):
            last += 1
            between = last - first - 1
            room.visits[:] = visits_before
            room.products.factor[0], room.products.term[0] = before.factor[0], before.term[0]
            visit_all(path, last, steps, gains, room.visits, room.products)
            gap = Gap(
                min(most_between, path.size - 1 - steps + between),
                path[first],
                path[last],
                path[first + 1] if between > 0 else -1,
                path[last - 1] if between > 0 else -1,
                walked[steps] - (walked[last] - walked[first]),
            )
            for column in range(9):
                if reach.neighbors[gap.end, column] >= 0:
                    room.closing[reach.neighbors[gap.end, column]] = reach.length[column]
            if between and gap.length + room.closing[gap.start] <= reach.longest:
                value = label_value(room.products, 0, problem)
                if value > best_value:
                    best_value, found = value, 0
            value, count = fill(problem, gap, room, best_value)
            if count > 0:
                best_value, found = value, count
            for column in range(9):
                if reach.neighbors[gap.end, column] >= 0:
                    room.closing[reach.neighbors[gap.end, column]] = inf
        if found >= 0:
            after, end = first + 1 + found, steps + 1
            rest = path[last:end].copy()
            start, steps = first + 1, first + found + rest.size
            path[start:after] = room.best[:found]
            end = steps + 1
            path[after:end] = rest
            measure(path[: steps + 1], reach, walked)
            first, unchanged = first % steps, 0
        else:
            first, unchanged = (first + 1) % steps, unchanged + 1
    return steps


@compiled
def improve_all(problem: LabelProblem, paths: Places, steps: Places, most_between: int) -> None:
    """Improve closed paths, row k of `paths` with steps[k] + 1 ranks; both are changed."""
    for row in range(steps.size):
        steps[row] = improve(problem, paths[row], steps[row], most_between)
