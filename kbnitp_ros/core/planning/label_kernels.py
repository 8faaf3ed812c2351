# SPDX-License-Identifier: Apache-2.0
r"""
Kernels of the label search: the best partial paths to each cell are extended, step by step.

Cells are numbered by rank: by their distance from the base, which has rank 0. A label is a path
from the base; the cells that it can end in after a number of steps have the first ranks. A label
carries products and sums, which each visit extends by a factor or a term:

.. math::

    E[p^{a_j}], \; P_\omega \qquad \text{and} \qquad
    \frac{E[p \ln p]}{E[p]}, \; J_\omega - \ln P_\omega,

with the chance p to survive the path given the hazards, :math:`a_0 = 1`, and for each joint
outcome :math:`\omega` of robots sent before, the survival :math:`P_\omega` and the information of
readings :math:`J_\omega`. The value of a label is equation :eq:`label-value`.
"""

from __future__ import annotations

from math import floor, inf, log
from typing import NamedTuple

from kbnitp_ros.core.field.check import Floats, Places
from kbnitp_ros.core.field.compiled import compiled, inlined
import numpy as np
from numpy.typing import NDArray


class Reach(NamedTuple):
    """The cells from which a robot can still return."""

    # Cells by distance from the base, then by number; a cell's index is its rank; shape (n,).
    cells: Places
    # Ranks of neighbours, -1 for none; columns j and 8 - j are opposite directions; shape (n, 9).
    neighbors: Places
    # Number of cells that a robot can be in after each number of steps, shape (max_steps + 1,).
    within: Places
    # Index of each step's first cell in arrays by step and cell, and at the end their size, shape
    # (max_steps + 2,).
    start: Places
    # Metres of a step to each column of `neighbors`, shape (9,); 0 if lengths are not limited.
    length: Floats
    # Metres of the shortest path home from each cell, shape (n,); 0 if lengths are not limited.
    home: Floats
    # Maximum length of a path, metres; 0 if not limited.
    longest: float


class Gains(NamedTuple):
    """Factors and terms of the next visit, by cell and number of visits before."""

    # Ratios, after to before the visit, of the moments E[p^a], then of the survival in each
    # outcome.
    factor: Floats
    # Change of E[p ln p] / E[p]; then, for each outcome, change of the information of readings
    # minus log survival; nats, shape (cells, max_visits, 1 + outcomes).
    term: Floats


class LabelProblem(NamedTuple):
    """A label search: the cells, the gains of visits, and the weights in the value of a label."""

    reach: Reach
    # Random hash of each cell, shape (cells,): the sum over visits identifies the visits.
    marks: NDArray[np.int64]
    gains: Gains
    # Weight of each moment, shape (powers,).
    weight: Floats
    # Probability of each joint outcome of the robots sent before, shape (outcomes,).
    chance: Floats
    # Cost of a lost robot, nats.
    loss_cost: float
    # Units in a nat: values are rounded to units, so that rounding errors never decide.
    units: float
    # Upper bound of the information of readings in the remaining steps, nats, shape (max_steps +
    # 1,).
    unread: Floats


class Labels(NamedTuple):
    """The labels of one step. Each cell has `width` rows; its first `kept` rows are in use."""

    # Moments, then survivals by outcome: products of `Gains.factor`, (rows, powers + outcomes).
    factor: Floats
    # Sums of `Gains.term`, shape (rows, 1 + outcomes).
    term: Floats
    # Sum of the cells' hashes over a label's visits, shape (rows,).
    mark: NDArray[np.int64]
    # Length of each label, metres, as in `Reach.length`, shape (rows,).
    length: Floats
    # Number of visits of each label to the neighbours of its cell, shape (rows, 9).
    seen: NDArray[np.int32]
    # Number of labels of each cell, shape (cells,).
    kept: NDArray[np.int64]


class Ranking(NamedTuple):
    """The best extensions of labels to a cell, the best first."""

    # Value in units, -inf for an empty place, shape (places,).
    score: Floats
    # Hash of the label's visits, shape (places,).
    mark: NDArray[np.int64]
    # Length of the label, metres, shape (places,); 0 if lengths are not limited.
    length: Floats
    # 16 * slot of the extended label + column of its cell in `Reach.neighbors`, shape (places,).
    origin: NDArray[np.int64]


@compiled
def surprisal(p: float) -> float:
    """Return -p ln p."""
    return -p * log(p) if p > 0.0 else 0.0


@inlined
def averaged_value(brought: float, lost: float, lost_square: float, loss_cost: float) -> float:
    """Return a value without its last two terms (:eq:`label-value`, :eq:`loss-surprisal`)."""
    value = brought + surprisal(lost) - loss_cost * lost
    if lost > 0.0:
        value -= 0.5 * (lost_square - lost * lost) / lost
    return value


