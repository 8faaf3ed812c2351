# SPDX-License-Identifier: Apache-2.0
"""The plan of the next deployment."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field import Belief, frozen, Grid, SensorModel
from kbnitp_ros.core.planning.information import path_information, path_log_survival
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.planners import PathFinder, sought_by
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Plan:
    """
    A path for one robot and what is expected of it.

    Attributes
    ----------
    path : ndarray of int, shape (steps + 1,)
        Cells, the base first and last.
    information : float
        `path_information`, nats.
    survival : float
        Predicted chance that the robot returns, in [0, 1].

    """

    path: NDArray[np.intp]
    information: float
    survival: float

    def __post_init__(self) -> None:
        frozen(self.path)

    @classmethod
    def along(cls, path: NDArray[np.intp], belief: Belief, model: SensorModel) -> Plan:
        """Return the plan to take `path`, shape (steps + 1,)."""
        survival = float(np.exp(path_log_survival(belief, model, path)))
        return cls(path, path_information(belief, model, path), survival)


def plan(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    max_steps: int,
    planner: str = 'beam',
    *,
    width: int = 16,
    max_visits: int = 3,
    loss_cost: float = 0.0,
    visited: ArrayLike = (),
    objective: str = 'information',
    alpha: float = 1.0,
) -> Plan:
    """
    Plan the next deployment: a closed path of much information.

    What is sought is the most of information - loss_cost * (1 - survival).

    Parameters
    ----------
    grid : Grid
        The field.
    belief : Belief
        What is believed of it.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    max_steps : int
        The most steps the path may have, at least 1.
    planner : str
        'relaxed' keeps the best label of each cell and step, 'beam' the best `width`. The others
        seek no information, and are there to be compared with: 'random' draws a closed walk,
        'coverage' ploughs the field where earlier paths left off, and 'shortest_unvisited' goes to
        the nearest cell that was visited least, and on to the next.
    width : int
        Labels the beam keeps for each cell and step, at least 1.
    max_visits : int
        How often the path may enter a cell, at least 1.
    loss_cost : float
        How much information a lost robot is worth, nats, at least 0.
    visited : array_like of int, shape (cells,), optional
        How often the paths of earlier deployments entered each cell, for the planners that go by
        it; never unless given.
    objective : str
        What is sought: 'information', or 'behavioral', `behavioral_information` in its place.
    alpha : float
        Of the Prelec weight of the behavioral objective, from 0.2 to 5; with 1 it is the
        information.

    Returns
    -------
    Plan
        The same belief, with the same visits, gives the same plan.

    Raises
    ------
    ValueError
        If the planner or the objective is unknown, the planner seeks none, a number is out of
        range, or the belief has another number of cells than the grid.

    """
    finder = PathFinder(grid, planner, max_steps, width, max_visits, np.asarray(visited))
    sought = sought_by(planner, objective, alpha)
    best = finder.paths(Objective.alone(grid, belief, model, loss_cost, sought))[0]
    return Plan.along(best.path, belief, model)
