# SPDX-License-Identifier: Apache-2.0
"""
Loops of the label search.

Cells go by their rank in the order of their distance from the base, which has rank 0, so those
that a label may end in after some number of steps are the first so many. A label is a path from
the base to such a cell. It carries numbers that a visit multiplies, its factors,

    E[p^a] for each exponent a, with p = P(survive | z), the first of them 1
    P0 of each fate

and numbers that a visit adds to, its terms,

    E[p ln p] / E[p]
    for each fate, the information of readings less ln P0

With g(p) = -(1 - p) ln(1 - p), a label is worth

    sum_f chance_f (P0_f term_f + g(P0_f)) + E[p] term_0 - sum_j weight_j E[p^(a_j)]
        - loss_cost (1 - sum_f chance_f P0_f)

which is h(P0) - E[h(p)] + P0 readings - loss_cost (1 - P0), but for the error of the moments.

Arguments that stay the same come in tuples, of which more than one kernel takes

    gains      what a visit does to factors and terms, two arrays indexed [rank, visits before,
               ...]
    objective  weight of each moment, chance of each fate, loss_cost, and the units to the nat in
               which worths are compared, so that rounding never decides for a path
    labels     factor and term, indexed [row, ...]; mark and seen, indexed [row]; kept, indexed
               [rank]. The labels at a cell have the first `kept` of its `width` rows. Marks are
               equal for equal visits; seen counts those to the cells around.
"""

from __future__ import annotations

from math import floor, inf, log
from typing import Any

from kbnitp_ros.core.field import compiled
import numpy as np


@compiled
def surprisal(p: float) -> float:
    """Return -p ln p."""
    return -p * log(p) if p > 0.0 else 0.0


@compiled
def fate_worth(factor: Any, term: Any, row: int, chance: Any, loss_cost: float) -> float:
    """Return the worth of a label, but for what hazards leave open of its own fate."""
    powers = factor.shape[1] - chance.size
    worth = -loss_cost
    for fate in range(chance.size):
        survival = factor[row, powers + fate]
        of_fate = survival * (term[row, 1 + fate] + loss_cost) + surprisal(1.0 - survival)
        worth += chance[fate] * of_fate
    return worth


@compiled
def label_worth(
    factor: Any, term: Any, row: int, weight: Any, chance: Any, loss_cost: float, units: float
) -> float:
    """Return the worth of a label, in units."""
    left_open = -factor[row, 0] * term[row, 0]
    for k in range(weight.size):
        left_open += weight[k] * factor[row, k]
    worth: float = fate_worth(factor, term, row, chance, loss_cost) - left_open
    return floor(worth * units + 0.5)


@compiled
def visit(
    factor: Any,
    term: Any,
    row: int,
    gain_factor: Any,
    gain_term: Any,
    rank: int,
    before: int,
    to_factor: Any,
    to_term: Any,
    to_row: int,
) -> None:
    """Write a label after one more visit to a cell that it visits so often before."""
    for k in range(factor.shape[1]):
        to_factor[to_row, k] = factor[row, k] * gain_factor[rank, before, k]
    for k in range(term.shape[1]):
        to_term[to_row, k] = term[row, k] + gain_term[rank, before, k]


@compiled
def insert(score: float, mark: int, origin: int, scores: Any, marks: Any, origins: Any) -> None:
    """
    Put a candidate among the best, the best first, unless one of them has its mark.

    It must be better than the last of them; of equal ones the earlier is the better. Those of
    equal marks have equal scores.
    """
    low, high = 0, scores.size
    while low < high:
        middle = (low + high) // 2
        if scores[middle] >= score:
            low = middle + 1
        else:
            high = middle
    twin = low - 1
    while twin >= 0 and scores[twin] == score:
        if marks[twin] == mark:
            return
        twin -= 1
    for slot in range(scores.size - 1, low, -1):
        scores[slot] = scores[slot - 1]
        marks[slot] = marks[slot - 1]
        origins[slot] = origins[slot - 1]
    scores[low], marks[low], origins[low] = score, mark, origin