@inlined
def hoped_value(
    brought: float, lost: float, likeliest: float, loss_cost: float, unread: float
) -> float:
    """Return an upper bound on the value of paths that start with a label (:eq:`hopeless`)."""
    if likeliest > 0.5:
        return inf
    return brought + surprisal(lost) - loss_cost * lost + (1.0 - lost) * unread


@compiled
def label_value(labels: Labels, row: int, problem: LabelProblem) -> float:
    """Return the value of a label (:eq:`label-value`, :eq:`entropy-powers`, :eq:`moment-log`)."""
    factor, term = labels.factor, labels.term
    weight, chance = problem.weight, problem.chance
    left_open = -factor[row, 0] * term[row, 0]
    for k in range(weight.size):
        left_open += weight[k] * factor[row, k]
    lost, lost_square, brought = 0.0, 0.0, 0.0
    for outcome in range(chance.size):
        survival = factor[row, weight.size + outcome]
        loss = chance[outcome] * (1.0 - survival)
        lost += loss
        lost_square += loss * (1.0 - survival)
        brought += chance[outcome] * survival * term[row, 1 + outcome]
    value: float = averaged_value(brought, lost, lost_square, problem.loss_cost) - left_open
    return floor(value * problem.units + 0.5)


@inlined
def visit(
    labels: Labels, row: int, gains: Gains, rank: int, before: int, to: Labels, to_row: int
) -> None:
    """Write a label extended by a visit to a cell (:eq:`moment-power`, :eq:`moment-log`)."""
    for k in range(to.factor.shape[1]):
        to.factor[to_row, k] = labels.factor[row, k] * gains.factor[rank, before, k]
    for k in range(to.term.shape[1]):
        to.term[to_row, k] = labels.term[row, k] + gains.term[rank, before, k]


@compiled
def new_labels(cells: int, width: int, gains: Gains) -> Labels:
    """Return empty arrays for the labels of one step."""
    rows = cells * width
    return Labels(
        np.empty((rows, gains.factor.shape[2])),
        np.empty((rows, gains.term.shape[2])),
        np.zeros(rows, np.int64),
        np.zeros(rows),
        np.zeros((rows, 9), np.int32),
        np.zeros(cells, np.int64),
    )


@compiled
def new_ranking(places: int) -> Ranking:
    """Return an empty ranking of `places` extensions."""
    marks, origins = np.empty(places, np.int64), np.empty(places, np.int64)
    return Ranking(np.empty(places), marks, np.empty(places), origins)


@inlined
def insert(score: float, mark: int, length: float, origin: int, best: Ranking) -> None:
    """Rank a candidate; of candidates with equal score and hash only the shortest is kept."""
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
            if length < lengths[twin]:
                lengths[twin], origins[twin] = length, origin
            return
        twin -= 1
    if low == scores.size:
        return
    for slot in range(scores.size - 1, low, -1):
        scores[slot] = scores[slot - 1]
        marks[slot] = marks[slot - 1]
        lengths[slot] = lengths[slot - 1]
        origins[slot] = origins[slot - 1]
    scores[low], marks[low], lengths[low], origins[low] = score, mark, length, origin


@compiled
def fitting(length: float, rank: int, left: int, reach: Reach, completions: Floats) -> int:
    """Return the row of the completion of the most steps, up to `left`, within a length; or -1."""
    while left >= 0 and rank < reach.within[left]:
        row: int = reach.start[left] + rank
        if completions[row, -1] <= length:
            return row
        left -= 1
    return -1


