# SPDX-License-Identifier: Apache-2.0
"""Loops of the local search that improves closed paths."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from kbnitp_ros.core.field import compiled
from kbnitp_ros.core.planning.objective.information_kernels import exposed, left_open
from kbnitp_ros.core.planning.search.label_kernels import (
    Floats,
    Gains,
    label_value,
    LabelProblem,
    new_products,
    outcome_value,
    Places,
    Products,
    Reach,
    visit,
)
import numpy as np
from numpy.typing import NDArray


class Seen(NamedTuple):
    """
    Paths that the local search has come to.

    Attributes
    ----------
    mark : ndarray of int, shape (places,)
        The sums of the marks of their visits.
    kept : ndarray of int, shape (1,)
        How many of these there are.

    """

    mark: NDArray[np.int64]
    kept: NDArray[np.int64]


@compiled
def length_to(reach: Reach, cell: int, other: int) -> float:
    """Return the length of the step from a cell to another, metres; inf if there is none."""
    length = inf
    for column in range(9):
        if reach.neighbors[cell, column] == other:
            length = reach.length[column]
    return length


@compiled
def mark_steps_to(reach: Reach, to: int, back: int, ways: int, length: Floats) -> None:
    """Write the length of the step from each cell to a cell, with 2 ways also from `back`."""
    for column in range(9):
        cell = reach.neighbors[to, column]
        if cell >= 0:
            length[cell] = reach.length[column]
            if ways == 2:
                length[cell] += length_to(reach, back, cell)


@compiled
def unmark_steps_to(reach: Reach, to: int, length: Floats) -> None:
    """Write inf for each cell that is one step from a cell."""
    for column in range(9):
        cell = reach.neighbors[to, column]
        if cell >= 0:
            length[cell] = inf


@compiled
def measure(path: Places, reach: Reach, walked: Floats) -> None:
    """Write the length of a path up to each place, metres."""
    walked[0] = 0.0
    for step in range(1, path.size):
        walked[step] = walked[step - 1] + length_to(reach, path[step - 1], path[step])


@compiled
def take(
    path: Places,
    first: int,
    last: int,
    gains: Gains,
    visits: Places,
    to: Products,
    both_ways: bool = False,
) -> None:
    """
    Write the label of a path, ranks of cells, without the steps between two of its places.

    It is written into row 0 of `to`, and its visits to each cell are counted. With `both_ways`
    those between the same two places from the end are left out as well.
    """
    visits[:] = 0
    to.factor[0] = 1.0
    to.term[0] = 0.0
    for step in range(1, path.size):
        back = path.size - 1 - step
        if first < step < last or (both_ways and first < back < last):
            continue
        cell = path[step]
        visit(to, 0, gains, cell, visits[cell], to, 0)
        visits[cell] += 1


@compiled
def exact_value(
    problem: LabelProblem, path: Places, hazard: Floats, log_safe: float, log_deadly: float
) -> float:
    """
    Return the value of a closed path, nats, without the error of the moments.

    Equation :eq:`objective-value`, with the chances to survive as of `exposed`.
    """
    products = new_products(1, problem.gains)
    take(path, 0, 0, problem.gains, np.empty(hazard.size, np.int64), products)
    value: float = outcome_value(products, 0, problem.objective)
    return value - left_open(exposed(path[1:], hazard, log_safe, log_deadly))


@compiled
def exact_values(
    problem: LabelProblem,
    paths: NDArray[np.intp],
    steps: Places,
    hazard: Floats,
    log_safe: float,
    log_deadly: float,
) -> Floats:
    """Return `exact_value` of each path: row k of `paths` has steps[k] + 1 ranks."""
    values = np.empty(steps.size)
    for k in range(steps.size):
        path = paths[k, : steps[k] + 1]
        values[k] = exact_value(problem, path, hazard, log_safe, log_deadly)
    return values


@compiled
def mirrored(path: Places) -> int:
    """Return how many first steps of a path its last steps lead back, at most half of all."""
    steps = path.size - 1
    same = 0
    while same < steps // 2 and path[same + 1] == path[steps - same - 1]:
        same += 1
    return same


@compiled
def stretches_end(path: Places, ways: int) -> int:
    """
    Return the last place of a path where a stretch that is replaced may end.

    On both ways that is the one after those on which its last steps lead back its first ones.
    """
    steps = path.size - 1
    return steps if ways == 1 else min(mirrored(path) + 1, steps // 2)


@compiled
def is_new(path: Places, marks: NDArray[np.int64], seen: Seen) -> bool:
    """Return whether no path of the same visits was seen, and remember it if there is room."""
    mark = 0
    for step in range(1, path.size):
        mark += marks[path[step]]
    count = seen.kept[0]
    for k in range(count):
        if seen.mark[k] == mark:
            return False
    if count < seen.mark.size:
        seen.mark[count] = mark
        seen.kept[0] += 1
    return True


@compiled
def improve(
    problem: LabelProblem, path: Places, steps: int, most_between: int, ways: int, seen: Seen
) -> tuple[int, bool]:
    """
    Replace stretches of a closed path by better ones until there are none: a local search.

    A stretch of up to `most_between` cells is replaced by the best of up to so many with which
    the path keeps to its length: all else stays, so its value is that of the whole path.

    Parameters
    ----------
    problem : LabelProblem
        As for `search`.
    path : ndarray of int, shape (max_steps + 1,)
        Ranks of the cells, the first steps + 1 of them; it is changed.
    steps : int
        Of the path.
    most_between : int
        See above.
    ways : int
        1, or 2 to replace stretches of the first steps, together with those of the last steps that
        lead back the same way; the cells between which these end may differ.
    seen : Seen
        Paths that are not gone on from; is added to.

    Returns
    -------
    int
        The steps it has now.
    bool
        Whether it was not seen before.

    """
    reach, marks, gains, objective = problem
    max_visits, neighbors = gains.factor.shape[1], reach.neighbors
    visits = np.zeros(neighbors.shape[0], np.int64)
    products = new_products(most_between + 1, gains)
    # Metres up to each place; and up to each cell of a stretch, with all that stays.
    walked, length = np.zeros(path.size), np.zeros(most_between + 1)
    measure(path[: steps + 1], reach, walked)
    stretch, best = np.empty(most_between + 1, np.int64), np.empty(most_between + 1, np.int64)
    column = np.empty(most_between + 1, np.int64)
    take(path[: steps + 1], 0, 0, gains, visits, products)
    best_value = label_value(products, 0, objective)
    # Metres of the steps that join each cell to where a stretch ends; inf where there are none.
    closing = np.full(neighbors.shape[0], inf)
    # Places since the last replacement, up to all of them.
    first, unchanged = 0, 0
    places = stretches_end(path[: steps + 1], ways)
    while unchanged < places:
        found, last = -1, first
        while found < 0 and last < min(first + most_between + 1, places):
            last += 1
            between = last - first - 1
            take(path[: steps + 1], first, last, gains, visits, products, ways == 2)
            most = min(most_between, (path.size - 1 - steps) // ways + between)
            length[0] = walked[steps] - (walked[last] - walked[first])
            if ways == 2:
                length[0] -= walked[steps - first] - walked[steps - last]
            mark_steps_to(reach, path[last], path[steps - last], ways, closing)
            # Depth first through all stretches; row `depth` is the label with so many cells.
            depth, stretch[0], column[0] = 0, path[first], 0
            while depth >= 0:
                cell = stretch[depth]
                if column[depth] == 0:
                    closed = length[depth] + closing[cell]
                    value = label_value(products, depth, objective) if closed < inf else -inf
                    if value > best_value and closed <= reach.longest:
                        best_value, found = value, depth
                        best[: depth + 1] = stretch[: depth + 1]
                if column[depth] == 9 or depth == most:
                    if depth > 0:
                        visits[cell] -= ways
                    depth -= 1
                    continue
                there = neighbors[cell, column[depth]]
                column[depth] += 1
                if there < 0 or visits[there] + ways > max_visits:
                    continue
                if depth == 0 and between and there == path[first + 1]:
                    # That is the stretch from the next place.
                    continue
                if depth + 1 < most or closing[there] < inf:
                    row = depth
                    for _ in range(ways):
                        visit(products, row, gains, there, visits[there], products, depth + 1)
                        visits[there] += 1
                        row = depth + 1
                    length[depth + 1] = length[depth] + ways * reach.length[column[depth] - 1]
                    depth += 1
                    stretch[depth], column[depth] = there, 0
            unmark_steps_to(reach, path[last], closing)
        if found >= 0:
            stop = steps + 1 if ways == 1 else steps - last + 1
            rest = path[last:stop].copy()
            for k in range(1, found + 1):
                path[first + k] = best[k]
            for k in range(rest.size):
                path[first + found + 1 + k] = rest[k]
            steps += ways * (found - between)
            if ways == 2:
                for k in range(first + found + 1):
                    path[steps - k] = path[k]
            measure(path[: steps + 1], reach, walked)
            if not is_new(path[: steps + 1], marks, seen):
                return steps, False
            places = stretches_end(path[: steps + 1], ways)
            first, unchanged = first % max(1, places), 0
        else:
            first, unchanged = (first + 1) % places, unchanged + 1
    return steps, True


@compiled
def improve_all(
    problem: LabelProblem, paths: NDArray[np.intp], steps: Places, most_between: int, in_stem: int
) -> None:
    """
    Improve closed paths until neither replacing cells of a stem nor replacing cells helps.

    A path that comes to one that was there before is left so. One call for all: to hand over
    `problem` takes as long as to improve some paths.

    Parameters
    ----------
    problem : LabelProblem
        What was searched for.
    paths : ndarray of int, shape (paths, max_steps + 1)
        Ranks of their cells, and room; are changed.
    steps : ndarray of int, shape (paths,)
        Of each path; are changed.
    most_between, in_stem : int
        As `most_between` of `improve`, on one way and on both ways of a stem.

    """
    seen = Seen(np.zeros(paths.size, np.int64), np.zeros(1, np.int64))
    for row in range(steps.size):
        path, count = paths[row], steps[row]
        goes_on = is_new(path[: count + 1], problem.marks, seen)
        while goes_on:
            before = path[: count + 1].copy()
            count, goes_on = improve(problem, path, count, in_stem, 2, seen)
            if goes_on:
                count, goes_on = improve(problem, path, count, most_between, 1, seen)
            goes_on = goes_on and not np.array_equal(path[: count + 1], before)
        steps[row] = count
