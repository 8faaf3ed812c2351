# SPDX-License-Identifier: Apache-2.0
"""
The planners: how each looks for the path of the next deployment.

A planner takes (grid, objective, max_steps, width, max_visits) and returns closed paths, the best
first. A new one is one file and one line here; a label search has another among `LABELS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from kbnitp_ros.core.field import Grid, whole_number
from kbnitp_ros.core.planning.fates import MOST_FATES
from kbnitp_ros.core.planning.labels import best_paths, check_memory, Found
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.reach import Reach
from kbnitp_ros.core.planning.readings import check_cameras, most_counted

Planner = Callable[[Grid, Objective, int, int, int], list[Found]]


def relaxed(
    grid: Grid, objective: Objective, max_steps: int, width: int, max_visits: int
) -> list[Found]:
    """Keep the single best label of each cell and step, whatever `width`: the paper's planner."""
    return best_paths(grid, objective, max_steps, 1, max_visits)


PLANNERS: dict[str, Planner] = {'relaxed': relaxed, 'beam': best_paths}

# How many labels the label searches among them keep, of a width that they are given.
LABELS: dict[str, Callable[[int], int]] = {'relaxed': lambda _: 1, 'beam': lambda width: width}


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

    def check_memory(self, robots: int, cameras: int = 1) -> None:
        """
        Check that paths can be searched for within the memory allowed, before any is.

        Parameters
        ----------
        robots : int
            How many leave together or are out, at least 1.
        cameras : int
            How many different ones they have.

        Raises
        ------
        ValueError
            With an estimate, if it takes more; or if the cameras are too many.

        """
        check_cameras(cameras)
        if labels := LABELS.get(self.planner):
            before = robots - 1
            # As many as there can be, without powers of two that nobody can count.
            fates = 2 ** min(before, MOST_FATES.bit_length() - 1)
            visits = min(self.max_visits, self.max_steps)
            counts = 1 + min(before * visits, most_counted(cameras) or before * visits)
            further = counts ** (cameras - 1) * (counts + visits)
            reach = Reach.of(self.grid, self.max_steps)
            width = labels(self.width)
            check_memory(
                reach, self.max_steps, width, self.max_visits, fates, counts**cameras, further
            )
