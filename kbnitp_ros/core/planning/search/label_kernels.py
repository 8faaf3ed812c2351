# SPDX-License-Identifier: Apache-2.0
r"""
Loops of the label search.

Cells go by their rank in the order of their distance from the base, which has rank 0, so those
that a label may end in after some number of steps are the first so many. A label is a path from
the base to such a cell. It carries numbers that a visit multiplies and numbers that it adds to:

.. math::

    E[p^{a_j}], \; P_\omega \qquad \text{and} \qquad
    \frac{E[p \ln p]}{E[p]}, \; J_\omega - \ln P_\omega,

with the chance p to survive the path given the hazards, :math:`a_0 = 1`, and for each joint
outcome :math:`\omega` of the robots before, the survival :math:`P_\omega` and the information of
readings :math:`J_\omega`. Its value is that of equation :eq:`label-value`.
"""

from __future__ import annotations

from math import floor, inf, log
from typing import NamedTuple

from kbnitp_ros.core.field import compiled
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Places = NDArray[np.intp]


class Reach(NamedTuple):
    """
    The cells from which a robot can still return.

    Attributes
    ----------
    cells : ndarray of int, shape (n,)
        By their distance from the base, which comes first, and then ascending; the place of a
        cell is its rank.
    neighbors : ndarray of int, shape (n, 9)
        Ranks of the cells one step away, -1 where there is none. Columns j and 8 - j lead into
        opposite directions.
    within : ndarray of int, shape (max_steps + 1,)
        After so many steps the robot is in one of the first so many cells.
    start : ndarray of int, shape (max_steps + 2,)
        Where the cells of each step begin in what goes by steps and then cells; then its length.
    length : ndarray, shape (9,)
        Metres of a step by each column of `neighbors`; all 0 where paths may be of any length.
    home : ndarray, shape (n,)
        Metres of the shortest way home from each cell, or 0 likewise.
    longest : float
        Metres that a path may have, or 0 likewise.

    """

    cells: Places
    neighbors: Places
    within: Places
    start: Places
    length: Floats
    home: Floats
    longest: float


class Gains(NamedTuple):
    """
    What the next visit multiplies, and what it adds to, by cell and the number of visits before.

    Attributes
    ----------
    factor : ndarray, shape (cells, max_visits, powers + outcomes)
        The moment E[p^a] after it over that before it for each exponent a; then the same of the
        survival in each outcome. 0 where nobody survives.
    term : ndarray, shape (cells, max_visits, 1 + outcomes)
        The change of E[p ln p] / E[p]; then in each outcome that of the information of readings,
        nats, less that of the log of the survival.

    """

    factor: Floats
    term: Floats


class LabelObjective(NamedTuple):
    """
    What makes the value of a label of its factors and terms.

    Attributes
    ----------
    weight : ndarray, shape (powers,)
        Of each moment.
    chance : ndarray, shape (outcomes,)
        Of each joint outcome of the robots before.
    loss_cost : float
        Nats.
    units : float
        To the nat; values are compared in these, so that rounding never decides for a path.

    """

    weight: Floats
    chance: Floats
    loss_cost: float
    units: float


class Products(NamedTuple):
    """
    The factors and the terms of labels.

    Attributes
    ----------
    factor : ndarray, shape (rows, powers + outcomes)
        The moments; then the survival in each outcome.
    term : ndarray, shape (rows, 1 + outcomes)
        The sums of `Gains.term`.

    """

    factor: Floats
    term: Floats


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


class Trail(NamedTuple):
    """
    The label that was followed back last.

    Attributes
    ----------
    row, cell : ndarray of int, shape (max_steps + 1,)
        By steps; a row of -1 is none.
    visits : ndarray of int, shape (cells,)
        To each cell.

    """

    row: NDArray[np.int64]
    cell: NDArray[np.int64]
    visits: NDArray[np.int64]


@compiled
def surprisal(p: float) -> float:
    """Return -p ln p."""
    return -p * log(p) if p > 0.0 else 0.0


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
def label_value(products: Products, row: int, objective: LabelObjective) -> float:
    r"""
    Return the value of a label, in units.

    Equation :eq:`label-value`: `outcome_value` less what hazards leave open of the outcome,

    .. math:: E[h(p)] \approx \sum_j w_j E[p^{a_j}] - E[p \ln p],

    by equations :eq:`entropy-powers` and :eq:`moment-log`.
    """
    factor, term = products
    left_open = -factor[row, 0] * term[row, 0]
    for k in range(objective.weight.size):
        left_open += objective.weight[k] * factor[row, k]
    value: float = outcome_value(products, row, objective) - left_open
    return floor(value * objective.units + 0.5)


