# SPDX-License-Identifier: Apache-2.0
r"""
A label search for lassos: paths that go out, around a loop, and back the way out.

The way out and back is the stem. A lasso with :math:`\sigma_i` visits to cell i on the way out and
:math:`\lambda_i` on the loop visits the cell

.. math:: n_i = 2 \sigma_i + \lambda_i

times (equation :eq:`lasso`). A stem of k steps takes 2 k steps from the start, and its label has
the visits of both ways. Then the robot goes on step by step to the cell where the stem ends. A
label has the value of equation :eq:`label-value` that it has if the robot is there at once, so
labels with stems of any length compete at the same cell after the same number of steps.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from kbnitp_ros.core.field import compiled, inlined
from kbnitp_ros.core.planning.search.label_kernels import (
    Floats,
    Gains,
    label_value,
    LabelProblem,
    new_products,
    Places,
    Products,
    steps_apart,
    value_after,
    visit,
)
from kbnitp_ros.core.planning.search.search_kernels import insert, no_ranking, Ranking
import numpy as np
from numpy.typing import NDArray


class Lassos(NamedTuple):
    """
    The labels after some number of steps, by cells and then by their rank.

    Attributes
    ----------
    products : Products
        Their factors and terms.
    mark : ndarray of int, shape (rows,)
        The sums of the marks of their visits.
    length : ndarray, shape (rows,)
        Metres, the stem twice.
    stem : ndarray of int, shape (rows,)
        Steps of the stem.
    path : ndarray of int, shape (rows, max_steps + 1)
        Ranks of the cells of the stem and then of the loop.
    kept : ndarray of int, shape (cells,)
        How many labels each cell has.

    """

    products: Products
    mark: NDArray[np.int64]
    length: Floats
    stem: NDArray[np.int64]
    path: NDArray[np.int32]
    kept: NDArray[np.int64]


class Closed(NamedTuple):
    """
    The best closed lasso for each cell that a stem may end in.

    Attributes
    ----------
    value : ndarray, shape (cells,)
        In units; -inf for none.
    path : ndarray of int, shape (cells, max_steps + 1)
        Ranks of its cells.
    steps : ndarray of int, shape (cells,)
        Of the path.

    """

    value: Floats
    path: NDArray[np.int32]
    steps: Places


@compiled
def no_lassos(cells: int, width: int, steps: int, gains: Gains) -> Lassos:
    """Return room for the labels after one number of steps."""
    rows = cells * width
    return Lassos(
        new_products(rows, gains),
        np.zeros(rows, np.int64),
        np.zeros(rows),
        np.zeros(rows, np.int64),
        np.zeros((rows, steps + 1), np.int32),
        np.zeros(cells, np.int64),
    )


@inlined
def visits_of(labels: Lassos, row: int, places: int, rank: int) -> int:
    """Return how often a label visits a cell; it has so many places after the first base."""
    # Its way home ends in the base.
    visits = int(rank == 0)
    stem = labels.stem[row]
    for place in range(1, places + 1):
        visits += (1 + (place <= stem)) * (labels.path[row, place] == rank)
    return visits


@compiled
def close(labels: Lassos, row: int, step: int, value: float, closed: Closed) -> None:
    """Write the path of a label that is back where its stem ends, and goes home from there."""
    stem = labels.stem[row]
    end = labels.path[row, stem]
    last = step - stem
    path = closed.path[end]
    path[:last] = labels.path[row, :last]
    path[last] = end
    for place in range(stem):
        path[last + 1 + place] = path[stem - 1 - place]
    closed.value[end], closed.steps[end] = value, step


@inlined
def find_extensions(
    problem: LabelProblem,
    labels: Lassos,
    ways: int,
    step: int,
    rank: int,
    source: int,
    closed: Closed,
    best: Ranking,
) -> None:
    """
    Find the best ways to extend labels to a cell.

    A label is left out that cannot be where its stem ends in time, even without obstacles.

    Parameters
    ----------
    problem : LabelProblem
        Of the search.
    labels : Lassos
        Those of `ways` steps before.
    ways : int
        2 for stems and 1 for loops.
    step, rank : int
        After how many steps the robot is at the cell, and the cell.
    source : int
        What the origins are marked with: 0 for loops and 1 for stems.
    closed : Closed
        Lassos that end here, if they are better.
    best : Ranking
        The result, with `2 * (16 * slot + column) + source` as origins.

    """
    reach, marks, gains, objective = problem
    width = labels.mark.size // labels.kept.size
    left = reach.within.size - 1 - step
    is_limited = reach.longest > 0.0
    for column in range(9):
        origin = reach.neighbors[rank, column]
        if origin < 0:
            continue
        for slot in range(labels.kept[origin]):
            row = origin * width + slot
            stem = labels.stem[row]
            end = labels.path[row, stem]
            if ways == 1 and left < steps_apart(reach, rank, end):
                continue
            length = labels.length[row] + ways * reach.length[column]
            if is_limited and length > reach.longest:
                continue
            if ways == 1 and rank == end:
                # The label has this visit already, on the way back.
                value = label_value(labels.products, row, objective)
                if value > closed.value[end]:
                    close(labels, row, step, value, closed)
                continue
            before = visits_of(labels, row, step - ways - stem, rank)
            if before + ways > gains.factor.shape[1]:
                continue
            value = value_after(labels.products, row, gains, rank, before, ways, objective)
            if value > best.score[-1]:
                mark = labels.mark[row] + ways * marks[rank]
                insert(value, mark, length, 2 * (16 * slot + column) + source, best)


@compiled
def extend(
    problem: LabelProblem,
    loops: Lassos,
    stems: Lassos,
    ways: int,
    step: int,
    closed: Closed,
    best: Ranking,
    after: Lassos,
) -> None:
    """Write the best extensions of loops and stems to each cell; see `find_extensions`."""
    neighbors, length = problem.reach.neighbors, problem.reach.length
    width = best.score.size
    # A stem does not come back to the base: it would end there.
    after.kept[0] = 0
    for rank in range(ways - 1, neighbors.shape[0]):
        best.score[:] = -inf
        if ways == 1:
            find_extensions(problem, loops, ways, step, rank, 0, closed, best)
        if ways == 2 or (step % 2 == 1 and step > 1):
            find_extensions(problem, stems, ways, step, rank, 1, closed, best)
        kept = 0
        while kept < width and best.score[kept] > -inf:
            origin = best.origin[kept]
            column = (origin >> 1) & 15
            labels = stems if origin & 1 else loops
            row = neighbors[rank, column] * (labels.mark.size // labels.kept.size) + (origin >> 5)
            places = step - ways - labels.stem[row]
            before = visits_of(labels, row, places, rank)
            to = rank * width + kept
            visit(labels.products, row, problem.gains, rank, before, after.products, to, ways)
            after.mark[to] = best.mark[kept]
            after.length[to] = labels.length[row] + ways * length[column]
            after.stem[to] = labels.stem[row] + ways - 1
            after.path[to, : places + 1] = labels.path[row, : places + 1]
            after.path[to, places + 1] = rank
            kept += 1
        after.kept[rank] = kept


@compiled
def search_lassos(problem: LabelProblem, width: int, stem_width: int) -> Closed:
    """
    Find good lassos, with stems of one step at least.

    Parameters
    ----------
    problem : LabelProblem
        What is searched for.
    width, stem_width : int
        How many labels each cell may have after each number of steps: those whose loop has begun,
        and stems.

    Returns
    -------
    Closed
        See there.

    """
    reach, _, gains, _ = problem
    max_steps, cells = reach.within.size - 1, reach.neighbors.shape[0]
    is_limited = reach.longest > 0.0
    loops, next_loops = (
        no_lassos(cells, width, max_steps, gains),
        no_lassos(cells, width, max_steps, gains),
    )
    stems, next_stems = (
        no_lassos(cells, stem_width, max_steps, gains),
        no_lassos(cells, stem_width, max_steps, gains),
    )
    # The stem of a robot that stands at the base, to which it will return.
    stems.products.factor[0], stems.products.term[0] = 1.0, 0.0
    visit(stems.products, 0, gains, 0, 0, stems.products, 0)
    stems.mark[0], stems.kept[0] = problem.marks[0], 1
    best_loops, best_stems = no_ranking(width, is_limited), no_ranking(stem_width, is_limited)
    closed = Closed(
        np.full(cells, -inf), np.zeros((cells, max_steps + 1), np.int32), np.zeros(cells, np.intp)
    )
    for step in range(1, max_steps + 1):
        extend(problem, loops, stems, 1, step, closed, best_loops, next_loops)
        loops, next_loops = next_loops, loops
        if step % 2 == 0 and step < max_steps:
            extend(problem, loops, stems, 2, step, closed, best_stems, next_stems)
            stems, next_stems = next_stems, stems
    return closed