@compiled
def find_best(
    rank: int,
    around: Any,
    marks: Any,
    gains: Any,
    objective: Any,
    labels: Any,
    home: Any,
    by_worth: Any,
    by_promise: Any,
) -> None:
    """
    Find the best ways to extend labels to a cell.

    Parameters
    ----------
    rank : int
        The cell.
    around : ndarray of int, shape (9,)
        Where labels come from, -1 where there are none.
    marks : ndarray of int, shape (cells,)
        What a visit adds to the mark of a label.
    gains, objective, labels : tuple
        See above.
    home : ndarray, shape (powers + 4,)
        A way home from the cell: its moments times their weights, E[p], P0, and the terms of both.
    by_worth, by_promise : tuple of ndarray
        The best by their worth, and by their worth with the way home: score in units, -inf for
        none, mark, and origin, which is 16 * slot + column of `around`.

    """
    gain_factor, gain_term = gains
    weight, chance, loss_cost, units = objective
    factor, term, mark, seen, kept = labels
    score, score_mark, score_origin = by_worth
    hope, hope_mark, hope_origin = by_promise
    powers, max_visits = weight.size, gain_factor.shape[1]
    width = mark.size // kept.size
    for slot in range(score.size):
        score[slot] = -inf
    for slot in range(hope.size):
        hope[slot] = -inf
    home_mean, home_survival = home[powers], home[powers + 1]
    home_spread, home_term = home[powers + 2], home[powers + 3]
    for column in range(9):
        if around[column] < 0:
            continue
        for slot in range(kept[around[column]]):
            row = around[column] * width + slot
            before = seen[row, 8 - column]
            if before >= max_visits:
                continue
            left_open, left_open_home = 0.0, 0.0
            for k in range(powers):
                moment = factor[row, k] * gain_factor[rank, before, k]
                left_open += weight[k] * moment
                left_open_home += home[k] * moment
            lost, lost_square, brought = 0.0, 0.0, 0.0
            for fate in range(chance.size):
                survival = factor[row, powers + fate] * gain_factor[rank, before, powers + fate]
                loss = chance[fate] * (1.0 - survival)
                lost += loss
                lost_square += loss * (1.0 - survival)
                brought += (
                    chance[fate]
                    * survival
                    * (term[row, 1 + fate] + gain_term[rank, before, 1 + fate])
                )
            mean = factor[row, 0] * gain_factor[rank, before, 0]
            spread = term[row, 0] + gain_term[rank, before, 0]
            next_mark = mark[row] + marks[rank]

            worth = brought + surprisal(lost) + mean * spread - left_open - loss_cost * lost
            if lost > 0.0:
                # Over several fates -q ln q is averaged to second order: its curvature is -1 / q.
                worth -= 0.5 * (lost_square - lost * lost) / lost
            worth = floor(worth * units + 0.5)
            if worth > score[-1]:
                insert(worth, next_mark, 16 * slot + column, score, score_mark, score_origin)
            if not hope.size:
                continue
            brought = home_survival * (brought + (1.0 - lost) * home_term)
            lost = 1.0 - (1.0 - lost) * home_survival
            worth = brought + surprisal(lost) - left_open_home - loss_cost * lost
            worth = floor((worth + mean * home_mean * (spread + home_spread)) * units + 0.5)
            if worth > hope[-1]:
                insert(worth, next_mark, 16 * slot + column, hope, hope_mark, hope_origin)


@compiled
def merge(by_worth: Any, by_promise: Any, found: Any, found_mark: Any) -> int:
    """Write the origins and marks of the best, those that are both once; return how many."""
    kept = 0
    score, mark, origin = by_worth
    for slot in range(score.size):
        if score[slot] > -inf:
            found[kept], found_mark[kept] = origin[slot], mark[slot]
            kept += 1
    by_worth_only = kept
    score, mark, origin = by_promise
    for slot in range(score.size):
        if score[slot] == -inf or kept == found.size:
            break
        is_new = True
        for other in range(by_worth_only):
            is_new = is_new and found_mark[other] != mark[slot]
        if is_new:
            found[kept], found_mark[kept] = origin[slot], mark[slot]
            kept += 1
    return kept