@compiled
def visit(
    products: Products, row: int, gains: Gains, rank: int, before: int, to: Products, to_row: int
) -> None:
    r"""
    Write a label after one more visit to a cell that it visits so often before.

    The moments of equation :eq:`moment-power` are multiplied, the sums of :eq:`moment-log` and of
    the information of readings are added to: after visit n to cell i,

    .. math::

        E[p^a] \leftarrow E[p^a] \frac{\mu_{i,n}(a)}{\mu_{i,n-1}(a)}, \qquad
        J_\omega \leftarrow J_\omega + J_{i,n,\omega} - J_{i,n-1,\omega}.
    """
    for k in range(products.factor.shape[1]):
        to.factor[to_row, k] = products.factor[row, k] * gains.factor[rank, before, k]
    for k in range(products.term.shape[1]):
        to.term[to_row, k] = products.term[row, k] + gains.term[rank, before, k]


@compiled
def insert(score: float, mark: int, length: float, origin: int, best: Ranking) -> None:
    """
    Put a candidate among the best, the best first, unless one of them has its mark.

    It must be as good as the last of them; of equal ones the earlier is the better. Those of
    equal marks have equal scores, and of these the shorter is kept: what may follow it is all that
    may follow the longer one.
    """
    scores, marks, lengths, origins = best
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
    length: float, rank: int, left: int, reach: Reach, completions: Floats, completion: Floats
) -> bool:
    """
    Copy the completion of most steps from a cell, at most `left`, that is no longer than this.

    Return whether there is one.
    """
    while left >= 0 and rank < reach.within[left]:
        place = reach.start[left] + rank
        if completions[place, -1] <= length:
            completion[:] = completions[place]
            return True
        left -= 1
    return False


@compiled
def find_best(
    rank: int,
    around: Places,
    reach: Reach,
    marks: NDArray[np.int64],
    gains: Gains,
    objective: LabelObjective,
    labels: Labels,
    completion: Floats,
    completions: Floats,
    left: int,
    by_value: Ranking,
    by_heuristic: Ranking,
) -> None:
    r"""
    Find the best ways to extend labels to a cell.

    Labels are compared by equation :eq:`label-value`, in which the surprisal of a loss, q in each
    joint outcome, is averaged as in equation :eq:`loss-surprisal`,

    .. math:: E[-q \ln q] \approx -\bar q \ln \bar q - \operatorname{Var}(q) / (2 \bar q),

    and by the same with a completion, whose moments multiply (equation :eq:`heuristic`). Labels
    are left out on which the robot could not come home within the length allowed.

    Parameters
    ----------
    rank : int
        The cell.
    around : ndarray of int, shape (9,)
        Where labels come from, -1 where there are none.
    reach : Reach
        Of the search.
    marks : ndarray of int, shape (cells,)
        What a visit adds to the mark of a label.
    gains, objective, labels
        Of the search; the labels are those of the step before.
    completion : ndarray, shape (powers + 5,)
        Of the cell: its moments times their weights, E[p], P0, the terms of both, and its length.
        Where lengths are limited it is overwritten by one that is short enough for each label.
    completions : ndarray, shape (sum of within, powers + 5)
        All of them, by steps and then cells.
    left : int
        The steps that a completion may have.
    by_value, by_heuristic : Ranking
        The result: the best by their value, and by their value with the completion.

    """
    gain_factor, gain_term = gains
    weight, chance, loss_cost, units = objective
    factor, term = labels.products
    mark, seen, kept = labels.mark, labels.seen, labels.kept
    score, heuristic = by_value.score, by_heuristic.score
    powers, max_visits = weight.size, gain_factor.shape[1]
    width = mark.size // kept.size
    for slot in range(score.size):
        score[slot] = -inf
    for slot in range(heuristic.size):
        heuristic[slot] = -inf
    is_limited = reach.longest > 0.0
    length, fits = 0.0, True
    for column in range(9):
        if around[column] < 0:
            continue
        for slot in range(kept[around[column]]):
            row = around[column] * width + slot
            before = seen[row, 8 - column]
            if before >= max_visits:
                continue
            if is_limited:
                length = labels.length[row] + reach.length[column]
                allowed = reach.longest - length
                if reach.home[rank] > allowed:
                    continue
                if heuristic.size:
                    fits = copy_fitting(allowed, rank, left, reach, completions, completion)
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

            value = brought + surprisal(lost) + mean * spread - left_open - loss_cost * lost
            if lost > 0.0:
                # Over several outcomes -q ln q is averaged to second order; its curvature is -1/q.
                value -= 0.5 * (lost_square - lost * lost) / lost
            value = floor(value * units + 0.5)
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
def merge(
    by_value: Ranking,
    by_heuristic: Ranking,
    found: NDArray[np.int64],
    found_mark: NDArray[np.int64],
) -> int:
    """Write the origins and marks of the best, those that are both once; return how many."""
    kept = 0
    score, mark, _, origin = by_value
    for slot in range(score.size):
        if score[slot] > -inf:
            found[kept], found_mark[kept] = origin[slot], mark[slot]
            kept += 1
    by_value_only = kept
    score, mark, _, origin = by_heuristic
    for slot in range(score.size):
        if score[slot] == -inf or kept == found.size:
            break
        is_new = True
        for other in range(by_value_only):
            is_new = is_new and found_mark[other] != mark[slot]
        if is_new:
            found[kept], found_mark[kept] = origin[slot], mark[slot]
            kept += 1
    return kept


