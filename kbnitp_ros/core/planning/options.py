# SPDX-License-Identifier: Apache-2.0
"""Options of a search for paths."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any

from kbnitp_ros.core.field.check import (
    cells_or_mask,
    check_word,
    cost,
    number,
    probability,
    whole_number,
)
from kbnitp_ros.core.field.sensor import RobotType
from kbnitp_ros.plugins import parameter_names, Registry, takes
import numpy as np
from numpy.typing import NDArray

# The objectives.
OBJECTIVES = ('information', 'information_per_loss')


def as_planner(given: Any) -> Callable[..., list[Any]]:
    """Return a planner that takes a finder and an objective, and its generator from the finder."""
    if not callable(given) or 'rng' not in parameter_names(given):
        return takes(given, ('finder', 'objective'))  # type: ignore[no-any-return]
    planner = takes(given, ('finder', 'objective', 'rng'))

    @wraps(planner, updated=())
    def with_rng(finder: Any, objective: Any) -> Any:
        return planner(finder, objective, rng=finder.generator(objective))

    return with_rng


# The package's planners are registered in planners.py.
PLANNERS: Registry[Callable[..., list[Any]]] = Registry(
    'planner',
    as_planner,
    {},
)


def as_tuples(values: Any) -> Any:
    """Return lists as nested tuples, which can be compared and hashed."""
    return tuple(map(as_tuples, values)) if isinstance(values, list) else values


@dataclass(frozen=True)
class SearchOptions:
    """
    Options of a search for paths.

    Parameters
    ----------
    planner : str or callable
        One of `PLANNERS`, or a function of a `PathFinder` and an objective that returns a list of
        `Candidate`, the best first. If it has a parameter `rng`, it gets the mission's generator;
        without a mission, one that is seeded by the belief and the visits. 'relaxed' keeps the
        best label of each cell and step; 'beam' keeps several. Baselines, which seek no
        information: 'random' draws a closed walk, 'coverage' sweeps the field row by row, starting
        where earlier paths ended, and 'shortest_unvisited' goes from one least visited cell to the
        nearest other one.
    max_steps : int
        Maximum steps of a path, at least 1.
    width : int
        Width of the beam, at least 1: 'beam' keeps `width` / 4 labels (partial paths) for each
        cell and step, and at least 2, since with one it is 'relaxed'.
    max_visits : int
        Maximum visits of a path to a cell, at least 1.
    objective : str
        'information', or 'information_per_loss', for the ratio of information to the expected
        number of lost robots.
    loss_cost : float
        The cost of a lost robot, nats of information, at least 0.
    minimum_survival : float
        Minimum chance in [0, 1] that a robot survives its path.
    max_distance : float
        Maximum length of a path, metres, at least 0; 0 for no limit. A diagonal step is sqrt(2)
        times as long as a straight step, and a stay has no length. Baselines do not support it.
    keepout : iterable of int or array_like of bool
        Cells that no robot may enter, in addition to blocked cells: cell numbers, or a mask of
        shape (cells,) or (height, width).

    Raises
    ------
    ValueError
        If the planner or the objective is unknown, or a number is out of range.

    """

    planner: str | Callable[..., Any] = 'beam'
    max_steps: int = 18
    width: int = 16
    max_visits: int = 3
    objective: str = 'information'
    loss_cost: float = 0.0
    minimum_survival: float = 0.0
    max_distance: float = 0.0
    keepout: Iterable[int] | NDArray[np.bool_] = ()

    def __post_init__(self) -> None:
        PLANNERS.find(self.planner)
        for name in ('max_steps', 'max_visits'):
            object.__setattr__(self, name, whole_number(name, getattr(self, name), 1))
        wanted = 'a whole number at least 1: beam keeps width / 4 labels of each cell and step'
        width = number('width', self.width, wanted, lambda n: n >= 1 and n == n // 1)
        object.__setattr__(self, 'width', int(width))
        keepout = np.asarray(cells_or_mask('keepout', self.keepout))
        object.__setattr__(self, 'keepout', as_tuples(keepout.tolist()))
        for name in ('max_distance', 'loss_cost'):
            object.__setattr__(self, name, cost(name, getattr(self, name)))
        survival = probability('minimum_survival', self.minimum_survival)
        object.__setattr__(self, 'minimum_survival', survival)
        check_word('objective', self.objective, OBJECTIVES)
        if self.objective == 'information_per_loss' and self.loss_cost:
            raise ValueError(
                f'loss_cost is {self.loss_cost}, and the objective information_per_loss finds it '
                'by itself: leave loss_cost at 0, or choose objective information'
            )

    @property
    def labels(self) -> int:
        """Return the number of labels of each cell and step that 'beam' keeps."""
        return max(2, self.width // 4)

    def of_type(self, robot_type: RobotType) -> SearchOptions:
        """Return the options with the values that a robot type sets."""
        own = {name: own for name, own in robot_type.own.items() if name in vars(self)}
        return replace(self, **own) if own else self
