# SPDX-License-Identifier: Apache-2.0
"""Loops of the label search: the best labels of each cell are extended, step by step."""

from __future__ import annotations

from math import floor, inf
from typing import NamedTuple

from kbnitp_ros.core.field import compiled, inlined
from kbnitp_ros.core.planning.search.label_kernels import (
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
from numpy.typing import NDArray


class Labels(NamedTuple):
    """
    The labels of one step; those at a cell have the first `kept` of its `width` rows.

    Attributes
    ----------
    products : Products
        Of each row.
    mark : ndarray of int, shape (rows,)
        Equal for equal visits.
    length : ndarray, shape (rows,)
        Metres, as of `Reach.length`.
    seen : ndarray of int, shape (rows, 9)
        The visits to the cells around.
    kept : ndarray of int, shape (cells,)
        How many labels each cell has.

    """

    products: Products
    mark: NDArray[np.int64]
    length: Floats
    seen: NDArray[np.int32]
    kept: NDArray[np.int64]


class Ranking(NamedTuple):
    """
    The best extensions of labels to a cell, the best first.

    Attributes
    ----------
    score : ndarray, shape (places,)
        In units; -inf for none.
    mark : ndarray of int, shape (places,)
        Of the label.
    length : ndarray, shape (places,)
        Of the label, metres; no places where paths may be of any length.
    origin : ndarray of int, shape (places,)
        16 * slot + column of `Reach.neighbors`, of the label that is extended.

    """

    score: Floats
    mark: NDArray[np.int64]
    length: Floats
    origin: NDArray[np.int64]


class Best(NamedTuple):
    """
    The best extensions of labels to a cell.

    Attributes
    ----------
    by_value, by_heuristic : Ranking
        By their value, and by their value with a completion; the latter may have no places.

    """

    by_value: Ranking
    by_heuristic: Ranking


class Completions(NamedTuple):
    """
    The best completion of so many steps at most from each cell that it may start in.

    Attributes
    ----------
    moments : ndarray, shape (sum of within, powers + 5)
        By steps and then cells: the moments of each times their weights, E[p], P0, the terms of
        both, and its length.
    value : ndarray, shape (cells,)
        Of the label that the last completion of each cell was made of.
    room : ndarray, shape (powers + 5,)
        For one of them, where lengths are limited: that which is short enough for a label.

    """

    moments: Floats
    value: Floats
    room: Floats


class Trail(NamedTuple):
    """
    The label that was followed back last.

    Attributes
    ----------
    slot, cell : ndarray of int, shape (max_steps + 1,)
        By steps; a slot of -1 is none.
    visits : ndarray of int, shape (cells,)
        To each cell.

    """

    slot: NDArray[np.int64]
    cell: NDArray[np.int64]
    visits: NDArray[np.int64]


@compiled
def insert(score: float, mark: int, length: float, origin: int, best: Ranking) -> None:
    """
    Put a candidate among the best, the best first, unless one of them has its mark.

    It must be as good as the last of them; of equal ones the earlier is the better. Those of
    equal marks have equal scores, and of these the shorter is kept: what may follow it is all that
    may follow the longer one.
    """
    scores, marks, lengths, origins = best.score, best.mark, best.length, best.origin
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
            if lengths.size and length < lengths[twin]:
                lengths[twin], origins[twin] = length, origin
            return
        twin -= 1
    if low == scores.size:
        return
    for slot in range(scores.size - 1, low, -1):
        scores[slot] = scores[slot - 1]
        marks[slot] = marks[slot - 1]
        origins[slot] = origins[slot - 1]
    scores[low], marks[low], origins[low] = score, mark, origin
    if lengths.size:
        for slot in range(lengths.size - 1, low, -1):
            lengths[slot] = lengths[slot - 1]
        lengths[low] = length


@compiled
def copy_fitting(
    length: float, rank: int, left: int, reach: Reach, completions: Completions
) -> bool:
    """
    Copy the completion of most steps from a cell, at most `left`, that is no longer than this.

    Return whether there is one.
    """
    while left >= 0 and rank < reach.within[left]:
        place = reach.start[left] + rank
        if completions.moments[place, -1] <= length:
            completions.room[:] = completions.moments[place]
            return True
        left -= 1
    return False


@inlined
def find_best(
    problem: LabelProblem,
    labels: Labels,
    step: int,
    rank: int,
    completions: Completions,
    best: Best,
) -> None:
    """
    Find the best ways to extend labels to a cell.

    Labels are compared by `label_value`, and by the same with a completion, whose moments multiply
    (equation :eq:`heuristic`). Labels are left out on which the robot could not come home within
    the length allowed.

    Parameters
    ----------
    problem : LabelProblem
        Of the search.
    labels : Labels
        Those of the step before.
    step, rank : int
        How many steps lead to the cell, and the cell.
    completions : Completions
        To value labels with.
    best : Best
        The result.

    """
    reach, marks, objective = problem.reach, problem.marks, problem.objective
    gain_factor, gain_term = problem.gains.factor, problem.gains.term
    weight, chance = objective.weight, objective.chance
    loss_cost, units = objective.loss_cost, objective.units
    factor, term = labels.products.factor, labels.products.term
    mark, seen, kept = labels.mark, labels.seen, labels.kept
    by_value, by_heuristic = best.by_value, best.by_heuristic
    score, heuristic = by_value.score, by_heuristic.score
    powers, max_visits = weight.size, gain_factor.shape[1]
    width = mark.size // kept.size
    for slot in range(score.size):
        score[slot] = -inf
    for slot in range(heuristic.size):
        heuristic[slot] = -inf
    is_limited = reach.longest > 0.0
    length, fits = 0.0, True
    left = reach.within.size - 1 - step
    completion = completions.room
    if heuristic.size and not is_limited:
        completion = completions.moments[reach.start[left] + rank]
    for column in range(9):
        origin = reach.neighbors[rank, column]
        if origin < 0 or origin >= reach.within[step - 1]:
            continue
        for slot in range(kept[origin]):
            row = origin * width + slot
            before = seen[row, 8 - column]
            if before >= max_visits:
                continue
            if is_limited:
                length = labels.length[row] + reach.length[column]
                allowed = reach.longest - length
                if reach.home[rank] > allowed:
                    continue
                if heuristic.size:
                    fits = copy_fitting(allowed, rank, left, reach, completions)
            left_open, left_open_completed = 0.0, 0.0
            for k in range(powers):
                moment = factor[row, k] * gain_factor[rank, before, k]
                left_open += weight[k] * moment
                left_open_completed += completion[k] * moment
            lost, lost_square, brought = 0.0, 0.0, 0.0
            for outcome in range(chance.size):
                survival = (
                    factor[row, powers + outcome] * gain_factor[rank, before, powers + outcome]
                )
                loss = chance[outcome] * (1.0 - survival)
                lost += loss
                lost_square += loss * (1.0 - survival)
                brought += (
                    chance[outcome]
                    * survival
                    * (term[row, 1 + outcome] + gain_term[rank, before, 1 + outcome])
                )
            mean = factor[row, 0] * gain_factor[rank, before, 0]
            spread = term[row, 0] + gain_term[rank, before, 0]
            next_mark = mark[row] + marks[rank]

            value = averaged_value(brought, lost, lost_square, loss_cost)
            value = floor((value - (left_open - mean * spread)) * units + 0.5)
            # A twin of the last may be shorter.
            if value > score[-1] or (is_limited and value == score[-1]):
                insert(value, next_mark, length, 16 * slot + column, by_value)
            if not heuristic.size or not fits:
                continue
            completed_survival = completion[powers + 1]
            completed_term = completion[powers + 3]
            brought = completed_survival * (brought + (1.0 - lost) * completed_term)
            lost = 1.0 - (1.0 - lost) * completed_survival
            value = brought + surprisal(lost) - left_open_completed - loss_cost * lost
            mean *= completion[powers]
            spread += completion[powers + 2]
            value = floor((value + mean * spread) * units + 0.5)
            if value > heuristic[-1] or (is_limited and value == heuristic[-1]):
                insert(value, next_mark, length, 16 * slot + column, by_heuristic)


@compiled
def merge(best: Best, found: NDArray[np.int64], found_mark: NDArray[np.int64]) -> int:
    """Write the origins and marks of the best, those that are both once; return how many."""
    kept = 0
    by_value, by_heuristic = best.by_value, best.by_heuristic
    for slot in range(by_value.score.size):
        if by_value.score[slot] > -inf:
            found[kept], found_mark[kept] = by_value.origin[slot], by_value.mark[slot]
            kept += 1
    by_value_only = kept
    for slot in range(by_heuristic.score.size):
        if by_heuristic.score[slot] == -inf or kept == found.size:
            break
        is_new = True
        for other in range(by_value_only):
            is_new = is_new and found_mark[other] != by_heuristic.mark[slot]
        if is_new:
            found[kept], found_mark[kept] = by_heuristic.origin[slot], by_heuristic.mark[slot]
            kept += 1
    return kept


@compiled
def write_completion(
    labels: Labels, row: int, length: float, problem: LabelProblem, completion: Floats
) -> None:
    """Write the completion along a label, and by one step, as in `find_best`; its length."""
    factor, term = labels.products.factor, labels.products.term
    gain_factor, gain_term = problem.gains.factor, problem.gains.term
    weight, chance = problem.objective.weight, problem.objective.chance
    powers = weight.size
    for k in range(powers):
        completion[k] = weight[k] * factor[row, k] * gain_factor[0, 0, k]
    completion[powers] = factor[row, 0] * gain_factor[0, 0, 0]
    completion[powers + 2] = term[row, 0] + gain_term[0, 0, 0]
    completion[powers + 4] = length
    completion[powers + 1], completion[powers + 3] = 0.0, 0.0
    for outcome in range(chance.size):
        survival = factor[row, powers + outcome] * gain_factor[0, 0, powers + outcome]
        completion[powers + 1] += chance[outcome] * survival
        completion[powers + 3] += chance[outcome] * (
            term[row, 1 + outcome] + gain_term[0, 0, 1 + outcome]
        )


@compiled
def write_completions(
    problem: LabelProblem,
    labels: Labels,
    step: int,
    best_value: Floats,
    completions: Completions,
) -> None:
    """
    Write the best completion of so many steps at most from each cell that it may start in.

    A path has the same value in both directions, so a completion is a label at a neighbour, walked
    backwards, and the step into the base. `best_value`, (cells,), has that of the best label.
    """
    reach, moments, value = problem.reach, completions.moments, completions.value
    start = reach.start[step]
    for rank in range(reach.within[step]):
        via, length = -1, 0.0
        for column in range(9):
            origin = reach.neighbors[rank, column]
            if 0 <= origin < reach.within[step - 1] and best_value[origin] > value[rank]:
                via, value[rank] = origin, best_value[origin]
                length = labels.length[origin] + reach.length[column]
        if via >= 0:
            write_completion(labels, via, length, problem, moments[start + rank])
        else:
            # One of fewer steps is as good.
            moments[start + rank] = moments[reach.start[step - 1] + rank]


@compiled
def follow(
    reach: Reach, trail: Trail, origins: NDArray[np.int32], step: int, rank: int, slot: int
) -> None:
    """Follow a label back to where it left the last one that was followed; count its visits."""
    while step > 0 and (trail.slot[step] != slot or trail.cell[step] != rank):
        if trail.slot[step] >= 0:
            trail.visits[trail.cell[step]] -= 1
        trail.visits[rank] += 1
        trail.slot[step], trail.cell[step] = slot, rank
        origin = origins[reach.start[step] + rank, slot]
        rank, slot = reach.neighbors[rank, origin & 15], origin >> 4
        step -= 1


@compiled
def no_labels(cells: int, width: int, gains: Gains) -> Labels:
    """Return room for the labels of one step."""
    rows = cells * width
    return Labels(
        new_products(rows, gains),
        np.zeros(rows, np.int64),
        np.zeros(rows),
        np.zeros((rows, 9), np.int32),
        np.zeros(cells, np.int64),
    )


@compiled
def no_ranking(places: int, is_limited: bool) -> Ranking:
    """Return room for so many extensions."""
    lengths = np.empty(places if is_limited else 0)
    return Ranking(
        np.empty(places), np.empty(places, np.int64), lengths, np.empty(places, np.int64)
    )


@compiled
def search(
    problem: LabelProblem, width: int, by_heuristic: int, moments: Floats
) -> tuple[NDArray[np.int32], Floats]:
    r"""
    Extend the best labels of each cell, step by step.

    Labels at the same cell after the same number of steps compete by their value, and
    `by_heuristic` of their rows are for those that compete by their heuristic value: that of their
    path and a good completion together, taken as if no cell were on both. Labels of equal visits
    count once. With the value V of equation :eq:`label-value` and its heuristic H of
    :eq:`heuristic`, the labels at cell i after t steps are

    .. math::

        L_t(i) = \operatorname{best}_{V, H} \bigl\{ \ell \oplus i :
            \ell \in L_{t-1}(j), \; j \sim i \bigr\}, \qquad L_0 = \{ \text{base} \},

    where :math:`\ell \oplus i` is label :math:`\ell` after one more visit, to cell i (`visit`).

    Parameters
    ----------
    problem : LabelProblem
        What is searched for.
    width : int
        How many labels each cell may have.
    by_heuristic : int
        See above, less than `width`.
    moments : ndarray, shape (sum of within, powers + 5)
        Those of `Completions`. They are read if there are rows by heuristic, and otherwise
        written; no rows if there is none to be known.

    Returns
    -------
    origins : ndarray of int, shape (sum of within, width)
        By steps and then cells, and by rows: where each label comes from, as in `Ranking`; -1 for
        no label.
    values : ndarray, shape (max_steps + 1, width)
        Of the labels at the base, in units; -inf for none.

    """
    reach, gains, objective = problem.reach, problem.gains, problem.objective
    within, neighbors = reach.within, reach.neighbors
    max_steps, cells, powers = within.size - 1, neighbors.shape[0], objective.weight.size
    origins = np.full((reach.start[-1], width), -1, np.int32)
    values = np.full((max_steps + 1, width), -inf)
    labels, after = no_labels(within.max(), width, gains), no_labels(within.max(), width, gains)
    # The label of a robot that stands at the base.
    labels.products.factor[0], labels.products.term[0], labels.kept[0] = 1.0, 0.0, 1
    is_limited = reach.longest > 0.0
    best = Best(
        no_ranking(width - by_heuristic, is_limited),
        no_ranking(width if by_heuristic else 0, is_limited),
    )
    found, found_mark = np.empty(width, np.int64), np.empty(width, np.int64)
    steps = max_steps + 1
    trail = Trail(np.full(steps, -1), np.full(steps, -1), np.zeros(cells, np.int64))
    best_value = np.zeros(cells)
    completions = Completions(moments, np.full(cells, -inf), np.zeros(powers + 5))
    writes_completions = moments.shape[0] > 0 and by_heuristic == 0
    if writes_completions:
        # No steps left, and there.
        moments[0, :powers] = objective.weight
        moments[0, powers:] = 0.0
        moments[0, powers] = moments[0, powers + 1] = 1.0
        completions.value[0] = 0.0

    for step in range(1, max_steps + 1):
        if writes_completions:
            write_completions(problem, labels, step, best_value, completions)
        for rank in range(within[step]):
            find_best(problem, labels, step, rank, completions, best)
            after.kept[rank] = merge(best, found, found_mark)
            best_value[rank] = best.by_value.score[0]
            for slot in range(after.kept[rank]):
                column = found[slot] & 15
                row, to = neighbors[rank, column] * width + (found[slot] >> 4), rank * width + slot
                before = labels.seen[row, 8 - column]
                visit(labels.products, row, gains, rank, before, after.products, to)
                after.mark[to] = found_mark[slot]
                after.length[to] = labels.length[row] + reach.length[column]
                origins[reach.start[step] + rank, slot] = found[slot]
                follow(reach, trail, origins, step, rank, slot)
                for column in range(9):
                    if neighbors[rank, column] >= 0:
                        after.seen[to, column] = trail.visits[neighbors[rank, column]]
        labels, after = after, labels
        for slot in range(labels.kept[0]):
            values[step, slot] = label_value(labels.products, slot, objective)
    return origins, values


@compiled
def trace(reach: Reach, origins: NDArray[np.int32], slot: int, path: Places) -> None:
    """Write the path of a label, ranks of cells with the base first; its last cell is there."""
    steps = path.size - 1
    cell = path[steps]
    for step in range(steps, 0, -1):
        path[step] = cell
        origin = origins[reach.start[step] + cell, slot]
        cell, slot = reach.neighbors[cell, origin & 15], origin >> 4
    path[0] = cell


@compiled
def trace_closed(
    reach: Reach,
    origins: NDArray[np.int32],
    steps: Places,
    slots: Places,
    paths: NDArray[np.intp],
) -> None:
    """
    Write the paths of labels at the base: row k of `paths` has steps[k] + 1 ranks.

    One call for all: to hand over `reach` takes longer than to trace a path.
    """
    for k in range(steps.size):
        paths[k, steps[k]] = 0
        trace(reach, origins, slots[k], paths[k, : steps[k] + 1])