@inlined
def find_best(
    problem: LabelProblem,
    labels: Labels,
    step: int,
    rank: int,
    least: float,
    completions: Floats,
    by_value: Ranking,
    by_heuristic: Ranking,
) -> None:
    """Find the best extensions of labels to a cell (:eq:`heuristic`, :eq:`hopeless`)."""
    reach, marks, gains = problem.reach, problem.marks, problem.gains
    gain_factor, gain_term = gains.factor, gains.term
    weight, chance = problem.weight, problem.chance
    loss_cost, units, unread = problem.loss_cost, problem.units, problem.unread[step]
    factor, term = labels.factor, labels.term
    mark, seen, kept = labels.mark, labels.seen, labels.kept
    score, heuristic = by_value.score, by_heuristic.score
    powers, max_visits = weight.size, gain_factor.shape[1]
    width = mark.size // kept.size
    for slot in range(score.size):
        score[slot] = -inf
    for slot in range(heuristic.size):
        heuristic[slot] = -inf
    is_limited = reach.longest > 0.0
    length, touches, tangent = 0.0, 0.0, inf
    left = reach.within.size - 1 - step
    end = reach.start[left] + rank
    for column in range(9):
        origin = reach.neighbors[rank, column]
        if origin < 0 or origin >= reach.within[step - 1]:
            continue
        for slot in range(kept[origin]):
            row = origin * width + slot
            before = seen[row, 8 - column]
            # No closed path goes on from the base after its last visit.
            if before >= max_visits or (origin == 0 and seen[row, 4] >= max_visits):
                continue
            if is_limited:
                length = labels.length[row] + reach.length[column]
                allowed = reach.longest - length
                if reach.home[rank] > allowed:
                    continue
                if heuristic.size:
                    end = fitting(allowed, rank, left, reach, completions)
            is_completed = heuristic.size > 0 and end >= 0
            lost, lost_square, brought, likeliest = 0.0, 0.0, 0.0, 0.0
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
                likeliest = max(likeliest, survival)
            if least > -inf and least > units * hoped_value(
                brought, lost, likeliest, loss_cost, unread
            ):
                continue
            left_open, left_open_completed = 0.0, 0.0
            if is_completed:
                for k in range(powers):
                    moment = factor[row, k] * gain_factor[rank, before, k]
                    left_open += weight[k] * moment
                    left_open_completed += completions[end, k] * moment
            else:
                for k in range(powers):
                    left_open += weight[k] * (factor[row, k] * gain_factor[rank, before, k])
            next_mark = mark[row] + marks[rank]
            mean = factor[row, 0] * gain_factor[rank, before, 0]
            spread = term[row, 0] + gain_term[rank, before, 0]
            left_open -= mean * spread
            # A tangent of -p ln p excludes most labels without a logarithm; NaN and inf exclude
            # none.
            above = brought + lost * tangent + touches - loss_cost * lost - left_open
            if not above * units < score[-1] - 1.0:
                value = averaged_value(brought, lost, lost_square, loss_cost)
                value = floor((value - left_open) * units + 0.5)
                # A duplicate of the last entry may be shorter.
                if value > score[-1] or (is_limited and value == score[-1]):
                    insert(value, next_mark, length, 16 * slot + column, by_value)
                    touches = lost
                    tangent = -log(lost) - 1.0 if lost > 0.0 else inf
            if not is_completed:
                continue
            survival = completions[end, powers + 1]
            brought = survival * (brought + (1.0 - lost) * completions[end, powers + 3])
            lost = 1.0 - (1.0 - lost) * survival
            value = brought + surprisal(lost) - left_open_completed - loss_cost * lost
            mean *= completions[end, powers]
            spread += completions[end, powers + 2]
            value = floor((value + mean * spread) * units + 0.5)
            if value > heuristic[-1] or (is_limited and value == heuristic[-1]):
                insert(value, next_mark, length, 16 * slot + column, by_heuristic)


@inlined
def merge(
    by_value: Ranking,
    by_heuristic: Ranking,
    found: NDArray[np.int64],
    found_mark: NDArray[np.int64],
) -> int:
    """Merge two rankings without duplicates: write origins and hashes, return their number."""
    kept = 0
    for ranking in (by_value, by_heuristic):
        before = kept
        for slot in range(ranking.score.size):
            if ranking.score[slot] == -inf or kept == found.size:
                break
            is_new = True
            for other in range(before):
                is_new = is_new and found_mark[other] != ranking.mark[slot]
            if is_new:
                found[kept], found_mark[kept] = ranking.origin[slot], ranking.mark[slot]
                kept += 1
    return kept


@compiled
def write_completions(
    problem: LabelProblem,
    labels: Labels,
    step: int,
    best_value: Floats,
    value: Floats,
    completions: Floats,
) -> None:
    """Write the best completion of at most `step` steps from each cell, and its value."""
    reach, weight, chance = problem.reach, problem.weight, problem.chance
    factor, term = labels.factor, labels.term
    # Of the last visit, to the base.
    last_factor, last_term = problem.gains.factor[0, 0], problem.gains.term[0, 0]
    powers = weight.size
    for rank in range(reach.within[step]):
        to, via = reach.start[step] + rank, -1
        for column in range(9):
            origin = reach.neighbors[rank, column]
            if 0 <= origin < reach.within[step - 1] and best_value[origin] > value[rank]:
                via, value[rank] = origin, best_value[origin]
                completions[to, powers + 4] = labels.length[origin] + reach.length[column]
        if via < 0:
            # The best completion has fewer steps.
            completions[to] = completions[reach.start[step - 1] + rank]
            continue
        for k in range(powers):
            completions[to, k] = weight[k] * factor[via, k] * last_factor[k]
        completions[to, powers] = factor[via, 0] * last_factor[0]
        completions[to, powers + 1] = 0.0
        completions[to, powers + 2] = term[via, 0] + last_term[0]
        completions[to, powers + 3] = 0.0
        for outcome in range(chance.size):
            survival = factor[via, powers + outcome] * last_factor[powers + outcome]
            completions[to, powers + 1] += chance[outcome] * survival
            readings = term[via, 1 + outcome] + last_term[1 + outcome]
            completions[to, powers + 3] += chance[outcome] * readings