@compiled
def write_completion(
    labels: Labels,
    row: int,
    length: float,
    gains: Gains,
    objective: LabelObjective,
    completion: Floats,
) -> None:
    """Write the completion along a label, and by one step, as in `find_best`; its length."""
    factor, term = labels.products
    gain_factor, gain_term = gains
    weight, chance = objective.weight, objective.chance
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
    reach: Reach,
    step: int,
    labels: Labels,
    best_value: Floats,
    gains: Gains,
    objective: LabelObjective,
    completions: Floats,
    best_completion: Floats,
) -> None:
    """
    Write the best completion of so many steps at most from each cell that it may start in.

    A path has the same value in both directions, so a completion is a label at a neighbour, walked
    backwards, and the step into the base. `best_completion`, (cells,), has the value of the label
    that each was made of, and is changed.
    """
    start = reach.start[step]
    for rank in range(reach.within[step]):
        via, length = -1, 0.0
        for column in range(9):
            origin = reach.neighbors[rank, column]
            if 0 <= origin < reach.within[step - 1] and best_value[origin] > best_completion[rank]:
                via, best_completion[rank] = origin, best_value[origin]
                length = labels.length[origin] + reach.length[column]
        if via >= 0:
            write_completion(labels, via, length, gains, objective, completions[start + rank])
        else:
            # One of fewer steps is as good.
            completions[start + rank] = completions[reach.start[step - 1] + rank]


@compiled
def follow(
    reach: Reach,
    trail: Trail,
    origins: NDArray[np.int32],
    width: int,
    step: int,
    rank: int,
    row: int,
) -> None:
    """Follow a label back to where it left the last one that was followed; count its visits."""
    while step > 0 and trail.row[step] != row:
        if trail.row[step] >= 0:
            trail.visits[trail.cell[step]] -= 1
        trail.visits[rank] += 1
        trail.row[step], trail.cell[step] = row, rank
        origin = origins[reach.start[step] * width + row]
        rank = reach.neighbors[rank, origin & 15]
        row = rank * width + (origin >> 4)
        step -= 1


