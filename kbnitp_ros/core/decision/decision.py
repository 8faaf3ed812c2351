# SPDX-License-Identifier: Apache-2.0
"""Decisions on a goal, and the safest paths between cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from types import MappingProxyType
from typing import NamedTuple

from kbnitp_ros.core.decision.hazard_draws import cells_on, Hazards, Path
from kbnitp_ros.core.field.check import Floats, number, read_only, typed, whole_number
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.sensor import SensorModel
import numpy as np
from numpy.typing import ArrayLike

# Number of lanes compared, in addition to the lane that is cheapest by the marginals of its cells.
LANES = 48
# Standard deviation of the log of the random factors by which the costs of cells are scaled.
SCALE = 0.7
# Number of draws averaged for the costs of a lane: few, to keep the dependence between cells.
TOGETHER = 16
# Cost of each step besides its hazard: among equally free lanes the shortest is chosen.
STEP_COST = 1e-4
# Lower limit of the log probability that a cell is free.
LEAST = -30.0
# Maximum number of path costs in memory.
MAX_TOGETHER = 1 << 25
# Decimals of compared values: closer values are ties, so rounding errors never decide.
DECIMALS = 9


def cheapest_lanes(
    grid: Grid, costs: Floats, start: int, to: ArrayLike, limits: Sequence[int]
) -> list[list[Path]]:
    """Return, for each limit of steps, the cheapest path for each row of costs."""
    goal, from_cells = np.broadcast_to(to, len(costs)), grid.neighbor_table.T
    most = min(max(limits), grid.cells - 1)
    together = max(1, MAX_TOGETHER // ((most + 1) * (grid.cells + 1)))
    within: list[list[Path]] = [[] for _ in limits]
    for first in range(0, len(costs), together):
        some = slice(first, first + together)
        entered = costs[some].T
        # Cost of the cheapest paths of n steps, shape (most + 1, cells + 1, lanes).
        cost = np.full((most + 1, grid.cells + 1, entered.shape[1]), np.inf)
        cost[0, start] = 0.0
        for step in range(most):
            cost[step + 1, :-1] = cost[step][from_cells].min(axis=0) + entered
        for found, limit in zip(within, limits):
            found += ways_back(from_cells, cost[: limit + 1], goal[some])
    return within


def ways_back(from_cells: Path, cost: Floats, goal: Path) -> list[Path]:
    """Trace back each row's cheapest path to its goal; `cost` is indexed [steps, cell, row]."""
    lanes = np.arange(goal.size)
    steps = np.argmin(cost[:, goal, lanes], axis=0)
    last = int(steps.max(initial=0))
    path = np.tile(goal[:, None], last + 1)
    for step in range(last - 1, -1, -1):
        came_from = from_cells[:, path[:, step + 1]]
        by = cost[step][came_from, lanes].argmin(axis=0)
        on_the_way = step < steps
        path[on_the_way, step] = came_from[by, lanes][on_the_way]
    return [way[: end + 1].copy() for way, end in zip(path, steps.tolist())]