@compiled
def write_home(labels: Any, row: int, gains: Any, objective: Any, home: Any) -> None:
    """Write the way home along a label, and by one step into the base, as in `find_best`."""
    factor, term = labels[0], labels[1]
    gain_factor, gain_term = gains
    weight, chance = objective[0], objective[1]
    powers = weight.size
    for k in range(powers):
        home[k] = weight[k] * factor[row, k] * gain_factor[0, 0, k]
    home[powers] = factor[row, 0] * gain_factor[0, 0, 0]
    home[powers + 2] = term[row, 0] + gain_term[0, 0, 0]
    home[powers + 1], home[powers + 3] = 0.0, 0.0
    for fate in range(chance.size):
        survival = factor[row, powers + fate] * gain_factor[0, 0, powers + fate]
        home[powers + 1] += chance[fate] * survival
        home[powers + 3] += chance[fate] * (term[row, 1 + fate] + gain_term[0, 0, 1 + fate])


@compiled
def search(
    neighbors: Any,
    within: Any,
    marks: Any,
    gains: Any,
    objective: Any,
    labels: Any,
    after: Any,
    by_promise: int,
    home: Any,
    is_home_known: bool,
    origins: Any,
    worths: Any,
) -> None:
    """
    Extend the best labels of each cell, step by step.

    Labels at the same cell after the same number of steps compete by their worth, and
    `by_promise` of their rows are for those that compete by the worth of their path and a good
    way home together, taken as if no cell were on both. Labels of equal visits count once.

    Paths are worth the same in both directions, so a way home is a label at a neighbour, walked
    backwards, and the step into the base. A search with one row for each cell can write those
    that it knows.

    Parameters
    ----------
    neighbors : ndarray of int, shape (cells, 9)
        Ranks of the cells one step away, -1 where there is none. Columns j and 8 - j lead into
        opposite directions.
    within : ndarray of int, shape (max_steps + 1,)
        How many cells labels may end in after so many steps.
    marks : ndarray of int, shape (cells,)
        Whose sums tell apart how often each cell was visited.
    gains, objective : tuple
        See above.
    labels, after : tuple
        Room for the labels of two steps.
    by_promise : int
        See above, less than `width`.
    home : ndarray, shape (sum of within, powers + 4)
        A way home of at most so many steps from each cell that it may start in, as in
        `find_best`, by steps and then cells; no rows if there is none to be known.
    is_home_known : bool
        Whether it is read, otherwise it is written.
    origins : ndarray of int, shape (sum of within * width,)
        The result, by steps, cells and rows: where each label comes from, as in `find_best`. What
        is no label stays as it was.
    worths : ndarray, shape (max_steps + 1, width)
        The result: what the labels at the base are worth, in units; -inf for none.

    """
    max_steps, cells = within.size - 1, neighbors.shape[0]
    powers = objective[0].size
    width = labels[2].size // labels[4].size
    # The label of a robot that stands at the base.
    labels[0][0], labels[1][0], labels[2][0], labels[3][0], labels[4][0] = 1.0, 0.0, 0, 0, 1
    best_worth = np.zeros(cells)
    room = width - by_promise
    by_worth = np.empty(room), np.empty(room, np.int64), np.empty(room, np.int64)
    room = width if by_promise else 0
    promising = np.empty(room), np.empty(room, np.int64), np.empty(room, np.int64)
    found, found_mark = np.empty(width, np.int64), np.empty(width, np.int64)
    around = np.empty(9, np.int64)
    # The label that was followed last: its rows and cells by steps, and its visits.
    trail, passed = np.full(max_steps + 1, -1), np.empty(max_steps + 1, np.int64)
    visits = np.zeros(cells, np.int64)
    no_home = np.zeros(powers + 4)
    start = np.zeros(max_steps + 2, np.int64)
    for step in range(max_steps + 1):
        start[step + 1] = start[step] + within[step]
    best_home = np.full(cells, -inf)
    if home.shape[0] and not is_home_known:
        # No steps left, and there.
        home[0, :powers] = objective[0]
        home[0, powers:] = 0.0
        home[0, powers] = home[0, powers + 1] = 1.0
        best_home[0] = 0.0

    for step in range(1, max_steps + 1):
        if home.shape[0] and not is_home_known:
            for rank in range(within[step]):
                via = -1
                for column in range(9):
                    origin = neighbors[rank, column]
                    if 0 <= origin < within[step - 1] and best_worth[origin] > best_home[rank]:
                        via, best_home[rank] = origin, best_worth[origin]
                if via >= 0:
                    write_home(labels, via, gains, objective, home[start[step] + rank])
                else:
                    # One of fewer steps is as good.
                    home[start[step] + rank] = home[start[step - 1] + rank]
        for rank in range(within[step]):
            for column in range(9):
                origin = neighbors[rank, column]
                around[column] = origin if origin < within[step - 1] else -1
            way_home = no_home
            if is_home_known:
                way_home = home[start[max_steps - step] + rank]
            find_best(rank, around, marks, gains, objective, labels, way_home, by_worth, promising)
            kept = merge(by_worth, promising, found, found_mark)
            after[4][rank] = kept
            best_worth[rank] = by_worth[0][0]
            for slot in range(kept):
                column = found[slot] & 15
                row = neighbors[rank, column] * width + (found[slot] >> 4)
                to = rank * width + slot
                before = labels[3][row, 8 - column]
                visit(
                    labels[0],
                    labels[1],
                    row,
                    gains[0],
                    gains[1],
                    rank,
                    before,
                    after[0],
                    after[1],
                    to,
                )
                after[2][to] = found_mark[slot]
                origins[start[step] * width + to] = found[slot]
                # Follow the label back to where it left the last one that was followed.
                cell, at, back = rank, to, step
                while back > 0 and trail[back] != at:
                    if trail[back] >= 0:
                        visits[passed[back]] -= 1
                    visits[cell] += 1
                    trail[back], passed[back] = at, cell
                    origin = origins[start[back] * width + at]
                    cell = neighbors[cell, origin & 15]
                    at = cell * width + (origin >> 4)
                    back -= 1
                for column in range(9):
                    if neighbors[rank, column] >= 0:
                        after[3][to, column] = visits[neighbors[rank, column]]
        labels, after = after, labels
        for slot in range(labels[4][0]):
            worths[step, slot] = label_worth(labels[0], labels[1], slot, *objective)


