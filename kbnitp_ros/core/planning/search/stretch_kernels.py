# SPDX-License-Identifier: Apache-2.0
"""
Searches for the best cells between two places of a closed path.

All else stays, so the value of a label is that of the whole path with its cells in the gap.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from kbnitp_ros.core.field import compiled, inlined
from kbnitp_ros.core.planning.search.label_kernels import (
    Floats,
    Gains,
    LabelProblem,
    new_products,
    Places,
    Products,
    steps_apart,
    value_after,
    visit,
)
import numpy as np


class Gap(NamedTuple):
    """
    A place for cells in a closed path.

    Attributes
    ----------
    ways : int
        1, or 2 if the cells are visited on the way out and again, in reverse, on the way back.
    most : int
        How many cells may go there.
    start, end : int
        The cells before and after it.
    old_first, old_last : int
        The first and the last cell that were there, which need not be tried in their places since
        a shorter gap keeps them; -1 if they are to be tried.
    length : float
        Metres of the path without the gap.

    """

    ways: int
    most: int
    start: int
    end: int
    old_first: int
    old_last: int
    length: float


class Room(NamedTuple):
    """
    What stays of a path, and room for labels.

    Attributes
    ----------
    visits : ndarray of int, shape (cells,)
        Of what stays.
    closing : ndarray, shape (cells,)
        Metres of the steps that join each cell to the end of the gap; inf where there are none.
    products : Products
        Of labels; row 0 is the label of what stays.
    value : ndarray, shape (rows,)
        Of each label, in units; -inf for none.
    length : ndarray, shape (rows,)
        Metres of what stays and of each label.
    cell, origin : ndarray of int, shape (rows,)
        The last cell of each label, and the row of the label that it extends.
    column : ndarray of int, shape (rows,)
        Of `Reach.neighbors`: where each label is extended to next.
    best : ndarray of int, shape (most,)
        The best cells.

    """

    visits: Places
    closing: Floats
    products: Products
    value: Floats
    length: Floats
    cell: Places
    origin: Places
    column: Places
    best: Places


@compiled
def new_room(cells: int, rows: int, most: int, gains: Gains) -> Room:
    """Return room for so many labels, and for stretches of up to `most` cells."""
    return Room(
        np.zeros(cells, np.int64),
        np.full(cells, inf),
        new_products(rows, gains),
        np.zeros(rows),
        np.empty(rows),
        np.empty(rows, np.int64),
        np.zeros(rows, np.int64),
        np.empty(rows, np.int64),
        np.empty(most, np.int64),
    )


@inlined
def find_stretch(problem: LabelProblem, gap: Gap, room: Room, least: float) -> tuple[float, int]:
    """
    Find the best cells for a gap, depth first through all.

    Parameters
    ----------
    problem : LabelProblem
        Of the path.
    gap : Gap
        Where they go.
    room : Room
        With at least `most` rows; row k is for labels of k cells.
    least : float
        Their value must be more than this, in units.

    Returns
    -------
    float
        Their value; `least` if there are none.
    int
        How many there are; -1 if there are none.

    """
    reach, gains, objective = problem.reach, problem.gains, problem.objective
    visits, closing, products = room.visits, room.closing, room.products
    length, cell, column, best = room.length, room.cell, room.column, room.best
    max_visits, ways = gains.factor.shape[1], gap.ways
    value, found, depth = least, -1, 0
    cell[0], column[0], length[0] = gap.start, 0, gap.length
    while depth >= 0:
        if column[depth] == 9 or gap.most == 0:
            if depth > 0:
                visits[cell[depth]] -= ways
            depth -= 1
            continue
        there = reach.neighbors[cell[depth], column[depth]]
        metres = length[depth] + ways * reach.length[column[depth]]
        column[depth] += 1
        if there < 0 or visits[there] + ways > max_visits:
            continue
        if depth == 0 and there == gap.old_first:
            continue
        if metres + closing[there] <= reach.longest and there != gap.old_last:
            closed = value_after(products, depth, gains, there, visits[there], ways, objective)
            if closed > value:
                value, found = closed, depth + 1
                for place in range(depth):
                    best[place] = cell[place + 1]
                best[depth] = there
        if depth + 1 < gap.most:
            visit(products, depth, gains, there, visits[there], products, depth + 1, ways)
            visits[there] += ways
            depth += 1
            cell[depth], column[depth], length[depth] = there, 0, metres
    return value, found


@inlined
def visits_of_label(room: Room, row: int, rank: int) -> int:
    """Return how many of the cells of a label, all in the gap, are this one."""
    visits = 0
    while row > 0:
        visits += int(room.cell[row] == rank)
        row = room.origin[row]
    return visits


@inlined
def find_long_stretch(
    problem: LabelProblem, gap: Gap, room: Room, least: float
) -> tuple[float, int]:
    """
    Find good cells for a gap by a label search that keeps one label for each cell and number.

    Parameters and results as of `find_stretch`, with 1 + most * cells rows: the first is for what
    stays, and each next `cells` for labels of one cell more.
    """
    reach, gains, objective = problem.reach, problem.gains, problem.objective
    cells, max_visits, ways = room.visits.size, gains.factor.shape[1], gap.ways
    value, found = least, -1
    for row in range(1, room.value.size):
        room.value[row] = -inf
    room.cell[0], room.length[0] = gap.start, gap.length
    begin, after = 0, 1
    for count in range(1, gap.most + 1):
        left = gap.most + 1 - count
        for row in range(begin, after):
            if room.value[row] == -inf:
                continue
            for column in range(9):
                there = reach.neighbors[room.cell[row], column]
                if there < 0 or steps_apart(reach, there, gap.end) > left:
                    continue
                before = room.visits[there] + ways * visits_of_label(room, row, there)
                metres = room.length[row] + ways * reach.length[column]
                if before + ways > max_visits or metres > reach.longest:
                    continue
                label = value_after(room.products, row, gains, there, before, ways, objective)
                if label > value and metres + room.closing[there] <= reach.longest:
                    value, found = label, count
                    room.best[count - 1], at = there, row
                    for place in range(count - 2, -1, -1):
                        room.best[place], at = room.cell[at], room.origin[at]
                to = after + there
                if label > room.value[to]:
                    room.value[to], room.length[to] = label, metres
                    room.cell[to], room.origin[to] = there, row
        begin, after = after, after + cells
        if count == gap.most:
            break
        for row in range(begin, after):
            if room.value[row] > -inf:
                rank, origin = room.cell[row], room.origin[row]
                before = room.visits[rank] + ways * visits_of_label(room, origin, rank)
                visit(room.products, origin, gains, rank, before, room.products, row, ways)
    return value, found