def lanes_within(
    grid: Grid, draws: Hazards, start: int, to: int, limits: Sequence[int]
) -> list[list[Path]]:
    """Return, for each limit, candidates for the safest path, the same for equal draws."""
    free = 1.0 - draws.p_hazard()
    rng = np.random.default_rng(draws.weight.size)
    some = rng.choice(draws.weight.size, (LANES // 2, TOGETHER), p=draws.weight)
    free_in_some = 1.0 - draws.hazard[some].mean(axis=1)
    by_marginals = np.tile(free, (1 + LANES - LANES // 2, 1))
    by_some = (TOGETHER * free_in_some + free) / (TOGETHER + 1.0)
    with np.errstate(divide='ignore'):
        cost = -np.log(np.concatenate([by_marginals, by_some])).clip(min=LEAST) + STEP_COST
    cost[1:] *= np.exp(SCALE * rng.standard_normal(cost[1:].shape))
    return [different(paths) for paths in cheapest_lanes(grid, cost, start, to, limits)]


def different(paths: Iterable[Path]) -> list[Path]:
    """Return paths without their repetitions."""
    return list({path.tobytes(): path for path in paths}.values())


def there_and_back(out: Path, back: Path) -> Path:
    """Return the path out along one lane and back along another."""
    return np.concatenate([out, back[-2::-1]])


@typed
def safest_path(
    grid: Grid,
    draws: Hazards,
    model: SensorModel,
    start: int,
    to: int,
    max_steps: int,
    confidence: float | None = None,
) -> Decision:
    """
    Return the path with the highest probability of being free of hazards.

    The search is a heuristic; the probabilities are those of the path found, over all draws or
    hypotheses.

    Parameters
    ----------
    grid : Grid
        The field.
    draws : HazardDraws or Mixture
        Joint probabilities of the hazards.
    model : SensorModel
        Believed sensor model of the traveller; numbers that differ between the hypotheses of a
        mixture replace its own.
    start, to : int
        The first and the last cell.
    max_steps : int
        Maximum steps of a path, at least 1.
    confidence : float, optional
        As in `Lane`.

    Returns
    -------
    Decision
        The decision on the cells of the path.

    Raises
    ------
    ValueError
        If a cell is off the map or on an obstacle, no path within `max_steps` joins the cells, or
        the confidence is out of range.

    """
    check_confidence(confidence)
    check_way(grid, start, to, max_steps)
    if draws.cells != grid.cells:
        raise ValueError(f'draws are of {draws.cells} cells: the grid has {grid.cells}')
    [paths] = lanes_within(grid, draws, start, to, [max_steps])
    best = int(np.argmax(np.round(draws.are_free(paths) @ draws.weight, DECIMALS)))
    path = paths[best]
    return Decision.about('lane', draws, path, confidence, path, draws.survival(path, model))


def safest_ways(grid: Grid, p_hazard: ArrayLike, starts: Sequence[int]) -> Path:
    """
    Return the safest ways from some cells to all cells, where hazards are independent.

    A way has the least sum of the costs of its cells, without a limit of its steps: -log P(no
    hazard), and `STEP_COST`.

    Parameters
    ----------
    grid : Grid
        The field.
    p_hazard : array_like, shape (cells,)
        P(hazard) of each cell, in [0, 1].
    starts : sequence of int
        The first cells of the ways.

    Returns
    -------
    ndarray of int, shape (starts, cells)
        The cell before each cell on its safest way; negative for a start, and for cells without a
        way.

    """
    from_cells, which = grid.neighbor_table, np.arange(len(starts))
    with np.errstate(divide='ignore'):
        entered = STEP_COST - np.log(1.0 - np.asarray(p_hazard)).clip(min=LEAST)
    # The last row is of no cell.
    cost = np.full((grid.cells + 1, len(starts)), np.inf)
    cost[starts, which] = 0.0
    while True:
        shorter = np.minimum(cost[:-1], cost[from_cells].min(axis=1) + entered[:, None])
        if np.array_equal(shorter, cost[:-1]):
            break
        cost[:-1] = shorter
    before = np.take_along_axis(from_cells, cost[from_cells].argmin(axis=1), axis=1)
    before[np.isinf(shorter)] = -1
    before[starts, which] = -1
    return before.T


def check_way(grid: Grid, start: int, to: int, max_steps: int) -> None:
    """Check that the cell `to` can be reached from `start`."""
    cells_on(grid, [start], 'start')
    cells_on(grid, [to], 'goal')
    whole_number('max_steps', max_steps, 1)
    least = int(grid.steps_from(start, grid.free)[to])
    if least >= grid.cells:
        raise ValueError(f'goal is cell {to}: no way leads to it from cell {start}')
    if least > max_steps:
        raise ValueError(
            f'goal is cell {to}, {least} steps from cell {start}: at most max_steps = '
            f'{max_steps} are allowed; raise max_steps or choose a nearer cell'
        )


class Trusted(NamedTuple):
    """A told number that a decision trusts, and what it would state with another one."""

    # The number, and 1.5 times or two thirds of it, within [0, 1].
    value: float
    other: float
    # `p_free` and `survival` of the decision with the other number.
    p_free: float
    survival: float


@dataclass(frozen=True, eq=False)
class Decision:
    """
    A decision on a goal, given all deployments so far.

    Attributes
    ----------
    goal : str
        'lane', 'area', or a goal of another package.
    p_free : float
        Probability that none of `cells` has a hazard, in [0, 1].
    cells : ndarray of int, shape (cells,)
        Cells of the goal.
    error : float
        Standard error of `p_free` by the finite number of draws or of particles; 0 if exact.
    path : ndarray of int, shape (steps + 1,)
        Lane, one way, from the base to the goal; empty for other goals.
    survival : float
        Probability that a robot survives `path`, in [0, 1]; NaN for other goals.
    hazards_mean : float
        Expected number of hazards in `cells`.
    hazards_5, hazards_95 : int
        5 % and 95 % quantiles of the number of hazards in `cells`.
    reached : bool
        Whether the requested confidence is reached; False if none is requested.
    reason : str
        Why the confidence is not reached; empty if it is.
    told : mapping of str to Trusted
        Numbers that the decision trusts without having learnt them, by name in `Unknowns`, each
        with what the decision would state with another one; computed once the goal is reached.

    """

    goal: str
    p_free: float
    cells: Path
    error: float
    path: Path
    survival: float
    hazards_mean: float
    hazards_5: int
    hazards_95: int
    reached: bool
    reason: str
    told: Mapping[str, Trusted] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def trusts(self) -> list[str]:
        """Return a sentence on each number that the decision trusts."""
        sentences = []
        for name, (value, other, p_free, survival) in self.told.items():
            of_path = abs(survival - self.survival) > abs(p_free - self.p_free)
            what, then = ('survival', survival) if of_path else ('the probability', p_free)
            sentences.append(
                f'trusts the {name.replace("_", " ")} that you set, {value:.3g}: with '
                f'{other:.2g} {what} is {then:.{2 if then < 0.99 else 4}f}'
            )
        return sentences

    @classmethod
    def about(
        cls,
        goal: str,
        draws: Hazards,
        cells: ArrayLike,
        confidence: float | None,
        path: ArrayLike = (),
        survival: float = nan,
    ) -> Decision:
        """Return the decision on whether `cells`, such as the cells of `path`, are free."""
        count = draws.hazard_count(cells)
        low, high = np.searchsorted(np.cumsum(count), np.array([0.05, 0.95]) - 1e-12).tolist()
        decision = cls(
            goal=goal,
            p_free=draws.p_free(cells),
            cells=read_only(np.unique(cells)),
            error=draws.error(cells),
            path=read_only(np.array(path, dtype=np.intp)),
            survival=survival,
            hazards_mean=float(count @ np.arange(count.size)),
            hazards_5=low,
            hazards_95=high,
            reached=False,
            reason='',
        )
        return decision.judged(confidence)

    def judged(self, confidence: float | None) -> Decision:
        """Return the decision with `reached` and `reason` for another confidence."""
        if confidence is None:
            reason = 'no confidence is asked for'
        elif self.p_free < confidence:
            reason = (
                f'free of hazards with probability {self.p_free:.3f}: {confidence} is asked for'
            )
        elif self.error > (1.0 - confidence) / 2.0:
            reason = (
                f'the standard error of the probability is {self.error:.2g}: a confidence of '
                f'{confidence} takes at most half of the rest, {(1.0 - confidence) / 2.0:.2g}'
            )
        else:
            reason = ''
        return replace(self, reached=not reason, reason=reason)


def check_confidence(confidence: float | None) -> None:
    """Check a confidence."""
    if confidence is not None:
        wanted = 'between 0 and 1, both excluded'
        number('confidence', confidence, wanted, lambda c: 0.0 < c < 1.0)