@compiled
def trace(neighbors: Any, within: Any, origins: Any, width: int, row: int, path: Any) -> None:
    """Write the path of a label, ranks of cells with the base first; its last cell is there."""
    steps = path.size - 1
    start = 0
    for step in range(steps):
        start += within[step]
    cell = path[steps]
    for step in range(steps, 0, -1):
        path[step] = cell
        origin = origins[start * width + row]
        cell = neighbors[cell, origin & 15]
        row = cell * width + (origin >> 4)
        start -= within[step - 1]
    path[0] = cell


@compiled
def most_visits(path: Any, visits: Any) -> int:
    """Return how often a path enters the cell that it enters most; `visits` is overwritten."""
    visits[:] = 0
    most = 0
    for step in range(1, path.size):
        visits[path[step]] += 1
        most = max(most, visits[path[step]])
    return most


@compiled
def leads_to(neighbors: Any, cell: int, other: int) -> bool:
    """Return whether one step leads from a cell to another."""
    leads = False
    for column in range(9):
        leads = leads or neighbors[cell, column] == other
    return leads


@compiled
def take(
    path: Any,
    first: int,
    last: int,
    gain_factor: Any,
    gain_term: Any,
    visits: Any,
    factor: Any,
    term: Any,
) -> None:
    """
    Write the label of a path without the steps between two of its places, and count its visits.

    Parameters
    ----------
    path : ndarray of int, shape (steps + 1,)
        Ranks of cells.
    first, last : int
        The two places.
    gain_factor, gain_term : ndarray
        See above.
    visits : ndarray of int, shape (cells,)
        How often it visits each cell.
    factor, term : ndarray
        The label is written into row 0.

    """
    visits[:] = 0
    factor[0] = 1.0
    term[0] = 0.0
    for step in range(1, path.size):
        if step <= first or step >= last:
            cell = path[step]
            visit(factor, term, 0, gain_factor, gain_term, cell, visits[cell], factor, term, 0)
            visits[cell] += 1


