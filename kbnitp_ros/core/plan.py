# SPDX-License-Identifier: Apache-2.0
"""The plan of the next deployment."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.belief import Belief
from kbnitp_ros.core.check import frozen, whole_number
from kbnitp_ros.core.grid import Grid
from kbnitp_ros.core.information import path_information
from kbnitp_ros.core.observation import Visits
from kbnitp_ros.core.planners import PLANNERS
from kbnitp_ros.core.sensor import SensorModel
from kbnitp_ros.core.survival import log_predicted_survival
import numpy as np
from numpy.typing import NDArray


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


def plan(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    max_steps: int,
    planner: str = 'beam',
    *,
    width: int = 16,
    max_visits: int = 3,
) -> Plan:
    """
    Plan the next deployment: a closed path of much information.

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
        'relaxed' keeps the best label of each cell and step, 'beam' the best `width`.
    width : int
        Labels the beam keeps for each cell and step, at least 1.
    max_visits : int
        How often the path may enter a cell, at least 1.

    Returns
    -------
    Plan
        The same belief gives the same plan.

    Raises
    ------
    ValueError
        If the planner is unknown, a number is out of range, or the belief has another number of
        cells than the grid.

    """
    if planner not in PLANNERS:
        raise ValueError(f'planner is {planner!r}: known are {", ".join(PLANNERS)}')
    if belief.cells != grid.cells:
        raise ValueError(f'belief has {belief.cells} cells: the grid has {grid.cells}')
    path = PLANNERS[planner](
        grid,
        belief,
        model,
        whole_number('max_steps', max_steps, 1),
        whole_number('width', width, 1),
        whole_number('max_visits', max_visits, 1),
    )
    visits = Visits.of(path)
    survival = log_predicted_survival(
        belief.hazard[visits.cells], visits.counts, model.log_survival
    )
    return Plan(path, path_information(belief, model, path), float(np.exp(survival.sum())))
