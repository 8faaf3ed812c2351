# SPDX-License-Identifier: Apache-2.0
"""
The allocations: how robots that leave together share the work.

An allocation takes the robots, in their order, and returns a path for each of them and, if it
divides the field, the regions. Robots of one kind are one and the same object. A new one is one
file and one line here, or an entry point of another package.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

from kbnitp_ros.core.planning.teams import greedy, independent, voronoi
from kbnitp_ros.core.planning.teams.regions import Regions
from kbnitp_ros.core.planning.teams.team_member import TeamMember
from kbnitp_ros.plugins import Registry, takes
import numpy as np
from numpy.typing import NDArray

Allocation = Callable[[Sequence[TeamMember]], tuple[list[NDArray[np.intp]], Regions | None]]


def as_allocation(given: object) -> Allocation:
    """Return an allocation that is to be registered."""
    takes(given, ('robots',))
    return cast(Allocation, given)


ALLOCATIONS = Registry(
    'allocation',
    as_allocation,
    {
        'independent': independent.allocate,
        'voronoi': voronoi.allocate,
        'greedy': greedy.allocate,
    },
)


def allocated(
    allocation: str | Callable[..., Any], robots: Sequence[TeamMember]
) -> tuple[list[NDArray[np.intp]], Regions | None]:
    """Return a path for each robot, and the regions if the allocation divides the field."""
    with ALLOCATIONS.blamed(allocation):
        paths, regions = ALLOCATIONS.find(allocation)(robots)
        if allocation not in ALLOCATIONS.own:
            _check_allocated(allocation, robots, paths, regions)
    return paths, regions


def _check_allocated(
    allocation: str | Callable[..., Any],
    robots: Sequence[TeamMember],
    paths: Sequence[NDArray[np.intp]],
    regions: Regions | None,
) -> None:
    """Refuse what another package's allocation may not return."""
    if len(paths) != len(robots):
        raise ALLOCATIONS.fault(allocation, f'returns {len(paths)} paths for {len(robots)} robots')
    for number, (robot, path) in enumerate(zip(robots, paths)):
        try:
            robot.finder.check_path(path)
        except ValueError as error:
            words = f'returns a path for robot {number} that is none: {error}'
            raise ALLOCATIONS.fault(allocation, words) from error
    cells = robots[0].finder.grid.cells
    if regions is not None and regions.owner.shape != (cells,):
        words = f'divides {regions.owner.size} cells where the field has {cells}'
        raise ALLOCATIONS.fault(allocation, words)
