# SPDX-License-Identifier: Apache-2.0
r"""
Labels of paths: what they carry, how a visit changes it, and what it is worth.

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

from math import floor, log
from typing import NamedTuple

from kbnitp_ros.core.field import compiled, inlined
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
    position : ndarray of int, shape (n, 2)
        Row and column of each.
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
    position: Places
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


class LabelProblem(NamedTuple):
    """
    What labels are searched for.

    Attributes
    ----------
    reach : Reach
        The cells and their neighbours.
    marks : ndarray of int, shape (cells,)
        What a visit adds to the mark of a label; sums tell apart how often each was visited.
    gains : Gains
        Of visits to the cells.
    objective : LabelObjective
        Of labels.

    """

    reach: Reach
    marks: NDArray[np.int64]
    gains: Gains
    objective: LabelObjective


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


@inlined
def steps_apart(reach: Reach, one: int, other: int) -> int:
    """Return how many steps are between two cells at least, without obstacles."""
    position = reach.position
    rows: int = abs(position[one, 0] - position[other, 0])
    columns: int = abs(position[one, 1] - position[other, 1])
    return max(rows, columns)


@compiled
def surprisal(p: float) -> float:
    """Return -p ln p."""
    return -p * log(p) if p > 0.0 else 0.0


@inlined
def averaged_value(brought: float, lost: float, lost_square: float, loss_cost: float) -> float:
    r"""
    Return the value of a label without the entropy that hazards leave in its own outcome.

    The first sum of equation :eq:`label-value`, with the surprisal of a loss averaged as in
    equation :eq:`loss-surprisal`: with the chance q of a loss in each joint outcome,

    .. math:: E[-q \ln q] \approx -\bar q \ln \bar q - \operatorname{Var}(q) / (2 \bar q).

    Parameters
    ----------
    brought : float
        The mean of what readings bring, nats.
    lost, lost_square : float
        The means of q and of its square.
    loss_cost : float
        Nats.

    """
    value = brought + surprisal(lost) - loss_cost * lost
    if lost > 0.0:
        value -= 0.5 * (lost_square - lost * lost) / lost
    return value


@compiled
def label_value(products: Products, row: int, objective: LabelObjective) -> float:
    r"""
    Return the value of a label, in units.

    Equation :eq:`label-value`: `averaged_value` less what hazards leave open of the outcome,

    .. math:: E[h(p)] \approx \sum_j w_j E[p^{a_j}] - E[p \ln p],

    by equations :eq:`entropy-powers` and :eq:`moment-log`.
    """
    factor, term = products
    weight, chance, loss_cost, units = objective
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
    value: float = averaged_value(brought, lost, lost_square, loss_cost) - left_open
    return floor(value * units + 0.5)


@inlined
def visit(
    products: Products,
    row: int,
    gains: Gains,
    rank: int,
    before: int,
    to: Products,
    to_row: int,
    times: int = 1,
) -> None:
    r"""
    Write a label after one or two more visits to a cell that it visits so often before.

    The moments of equation :eq:`moment-power` are multiplied, the sums of :eq:`moment-log` and of
    the information of readings are added to: after visit n to cell i,

    .. math::

        E[p^a] \leftarrow E[p^a] \frac{\mu_{i,n}(a)}{\mu_{i,n-1}(a)}, \qquad
        J_\omega \leftarrow J_\omega + J_{i,n,\omega} - J_{i,n-1,\omega}.
    """
    for k in range(products.factor.shape[1]):
        factor = products.factor[row, k] * gains.factor[rank, before, k]
        if times == 2:
            factor *= gains.factor[rank, before + 1, k]
        to.factor[to_row, k] = factor
    for k in range(products.term.shape[1]):
        term = products.term[row, k] + gains.term[rank, before, k]
        if times == 2:
            term += gains.term[rank, before + 1, k]
        to.term[to_row, k] = term


@inlined
def value_after(
    products: Products,
    row: int,
    gains: Gains,
    rank: int,
    before: int,
    times: int,
    objective: LabelObjective,
) -> float:
    """Return `label_value` after `visit`, without writing that label."""
    factor, term = products
    weight, chance, loss_cost, units = objective
    powers = weight.size
    left_open, mean = 0.0, 0.0
    for k in range(powers):
        moment = factor[row, k] * gains.factor[rank, before, k]
        if times == 2:
            moment *= gains.factor[rank, before + 1, k]
        left_open += weight[k] * moment
        if k == 0:
            mean = moment
    spread = term[row, 0] + gains.term[rank, before, 0]
    if times == 2:
        spread += gains.term[rank, before + 1, 0]
    lost, lost_square, brought = 0.0, 0.0, 0.0
    for outcome in range(chance.size):
        survival = factor[row, powers + outcome] * gains.factor[rank, before, powers + outcome]
        readings = term[row, 1 + outcome] + gains.term[rank, before, 1 + outcome]
        if times == 2:
            survival *= gains.factor[rank, before + 1, powers + outcome]
            readings += gains.term[rank, before + 1, 1 + outcome]
        loss = chance[outcome] * (1.0 - survival)
        lost += loss
        lost_square += loss * (1.0 - survival)
        brought += chance[outcome] * survival * readings
    left_open -= mean * spread
    value: float = averaged_value(brought, lost, lost_square, loss_cost) - left_open
    return floor(value * units + 0.5)


@compiled
def new_products(rows: int, gains: Gains) -> Products:
    """Return room for the factors and the terms of so many labels."""
    return Products(np.empty((rows, gains.factor.shape[2])), np.empty((rows, gains.term.shape[2])))