@inlined
def follow(
    reach: Reach,
    traced: NDArray[np.int64],
    visits: NDArray[np.int64],
    origins: NDArray[np.int32],
    step: int,
    rank: int,
    slot: int,
) -> None:
    """Trace a label back to where it branches off the last label traced; update visit counts."""
    while step > 0 and (traced[step, 0] != slot or traced[step, 1] != rank):
        if traced[step, 0] >= 0:
            visits[traced[step, 1]] -= 1
        visits[rank] += 1
        traced[step, 0], traced[step, 1] = slot, rank
        origin = origins[reach.start[step] + rank, slot]
        rank, slot = reach.neighbors[rank, origin & 15], origin >> 4
        step -= 1


@compiled
def search(
    problem: LabelProblem, width: int, least: float, completions: Floats
) -> tuple[NDArray[np.int32], Floats]:
    """
    Extend the best labels of each cell, step by step (:eq:`label-value`, :eq:`heuristic`).

    A search of width 1 writes the completions, if they have rows; a wider search reads them. A
    completion has the moments times their weights, E[p], P0, the terms of E[p] and of P0, and the
    length, shape (powers + 5,); its row is that of its steps and cell.
    """
    reach, gains = problem.reach, problem.gains
    within, neighbors = reach.within, reach.neighbors
    max_steps, cells, powers = within.size - 1, neighbors.shape[0], problem.weight.size
    origins = np.full((reach.start[-1], width), -1, np.int32)
    values = np.full((max_steps + 1, width), -inf)
    labels, after = new_labels(within.max(), width, gains), new_labels(within.max(), width, gains)
    # Label of no steps, at the base.
    labels.factor[0], labels.term[0], labels.kept[0] = 1.0, 0.0, 1
    by_value = new_ranking(width - width // 2)
    by_heuristic = new_ranking(width if width > 1 else 0)
    found, found_mark = np.empty(width, np.int64), np.empty(width, np.int64)
    # Of the last label traced: slot (-1 for none) and cell at each step, and visits by cell.
    traced, visits = np.full((max_steps + 1, 2), -1), np.zeros(cells, np.int64)
    # Value of the best label and of the best completion of each cell, in units.
    best_value, completed_value = np.zeros(cells), np.full(cells, -inf)
    writes_completions = completions.shape[0] > 0 and width == 1
    if writes_completions:
        # Completion of no steps, at the base.
        completions[0, :powers] = problem.weight
        completions[0, powers:] = 0.0
        completions[0, powers] = completions[0, powers + 1] = 1.0
        completed_value[0] = 0.0

    for step in range(1, max_steps + 1):
        if writes_completions:
            write_completions(problem, labels, step, best_value, completed_value, completions)
        for rank in range(within[step]):
            find_best(problem, labels, step, rank, least, completions, by_value, by_heuristic)
            after.kept[rank] = merge(by_value, by_heuristic, found, found_mark)
            best_value[rank] = by_value.score[0]
            for slot in range(after.kept[rank]):
                column = found[slot] & 15
                row, to = neighbors[rank, column] * width + (found[slot] >> 4), rank * width + slot
                before = labels.seen[row, 8 - column]
                visit(labels, row, gains, rank, before, after, to)
                after.mark[to] = found_mark[slot]
                after.length[to] = labels.length[row] + reach.length[column]
                origins[reach.start[step] + rank, slot] = found[slot]
                follow(reach, traced, visits, origins, step, rank, slot)
                for column in range(9):
                    if neighbors[rank, column] >= 0:
                        after.seen[to, column] = visits[neighbors[rank, column]]
        labels, after = after, labels
        for slot in range(labels.kept[0]):
            values[step, slot] = label_value(labels, slot, problem)
            # A wider search is given the value of the best path of width 1.
            if width == 1:
                least = max(least, values[step, slot] - 1.0)
    return origins, values


@compiled
def trace_closed(
    reach: Reach, origins: NDArray[np.int32], steps: Places, slots: Places, paths: Places
) -> None:
    """Write the paths of labels that end at the base: row k of `paths` has steps[k] + 1 ranks."""
    for k in range(steps.size):
        cell, slot = 0, slots[k]
        for step in range(steps[k], 0, -1):
            paths[k, step] = cell
            origin = origins[reach.start[step] + cell, slot]
            cell, slot = reach.neighbors[cell, origin & 15], origin >> 4
        paths[k, 0] = cell
