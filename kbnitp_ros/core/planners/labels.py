# SPDX-License-Identifier: Apache-2.0
"""Label search: extend the best few partial paths of every cell, step by step."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.belief import Belief
from kbnitp_ros.core.entropy import binary_entropy
from kbnitp_ros.core.grid import Grid
from kbnitp_ros.core.information import fate_entropy, reading_information
from kbnitp_ros.core.sensor import SensorModel
from kbnitp_ros.core.survival import log_predicted_survival
import numpy as np
from numpy.typing import NDArray

# Values closer than this many decimals (nats) are ties, so rounding never decides for a path.
DECIMALS = 10


@dataclass(frozen=True)
class Labels:
    """
    The partial paths kept after some number of steps: up to `width` for each cell they end in.

    Attributes
    ----------
    value : ndarray, shape (cells, width)
        Information if the path ended here, nats, best first; -inf where there is no label.
    log_survival : ndarray, shape (cells, width)
        Log of the predicted survival.
    read : ndarray, shape (cells, width)
        Information of the readings if the robot survives, nats.
    exposures : ndarray, shape (cells, width, steps + 1)
        P(c of the steps lead into a hazard).
    path : ndarray of int, shape (cells, width, steps)
        The cells the steps lead to.
    visited : ndarray of uint64, shape (cells, width)
        Equal for paths that visit the same cells equally often.

    """

    value: NDArray[np.float64]
    log_survival: NDArray[np.float64]
    read: NDArray[np.float64]
    exposures: NDArray[np.float64]
    path: NDArray[np.intp]
    visited: NDArray[np.uint64]


class Gains:
    """What the next visit to each cell adds, by the number of visits before it."""

    def __init__(self, belief: Belief, model: SensorModel, max_visits: int) -> None:
        visits = np.arange(max_visits + 1)
        log_survival = log_predicted_survival(
            belief.hazard[:, None], visits[None, :], model.log_survival
        )
        read = np.zeros((belief.cells, max_visits + 1))
        for count in visits[1:]:
            read[:, count] = reading_information(belief.joint, model, count)
        with np.errstate(invalid='ignore'):
            # Once nobody survives nothing more can be lost: -inf less -inf adds nothing.
            self.log_survival = np.nan_to_num(np.diff(log_survival), nan=0.0, neginf=-np.inf)
        self.read = np.diff(read)


def best_path(
    grid: Grid, belief: Belief, model: SensorModel, max_steps: int, width: int, max_visits: int
) -> NDArray[np.intp]:
    """
    Return the most informative closed path that the search finds.

    Labels at the same cell after the same number of steps compete by the information of their
    partial path, which is exact at every step, repeated visits included. Paths that differ only
    in the order of their visits are worth the same and count once.

    Parameters
    ----------
    grid : Grid
        Gives the base and who neighbours whom.
    belief : Belief
        Before the deployment.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    max_steps : int
        The most steps the path may have.
    width : int
        How many labels are kept for each cell and step.
    max_visits : int
        How often the path may enter a cell.

    Returns
    -------
    ndarray of int, shape (steps + 1,)
        The base first and last. The same belief gives the same path.

    """
    gains = Gains(belief, model, max_visits)
    marks = scattered(grid.cells)
    labels = start(grid, width)
    best_value = -np.inf
    best = np.empty(0, dtype=np.intp)
    for step in range(1, max_steps + 1):
        ends = np.flatnonzero(grid.free & (grid.steps_to_base <= max_steps - step))
        labels = extend(grid, belief.hazard, gains, marks, fate_entropy(model, step), labels, ends)
        value = np.round(labels.value[grid.base, 0], DECIMALS)
        if value > best_value:
            best_value, best = value, labels.path[grid.base, 0]
    return np.concatenate([[grid.base], best])


def scattered(cells: int) -> NDArray[np.uint64]:
    """Return a mark for each cell whose sums tell apart how often each was visited (splitmix)."""
    x = np.arange(1, cells + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def start(grid: Grid, width: int) -> Labels:
    """Return the one label of a robot that stands at the base."""
    shape = (grid.cells, width)
    value = np.full(shape, -np.inf)
    value[grid.base, 0] = 0.0
    return Labels(
        value=value,
        log_survival=np.zeros(shape),
        read=np.zeros(shape),
        exposures=np.ones((*shape, 1)),
        path=np.empty((*shape, 0), dtype=np.intp),
        visited=np.zeros(shape, dtype=np.uint64),
    )


def extend(
    grid: Grid,
    hazard: NDArray[np.float64],
    gains: Gains,
    marks: NDArray[np.uint64],
    open_fate: NDArray[np.float64],
    labels: Labels,
    ends: NDArray[np.intp],
) -> Labels:
    """
    Return the labels one step later.

    Parameters
    ----------
    grid : Grid
        Gives who neighbours whom.
    hazard : ndarray, shape (cells,)
        P(Z = 1).
    gains : Gains
        What each visit adds.
    marks : ndarray of uint64, shape (cells,)
        As `scattered`.
    open_fate : ndarray, shape (steps + 1,)
        `fate_entropy` of the number of steps after this one.
    labels : Labels
        Before the step.
    ends : ndarray of int
        The cells the step may lead to.

    """
    cells, width = labels.value.shape
    max_visits = gains.read.shape[1]
    # Candidates for each end: every label of every neighbour, shape (ends, 9 * width).
    origin = np.repeat(grid.neighbor_table[ends], width, axis=1)
    label = np.tile(np.arange(width), 9)
    visits = (labels.path[origin, label] == ends[:, None, None]).sum(axis=-1)
    allowed = (origin >= 0) & (labels.value[origin, label] > -np.inf) & (visits < max_visits)
    end, candidate = np.nonzero(allowed)
    origin, label, visits = origin[allowed], label[candidate], visits[allowed]
    to = ends[end]

    log_survival = labels.log_survival[origin, label] + gains.log_survival[to, visits]
    read = labels.read[origin, label] + gains.read[to, visits]
    # A first visit needs of each label only its mean entropy without and with one more exposure.
    spared, exposed = (labels.exposures @ open_fate[:-1], labels.exposures @ open_fate[1:])
    undecided = (1.0 - hazard[to]) * spared[origin, label] + hazard[to] * exposed[origin, label]
    for count in np.unique(visits[visits > 0]):
        again = visits == count
        others = without_cell(
            labels.exposures[origin[again], label[again]], hazard[to[again]], count
        )
        reach = others.shape[1]
        undecided[again] = (1.0 - hazard[to[again]]) * (others @ open_fate[:reach])
        undecided[again] += hazard[to[again]] * (others @ open_fate[count + 1 :][:reach])
    survival = np.exp(log_survival)
    value = binary_entropy(survival) - undecided + survival * read
    visited = labels.visited[origin, label] + marks[to]

    chosen, slot = best_of_each(end, np.round(value, DECIMALS), visited, width)
    kept = (to[chosen], slot)
    step = len(open_fate) - 1
    after = Labels(
        value=np.full((cells, width), -np.inf),
        log_survival=np.zeros((cells, width)),
        read=np.zeros((cells, width)),
        exposures=np.zeros((cells, width, step + 1)),
        path=np.zeros((cells, width, step), dtype=np.intp),
        visited=np.zeros((cells, width), dtype=np.uint64),
    )
    origin, label = origin[chosen], label[chosen]
    after.value[kept] = value[chosen]
    after.log_survival[kept] = log_survival[chosen]
    after.read[kept] = read[chosen]
    after.exposures[kept] = with_visit(
        labels.exposures[origin, label], hazard[to[chosen]], visits[chosen]
    )
    after.path[kept] = np.column_stack([labels.path[origin, label], to[chosen]])
    after.visited[kept] = visited[chosen]
    return after


def best_of_each(
    end: NDArray[np.intp], value: NDArray[np.float64], visited: NDArray[np.uint64], width: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """
    Return the best `width` candidates of each end, of those that visit the same cells only one.

    Parameters
    ----------
    end : ndarray of int, shape (n,)
        Ascending.
    value : ndarray, shape (n,)
        Ties go to the earlier candidate.
    visited : ndarray of uint64, shape (n,)
        Equal for candidates that count as the same.
    width : int
        How many of each end at most.

    Returns
    -------
    chosen : ndarray of int, shape (m,)
        Indices of candidates.
    slot : ndarray of int, shape (m,)
        The rank of each among its end's, from 0.

    """
    ranked = np.lexsort((-value, end))
    by_visits = ranked[np.lexsort((visited[ranked], end[ranked]))]
    same = (visited[by_visits[1:]] == visited[by_visits[:-1]]) & (
        end[by_visits[1:]] == end[by_visits[:-1]]
    )
    repeated = np.zeros(len(end), dtype=bool)
    repeated[by_visits[1:][same]] = True
    ranked = ranked[~repeated[ranked]]
    ends = end[ranked]
    slot = np.arange(len(ranked)) - np.searchsorted(ends, ends)
    best = slot < width
    return ranked[best], slot[best]


def with_visit(
    exposures: NDArray[np.float64], hazard: NDArray[np.float64], visits: NDArray[np.intp]
) -> NDArray[np.float64]:
    """
    Return the distributions of exposures after one more visit to a cell.

    Parameters
    ----------
    exposures : ndarray, shape (n, steps + 1)
        Before.
    hazard : ndarray, shape (n,)
        P(Z = 1) of the cell visited.
    visits : ndarray of int, shape (n,)
        How often it was visited before.

    Returns
    -------
    ndarray, shape (n, steps + 2)

    """
    after = np.zeros((len(exposures), exposures.shape[1] + 1))
    for count in np.unique(visits):
        same = visits == count
        z = hazard[same, None]
        others = without_cell(exposures[same], hazard[same], count)
        reach = others.shape[1]
        moved = np.zeros((len(others), after.shape[1]))
        moved[:, :reach] = (1.0 - z) * others
        moved[:, count + 1 :] += z * others
        after[same] = moved
    return after


def without_cell(
    exposures: NDArray[np.float64], hazard: NDArray[np.float64], visits: int
) -> NDArray[np.float64]:
    """
    Return the distributions of exposures in all cells but one.

    Takes one cell's factor (1 - z) + z t^visits out of the generating polynomial, from the end at
    which the division is stable: the lower coefficients where the cell is likely safe.

    Parameters
    ----------
    exposures : ndarray, shape (n, steps + 1)
        With the cell.
    hazard : ndarray, shape (n,)
        z = P(Z = 1) of the cell.
    visits : int
        How often it was visited.

    Returns
    -------
    ndarray, shape (n, steps + 1 - visits)

    """
    if not visits:
        return exposures
    deadly = hazard > 0.5
    product = np.where(deadly[:, None], exposures[:, ::-1], exposures).T
    rarer = np.where(deadly, 1.0 - hazard, hazard)
    quotient = np.empty((len(product) - visits, len(hazard)))
    for power in range(len(quotient)):
        quotient[power] = product[power]
        if power >= visits:
            quotient[power] -= rarer * quotient[power - visits]
        quotient[power] /= 1.0 - rarer
    return np.where(deadly[:, None], quotient.T[:, ::-1], quotient.T)
