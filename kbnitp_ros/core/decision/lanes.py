# SPDX-License-Identifier: Apache-2.0
"""Ways from one cell to another, and the safest of them."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.decision.hazard_draws import cells_on, Floats, HazardDraws, Path
from kbnitp_ros.core.field import Grid, SensorModel, whole_number
import numpy as np

# How many lanes are compared, besides the one of least cost by the cells' own probabilities.
LANES = 48
# The spread of the logarithms of the scales of their costs.
SCALE = 0.7
# Draws that a lane is sought in together, so that it knows which hazards go together.
TOGETHER = 16
# What a step costs besides its hazards: of lanes as free the shortest is taken.
STEP_COST = 1e-4
# The logarithm of the least probability that a cell is free counts as no less than this.
LEAST = -30.0
# Values closer than this many decimals are ties, so rounding never decides.
DECIMALS = 9


@dataclass(frozen=True, eq=False)
class SafestPath:
    """
    The safest path found.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        From the one cell to the other.
    p_free : float
        Probability that no cell of it has a hazard, in [0, 1].
    survival : float
        Probability that a traveller survives it, in [0, 1].

    """

    path: Path
    p_free: float
    survival: float


def cheapest_lanes(grid: Grid, costs: Floats, start: int, to: int, max_steps: int) -> list[Path]:
    """
    Return a cheapest way for each of several costs.

    Parameters
    ----------
    grid : Grid
        The field.
    costs : ndarray, shape (lanes, cells)
        Of each step into a cell, at least 0.
    start, to : int
        Its first and its last cell, which is in reach.
    max_steps : int
        The most steps that it may have.

    Returns
    -------
    list of ndarray of int, each of shape (steps + 1,)

    """
    lanes = np.arange(len(costs))
    from_cells = grid.neighbor_table.T
    entered = np.pad(costs, ((0, 0), (0, 1)), constant_values=np.inf)
    best = np.full(entered.shape, np.inf)
    best[:, start] = 0.0
    at_goal = [best[:, to]]
    came_by = []
    for _ in range(min(max_steps, grid.cells - 1)):
        ways = best[:, from_cells]
        by = ways.argmin(axis=1)
        best = np.take_along_axis(ways, by[:, None], axis=1)[:, 0]
        best = np.pad(best, ((0, 0), (0, 1)), constant_values=np.inf) + entered
        came_by.append(by.astype(np.int8))
        at_goal.append(best[:, to])
    steps = np.argmin(at_goal, axis=0)
    paths = []
    for lane in lanes.tolist():
        path = [to]
        for step in range(int(steps[lane]) - 1, -1, -1):
            path.append(int(from_cells[came_by[step][lane, path[-1]], path[-1]]))
        paths.append(np.array(path[::-1], dtype=np.intp))
    return paths


def lanes_between(
    grid: Grid, draws: HazardDraws, start: int, to: int, max_steps: int, count: int = LANES
) -> list[Path]:
    """
    Return different ways that may be the safest, the same again for the same draws.

    The first costs least by the probability that each cell is free. The others cost least with
    these costs scaled at random, one half of them with probabilities of a few draws only.
    """
    free = 1.0 - draws.p_hazard()
    rng = np.random.default_rng(len(draws.hazardous))
    some = rng.choice(len(draws.hazardous), (count // 2, TOGETHER), p=draws.weight)
    free_in_some = 1.0 - draws.hazardous[some].mean(axis=1)
    probability = np.concatenate(
        [
            np.tile(free, (1 + count - count // 2, 1)),
            (TOGETHER * free_in_some + free) / (TOGETHER + 1.0),
        ]
    )
    with np.errstate(divide='ignore'):
        cost = -np.log(probability).clip(min=LEAST) + STEP_COST
    cost[1:] *= np.exp(SCALE * rng.standard_normal(cost[1:].shape))
    found = {path.tobytes(): path for path in cheapest_lanes(grid, cost, start, to, max_steps)}
    return list(found.values())


def there_and_back(out: Path, back: Path) -> Path:
    """Return the path to the end of one lane, and from there along another one in reverse."""
    return np.concatenate([out, back[-2::-1]])


def safest_path(
    grid: Grid, draws: HazardDraws, model: SensorModel, start: int, to: int, max_steps: int
) -> SafestPath:
    """
    Return the way that is most probably free of hazards.

    It is the best that was found; its probabilities are exact over the draws.

    Parameters
    ----------
    grid : Grid
        The field.
    draws : HazardDraws
        What is known of the hazards.
    model : SensorModel
        What the traveller is believed to be like.
    start, to : int
        The first and the last cell.
    max_steps : int
        The most steps of a path, at least 1.

    Raises
    ------
    ValueError
        If a cell is off the map or on an obstacle, or there is no such path.

    """
    check_way(grid, start, to, max_steps)
    paths = lanes_between(grid, draws, start, to, max_steps)
    best = int(np.argmax(np.round(draws.are_free(paths) @ draws.weight, DECIMALS)))
    return SafestPath(paths[best], draws.p_free(paths[best]), draws.survival(paths[best], model))


def check_way(grid: Grid, start: int, to: int, max_steps: int) -> None:
    """
    Check that a cell can be reached from another one.

    Raises
    ------
    ValueError
        If a cell is off the map or on an obstacle, or there is no such path.

    """
    cells_on(grid, [start], 'start')
    cells_on(grid, [to], 'goal')
    whole_number('max_steps', max_steps, 1)
    least = int(grid.steps_from(start, grid.free)[to])
    if least >= grid.cells:
        raise ValueError(f'goal is cell {to}, to which no way leads from cell {start}')
    if least > max_steps:
        raise ValueError(
            f'goal is cell {to}, {least} steps from cell {start}: at most max_steps = '
            f'{max_steps} may be; raise max_steps or choose a nearer cell'
        )