@compiled
def out_and_back(
    steps: int,
    neighbors: Any,
    within: Any,
    origins: Any,
    width: int,
    gains: Any,
    objective: Any,
    worths: Any,
) -> None:
    """
    Find what the paths are worth that lead to a cell by its best label and back the same way.

    Parameters
    ----------
    steps : int
        From the base to the cell.
    neighbors, within, origins, gains, objective
        As for `search`; no label has the origin -1.
    width : int
        How many labels each cell may have.
    worths : ndarray, shape (within[steps],)
        The result for each cell, in units; those that have no such path are left as they are.

    """
    weight, chance, loss_cost, units = objective
    visits = np.zeros(neighbors.shape[0], np.int64)
    factor, term = np.empty((1, gains[0].shape[2])), np.empty((1, gains[1].shape[2]))
    path = np.empty(2 * steps + 1, np.int64)
    start = 0
    for step in range(steps):
        start += within[step]
    for cell in range(within[steps]):
        if origins[(start + cell) * width] < 0:
            continue
        path[steps] = cell
        trace(neighbors, within, origins, width, cell * width, path[: steps + 1])
        for step in range(steps):
            path[2 * steps - step] = path[step]
        if most_visits(path, visits) <= gains[0].shape[1]:
            take(path, 0, 0, gains[0], gains[1], visits, factor, term)
            worths[cell] = label_worth(factor, term, 0, weight, chance, loss_cost, units)


@compiled
def improve(
    path: Any, steps: int, neighbors: Any, gains: Any, objective: Any, most_between: int
) -> int:
    """
    Exchange stretches of a closed path for better ones while there are any.

    A stretch of up to `most_between` cells is exchanged for the best of up to so many: all else
    stays, so its worth is that of the whole path.

    Parameters
    ----------
    path : ndarray of int, shape (max_steps + 1,)
        Ranks of the cells, the first steps + 1 of them; it is changed.
    steps : int
        Of the path.
    neighbors, gains, objective
        As for `search`.
    most_between : int
        See above.

    Returns
    -------
    int
        The steps it has now.

    """
    gain_factor, gain_term = gains
    weight, chance, loss_cost, units = objective
    max_visits = gain_factor.shape[1]
    visits = np.zeros(neighbors.shape[0], np.int64)
    factor = np.empty((most_between + 1, gain_factor.shape[2]))
    term = np.empty((most_between + 1, gain_term.shape[2]))
    stretch, best = np.empty(most_between + 1, np.int64), np.empty(most_between + 1, np.int64)
    column = np.empty(most_between + 1, np.int64)
    take(path[: steps + 1], 0, 0, gain_factor, gain_term, visits, factor, term)
    best_worth = label_worth(factor, term, 0, weight, chance, loss_cost, units)
    # Places since the last exchange, up to all of them.
    first, unchanged = 0, 0
    while unchanged < steps:
        found, last = -1, first
        while found < 0 and last < min(first + most_between + 1, steps):
            last += 1
            between = last - first - 1
            take(path[: steps + 1], first, last, gain_factor, gain_term, visits, factor, term)
            most = min(most_between, path.size - 1 - steps + between)
            # Depth first through all stretches; row `depth` is the label with so many cells.
            depth, stretch[0], column[0] = 0, path[first], 0
            while depth >= 0:
                cell = stretch[depth]
                if column[depth] == 0 and leads_to(neighbors, cell, path[last]):
                    worth = label_worth(factor, term, depth, weight, chance, loss_cost, units)
                    if worth > best_worth:
                        best_worth, found = worth, depth
                        best[: depth + 1] = stretch[: depth + 1]
                if column[depth] == 9 or depth == most:
                    if depth > 0:
                        visits[cell] -= 1
                    depth -= 1
                    continue
                there = neighbors[cell, column[depth]]
                column[depth] += 1
                if there < 0 or visits[there] >= max_visits:
                    continue
                if depth + 1 < most or leads_to(neighbors, there, path[last]):
                    before = visits[there]
                    visit(
                        factor,
                        term,
                        depth,
                        gain_factor,
                        gain_term,
                        there,
                        before,
                        factor,
                        term,
                        depth + 1,
                    )
                    visits[there] += 1
                    depth += 1
                    stretch[depth], column[depth] = there, 0
        if found >= 0:
            stop = steps + 1
            rest = path[last:stop].copy()
            for k in range(1, found + 1):
                path[first + k] = best[k]
            for k in range(rest.size):
                path[first + found + 1 + k] = rest[k]
            steps += found - between
            unchanged = 0
        else:
            first, unchanged = (first + 1) % steps, unchanged + 1
    return steps