@compiled
def no_labels(cells: int, width: int, gains: Gains) -> Labels:
    """Return room for the labels of one step."""
    rows = cells * width
    return Labels(
        Products(np.empty((rows, gains.factor.shape[2])), np.empty((rows, gains.term.shape[2]))),
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
    reach: Reach,
    marks: NDArray[np.int64],
    gains: Gains,
    objective: LabelObjective,
    width: int,
    by_heuristic: int,
    completions: Floats,
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
    reach : Reach
        The cells and their neighbours.
    marks : ndarray of int, shape (cells,)
        Whose sums tell apart how often each cell was visited.
    gains : Gains
        Of visits to the cells.
    objective : LabelObjective
        Of labels.
    width : int
        How many labels each cell may have.
    by_heuristic : int
        See above, less than `width`.
    completions : ndarray, shape (sum of within, powers + 5)
        A completion of at most so many steps from each cell that it may start in, as in
        `find_best`, by steps and then cells. It is read if there are rows by heuristic, and
        otherwise written; no rows if there is none to be known.

    Returns
    -------
    origins : ndarray of int, shape (sum of within * width,)
        By steps, cells and rows: where each label comes from, as in `Ranking`; -1 for no label.
    values : ndarray, shape (max_steps + 1, width)
        Of the labels at the base, in units; -inf for none.

    """
    within, neighbors = reach.within, reach.neighbors
    max_steps, cells, powers = within.size - 1, neighbors.shape[0], objective.weight.size
    origins = np.full(reach.start[-1] * width, -1, np.int32)
    values = np.full((max_steps + 1, width), -inf)
    labels, after = no_labels(within.max(), width, gains), no_labels(within.max(), width, gains)
    # The label of a robot that stands at the base.
    labels.products.factor[0], labels.products.term[0], labels.kept[0] = 1.0, 0.0, 1
    is_limited = reach.longest > 0.0
    by_value = no_ranking(width - by_heuristic, is_limited)
    heuristic = no_ranking(width if by_heuristic else 0, is_limited)
    found, found_mark = np.empty(width, np.int64), np.empty(width, np.int64)
    around = np.empty(9, np.int64)
    steps = max_steps + 1
    trail = Trail(np.full(steps, -1), np.empty(steps, np.int64), np.zeros(cells, np.int64))
    best_value, best_completion = np.zeros(cells), np.full(cells, -inf)
    no_completion = np.zeros(powers + 5)
    writes_completions = completions.shape[0] > 0 and by_heuristic == 0
    if writes_completions:
        # No steps left, and there.
        completions[0, :powers] = objective.weight
        completions[0, powers:] = 0.0
        completions[0, powers] = completions[0, powers + 1] = 1.0
        best_completion[0] = 0.0

    for step in range(1, max_steps + 1):
        if writes_completions:
            write_completions(
                reach, step, labels, best_value, gains, objective, completions, best_completion
            )
        start = reach.start[step]
        for rank in range(within[step]):
            for column in range(9):
                origin = neighbors[rank, column]
                around[column] = origin if origin < within[step - 1] else -1
            completion = no_completion
            if by_heuristic and not is_limited:
                completion = completions[reach.start[max_steps - step] + rank]
            find_best(
                rank,
                around,
                reach,
                marks,
                gains,
                objective,
                labels,
                completion,
                completions,
                max_steps - step,
                by_value,
                heuristic,
            )
            after.kept[rank] = merge(by_value, heuristic, found, found_mark)
            best_value[rank] = by_value.score[0]
            for slot in range(after.kept[rank]):
                column = found[slot] & 15
                row, to = neighbors[rank, column] * width + (found[slot] >> 4), rank * width + slot
                before = labels.seen[row, 8 - column]
                visit(labels.products, row, gains, rank, before, after.products, to)
                after.mark[to] = found_mark[slot]
                after.length[to] = labels.length[row] + reach.length[column]
                origins[start * width + to] = found[slot]
                follow(reach, trail, origins, width, step, rank, to)
                for column in range(9):
                    if neighbors[rank, column] >= 0:
                        after.seen[to, column] = trail.visits[neighbors[rank, column]]
        labels, after = after, labels
        for slot in range(labels.kept[0]):
            values[step, slot] = label_value(labels.products, slot, objective)
    return origins, values


@compiled
def trace(reach: Reach, origins: NDArray[np.int32], width: int, row: int, path: Places) -> None:
    """Write the path of a label, ranks of cells with the base first; its last cell is there."""
    steps = path.size - 1
    cell = path[steps]
    for step in range(steps, 0, -1):
        path[step] = cell
        origin = origins[reach.start[step] * width + row]
        cell = reach.neighbors[cell, origin & 15]
        row = cell * width + (origin >> 4)
    path[0] = cell


@compiled
def most_visits(path: Places, visits: NDArray[np.int64]) -> int:
    """Return how often a path enters the cell that it enters most; `visits` is overwritten."""
    visits[:] = 0
    most = 0
    for step in range(1, path.size):
        visits[path[step]] += 1
        most = max(most, visits[path[step]])
    return most


@compiled
def length_to(reach: Reach, cell: int, other: int) -> float:
    """Return the length of the step from a cell to another, metres; inf if there is none."""
    length = inf
    for column in range(9):
        if reach.neighbors[cell, column] == other:
            length = reach.length[column]
    return length


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
    visits: NDArray[np.int64],
    products: Products,
) -> None:
    """
    Write the label of a path without the steps between two of its places, and count its visits.

    Parameters
    ----------
    path : ndarray of int, shape (steps + 1,)
        Ranks of cells.
    first, last : int
        The two places.
    gains : Gains
        Of the search.
    visits : ndarray of int, shape (cells,)
        How often it visits each cell.
    products : Products
        The label is written into row 0.

    """
    visits[:] = 0
    products.factor[0] = 1.0
    products.term[0] = 0.0
    for step in range(1, path.size):
        if step <= first or step >= last:
            cell = path[step]
            visit(products, 0, gains, cell, visits[cell], products, 0)
            visits[cell] += 1


@compiled
def out_and_back(
    steps: int,
    reach: Reach,
    origins: NDArray[np.int32],
    width: int,
    gains: Gains,
    objective: LabelObjective,
) -> Floats:
    """
    Find the values of the paths that lead to a cell by its best label and back the same way.

    Parameters
    ----------
    steps : int
        From the base to the cell.
    reach, origins, width, gains, objective
        As for `search`.

    Returns
    -------
    ndarray, shape (within[steps],)
        For each cell, in units; -inf for those that have no such path of an allowed length.

    """
    values = np.full(reach.within[steps], -inf)
    visits = np.zeros(reach.neighbors.shape[0], np.int64)
    products = no_labels(1, 1, gains).products
    path, walked = np.empty(2 * steps + 1, np.int64), np.empty(2 * steps + 1)
    start = reach.start[steps]
    for cell in range(reach.within[steps]):
        if origins[(start + cell) * width] < 0:
            continue
        path[steps] = cell
        trace(reach, origins, width, cell * width, path[: steps + 1])
        for step in range(steps):
            path[2 * steps - step] = path[step]
        measure(path, reach, walked)
        if walked[2 * steps] > reach.longest:
            continue
        if most_visits(path, visits) <= gains.factor.shape[1]:
            take(path, 0, 0, gains, visits, products)
            values[cell] = label_value(products, 0, objective)
    return values


@compiled
def improve(
    path: Places,
    steps: int,
    reach: Reach,
    gains: Gains,
    objective: LabelObjective,
    most_between: int,
) -> int:
    """
    Replace stretches of a closed path by better ones until there are none: a local search.

    A stretch of up to `most_between` cells is replaced by the best of up to so many with which
    the path keeps to its length: all else stays, so its value is that of the whole path.

    Parameters
    ----------
    path : ndarray of int, shape (max_steps + 1,)
        Ranks of the cells, the first steps + 1 of them; it is changed.
    steps : int
        Of the path.
    reach, gains, objective
        As for `search`.
    most_between : int
        See above.

    Returns
    -------
    int
        The steps it has now.

    """
    max_visits = gains.factor.shape[1]
    neighbors = reach.neighbors
    visits = np.zeros(neighbors.shape[0], np.int64)
    products = no_labels(most_between + 1, 1, gains).products
    # Metres up to each place; and up to each cell of a stretch, with all that stays.
    walked, length = np.zeros(path.size), np.zeros(most_between + 1)
    measure(path[: steps + 1], reach, walked)
    stretch, best = np.empty(most_between + 1, np.int64), np.empty(most_between + 1, np.int64)
    column = np.empty(most_between + 1, np.int64)
    take(path[: steps + 1], 0, 0, gains, visits, products)
    best_value = label_value(products, 0, objective)
    # Places since the last replacement, up to all of them.
    first, unchanged = 0, 0
    while unchanged < steps:
        found, last = -1, first
        while found < 0 and last < min(first + most_between + 1, steps):
            last += 1
            between = last - first - 1
            take(path[: steps + 1], first, last, gains, visits, products)
            most = min(most_between, path.size - 1 - steps + between)
            length[0] = walked[first] + walked[steps] - walked[last]
            # Depth first through all stretches; row `depth` is the label with so many cells.
            depth, stretch[0], column[0] = 0, path[first], 0
            while depth >= 0:
                cell = stretch[depth]
                if column[depth] == 0:
                    closed = length[depth] + length_to(reach, cell, path[last])
                    value = label_value(products, depth, objective) if closed < inf else -inf
                    if value > best_value and closed <= reach.longest:
                        best_value, found = value, depth
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
                if depth + 1 < most or length_to(reach, there, path[last]) < inf:
                    before = visits[there]
                    visit(products, depth, gains, there, before, products, depth + 1)
                    visits[there] += 1
                    length[depth + 1] = length[depth] + reach.length[column[depth] - 1]
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
            measure(path[: steps + 1], reach, walked)
            unchanged = 0
        else:
            first, unchanged = (first + 1) % steps, unchanged + 1
    return steps
