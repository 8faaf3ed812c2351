# SPDX-License-Identifier: Apache-2.0
"""The plan of the next deployment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import frozen, typed, Value
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.sensor import SensorModel
from kbnitp_ros.core.planning.bound import check_bound, upper_bound
from kbnitp_ros.core.planning.information import path_information, path_log_survival
from kbnitp_ros.core.planning.labels import reach_of
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.options import SearchOptions
from kbnitp_ros.core.planning.planners import BASELINES, check_distance, PathFinder
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Value):
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
    upper_bound : float or None
        No path that the search may return has a higher information - loss_cost * (1 - survival),
        nats; None unless a bound was asked for.
    gap : float or None
        How far the plan is below `upper_bound`, nats, at least 0.
    gain : float or None
        How much nearer its goal the mission is expected to be, in the unit of the goal; None
        where there is no goal but information.

    """

    path: NDArray[np.intp]
    information: float
    survival: float
    upper_bound: float | None = None
    gap: float | None = None
    gain: float | None = None

    def __post_init__(self) -> None:
        frozen(self.path)

    @classmethod
    def along(cls, path: NDArray[np.intp], belief: Belief, model: SensorModel) -> Plan:
        """Return the plan to take `path`, shape (steps + 1,)."""
        survival = float(np.exp(path_log_survival(belief, model, path)))
        return cls(path, path_information(belief, model, path), survival)


@typed
def plan(
    grid: Grid,
    belief: Belief,
    model: SensorModel,
    max_steps: int,
    planner: str | Callable[..., Any] = 'beam',
    *,
    visited: ArrayLike = (),
    bound: bool = False,
    **options: Any,
) -> Plan:
    """
    Plan the next deployment: a closed path of high expected information.

    The planner maximises information - loss_cost * (1 - survival).

    Parameters
    ----------
    grid : Grid
        The field.
    belief : Belief
        What is believed of it.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    max_steps, planner, **options
        As of `SearchOptions`.
    visited : array_like of int, shape (cells,), optional
        How often the paths of earlier deployments entered each cell, for the planners that go by
        it; never unless given.
    bound : bool
        Whether the plan has an `upper_bound` and a `gap`. Of the objective 'information' and the
        planners that seek it.

    Returns
    -------
    Plan
        The same belief, with the same visits, gives the same plan.

    Raises
    ------
    ValueError
        If the planner or the objective is unknown, the planner does not seek the objective or keep
        the distance, a number is out of range, the distance allows no step, or the belief has
        another number of cells than the grid; if there is no bound for the objective or the
        planner, or it takes more memory than is allowed.

    """
    search = SearchOptions(planner, max_steps, **options)
    finder = PathFinder(grid, search, np.asarray(visited))
    check_distance(grid, search)
    if bound:
        check_bounded(grid, search)
    return plan_alone(finder, Objective.alone(grid, belief, model, search), bound)


def plan_alone(finder: PathFinder, objective: Objective, bound: bool) -> Plan:
    """Return the plan of a robot that goes alone, with a bound if that is asked for."""
    path = finder.candidates(objective)[0].path
    found = Plan.along(path, objective.belief, objective.model)
    if not bound:
        return found
    above = upper_bound(finder.grid, objective, finder.options, path)
    value = found.information - finder.options.loss_cost * (1.0 - found.survival)
    return replace(found, upper_bound=max(value, above), gap=max(0.0, above - value))


def check_bounded(grid: Grid, options: SearchOptions, robots: int = 1) -> None:
    """Check that plans can have a bound."""
    if options.planner in BASELINES:
        raise ValueError(
            f'planner is {options.planner}, which seeks no information, so its plans have no '
            'bound: choose the planner beam or relaxed, or plan without a bound'
        )
    check_bound(reach_of(grid, options), options, robots)
