# SPDX-License-Identifier: Apache-2.0
"""
The planners: how each looks for the path of the next deployment.

A planner takes (grid, objective, max_steps, width, max_visits) and returns closed paths, the best
first. A new one is one file and one line here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from kbnitp_ros.core.field import Grid, whole_number
from kbnitp_ros.core.planning.labels import best_paths, Found
from kbnitp_ros.core.planning.objective import Objective

Planner = Callable[[Grid, Objective, int, int, int], list[Found]]


def relaxed(
    grid: Grid, objective: Objective, max_steps: int, width: int, max_visits: int
) -> list[Found]:
    """Keep the single best label of each cell and step, whatever `width`: the paper's planner."""
    return best_paths(grid, objective, max_steps, 1, max_visits)


PLANNERS: dict[str, Planner] = {'relaxed': relaxed, 'beam': best_paths}


@dataclass(frozen=True)
class PathFinder:
    """
    A planner on a grid, with the limits of its paths and of its search; arguments as of `plan`.

    Raises
    ------
    ValueError
        If the planner is unknown or a number is out of range.

    """

    grid: Grid
    planner: str
    max_steps: int
    width: int
    max_visits: int

    def __post_init__(self) -> None:
        if self.planner not in PLANNERS:
            raise ValueError(f'planner is {self.planner!r}: known are {", ".join(PLANNERS)}')
        for name in ('max_steps', 'width', 'max_visits'):
            object.__setattr__(self, name, whole_number(name, getattr(self, name), 1))

    def paths(self, objective: Objective) -> list[Found]:
        """Return the closed paths found for an objective, at least one, the best first."""
        planner = PLANNERS[self.planner]
        return planner(self.grid, objective, self.max_steps, self.width, self.max_visits)
