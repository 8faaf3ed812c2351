# SPDX-License-Identifier: Apache-2.0
"""Loops of the local search that improves closed paths."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from kbnitp_ros.core.field import compiled, inlined
from kbnitp_ros.core.planning.objective.information_kernels import exposed, left_open
from kbnitp_ros.core.planning.search.label_kernels import (
    Floats,
    Gains,
    label_value,
    LabelObjective,
    LabelProblem,
    new_products,
    Places,
    Products,
    Reach,
    surprisal,
    visit,
)
from kbnitp_ros.core.planning.search.stretch_kernels import (
    find_long_stretch,
    find_stretch,
    Gap,
    new_room,
)
import numpy as np
from numpy.typing import NDArray


class Moves(NamedTuple):
    """
    What the local search replaces.

    Attributes
    ----------
    between, in_stem : int
        Up to so many cells in a row by all that fit, on one way and on both ways of a stem.
    long, long_in_stem : int
        So many likewise by label searches, once that does not help any more; 0 for none.

    """

    between: int
    in_stem: int
    long: int
    long_in_stem: int


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


@inlined
def visit_all(
    path: Places, first: int, last: int, gains: Gains, visits: Places, to: Products
) -> None:
    """Visit the cells of a path from one place to another: row 0 of `to`, and their counts."""
    for step in range(first, last + 1):
        cell = path[step]
        visit(to, 0, gains, cell, visits[cell], to, 0)
        visits[cell] += 1


@compiled
def take(path: Places, gains: Gains, visits: Places, to: Products) -> None:
    """Write the label of a closed path, ranks of cells, into row 0, and count its visits."""
    visits[:] = 0
    to.factor[0], to.term[0] = 1.0, 0.0
    visit_all(path, 1, path.size - 1, gains, visits, to)


@compiled
def outcome_value(products: Products, row: int, objective: LabelObjective) -> float:
    r"""
    Return the value of a label without the entropy that hazards leave in its own outcome.

    The first sum of equation :eq:`label-value`,

    .. math::

        \sum_\omega w_\omega \bigl[ h(P_\omega) + P_\omega J_\omega - c (1 - P_\omega) \bigr],

    over joint outcomes :math:`\omega` with the survival P and the information of readings J.
    """
    factor, term = products
    chance, loss_cost = objective.chance, objective.loss_cost
    powers = factor.shape[1] - chance.size
    value = -loss_cost
    for outcome in range(chance.size):
        survival = factor[row, powers + outcome]
        of_outcome = survival * (term[row, 1 + outcome] + loss_cost) + surprisal(1.0 - survival)
        value += chance[outcome] * of_outcome
    return value


@compiled
def exact_value(
    problem: LabelProblem, path: Places, hazard: Floats, log_safe: float, log_deadly: float
) -> float:
    """
    Return the value of a closed path, nats, without the error of the moments.

    Equation :eq:`objective-value`, with the chances to survive as of `exposed`.
    """
    products = new_products(1, problem.gains)
    take(path, problem.gains, np.empty(hazard.size, np.int64), products)
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
def replace(path: Places, steps: int, first: int, last: int, cells: Places, ways: int) -> int:
    """Write other cells between two places of a path; return the steps that it has then."""
    start, stop = first + 1, (steps if ways == 1 else steps - last) + 1
    rest = path[last:stop].copy()
    after = start + cells.size
    end = after + rest.size
    path[start:after] = cells
    path[after:end] = rest
    steps += ways * (cells.size - (last - first - 1))
    if ways == 2:
        for place in range(after):
            path[steps - place] = path[place]
    return steps


@compiled
def improve(
    problem: LabelProblem,
    path: Places,
    steps: int,
    most_between: int,
    ways: int,
    by_labels: bool,
    seen: Seen,
) -> tuple[int, bool]:
    """
    Replace stretches of a closed path by better ones until there are none: a local search.

    A stretch of up to `most_between` cells is replaced by the best of up to so many with which
    the path keeps to its length. With `by_labels` stretches of `most_between` cells are, or of
    fewer at the end, and by good ones.

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
    by_labels : bool
        Whether `find_long_stretch` looks for them, or `find_stretch`.
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
    cells = reach.neighbors.shape[0]
    room = new_room(cells, 1 + most_between * (cells if by_labels else 1), most_between, gains)
    # Metres up to each place.
    walked = np.zeros(path.size)
    measure(path[: steps + 1], reach, walked)
    take(path[: steps + 1], gains, room.visits, room.products)
    best_value = label_value(room.products, 0, objective)
    # The label of the first steps, `reached` of them.
    before, visits_before, reached = new_products(1, gains), np.zeros_like(room.visits), path.size
    # Places since the last replacement, up to all of them.
    first, unchanged = 0, 0
    places = stretches_end(path[: steps + 1], ways)
    while unchanged < places:
        if reached > first:
            before.factor[0], before.term[0] = 1.0, 0.0
            visits_before[:] = 0
            reached = 0
        visit_all(path, reached + 1, first, gains, visits_before, before)
        reached = first
        farthest = min(first + most_between + 1, places)
        found, last = -1, farthest - 1 if by_labels else first
        while found < 0 and last < farthest:
            last += 1
            between = last - first - 1
            room.visits[:] = visits_before
            room.products.factor[0], room.products.term[0] = before.factor[0], before.term[0]
            length = walked[steps] - (walked[last] - walked[first])
            back = steps if ways == 1 else steps - last
            visit_all(path, last, back, gains, room.visits, room.products)
            if ways == 2:
                visit_all(path, steps - first, steps, gains, room.visits, room.products)
                length -= walked[steps - first] - walked[back]
            is_kept = between > 0 and not by_labels
            gap = Gap(
                ways,
                min(most_between, (path.size - 1 - steps) // ways + between),
                path[first],
                path[last],
                path[first + 1] if is_kept else -1,
                path[last - 1] if is_kept else -1,
                length,
            )
            mark_steps_to(reach, gap.end, path[back], ways, room.closing)
            if between and length + room.closing[gap.start] <= reach.longest:
                value = label_value(room.products, 0, objective)
                if value > best_value:
                    best_value, found = value, 0
            if by_labels:
                value, count = find_long_stretch(problem, gap, room, best_value)
            else:
                value, count = find_stretch(problem, gap, room, best_value)
            if count > 0:
                best_value, found = value, count
            unmark_steps_to(reach, gap.end, room.closing)
        if found >= 0:
            steps = replace(path, steps, first, last, room.best[:found], ways)
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
    problem: LabelProblem, paths: NDArray[np.intp], steps: Places, moves: Moves
) -> None:
    """
    Improve closed paths until no move helps.

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
    moves : Moves
        That are tried.

    """
    seen = Seen(np.zeros(paths.size, np.int64), np.zeros(1, np.int64))
    for row in range(steps.size):
        path, count = paths[row], steps[row]
        goes_on = is_new(path[: count + 1], problem.marks, seen)
        while goes_on:
            old = path[: count + 1].copy()
            count, goes_on = improve(problem, path, count, moves.in_stem, 2, False, seen)
            if goes_on:
                count, goes_on = improve(problem, path, count, moves.between, 1, False, seen)
            if goes_on and moves.long and np.array_equal(path[: count + 1], old):
                count, goes_on = improve(problem, path, count, moves.long_in_stem, 2, True, seen)
                if goes_on:
                    count, goes_on = improve(problem, path, count, moves.long, 1, True, seen)
            goes_on = goes_on and not np.array_equal(path[: count + 1], old)
        steps[row] = count
