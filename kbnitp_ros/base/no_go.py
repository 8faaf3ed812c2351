# SPDX-License-Identifier: Apache-2.0
"""No-go areas: cells that no robot is sent into, whatever the grid says of them."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from kbnitp_ros.core import Area, Goal, Grid
from kbnitp_ros.core.planning.regions import without


def open_grid(grid: Grid, no_go: Collection[int], goal: Goal | None, max_steps: int) -> Grid:
    """Return the grid on which decisions are made; raise ValueError if no way to the goal is."""
    left = without(grid, no_go)
    # An area is certified cell by cell, wherever robots may go.
    if goal is not None and not isinstance(goal, Area):
        goal.check(left, max_steps)
    return left


def changed_no_go(
    grid: Grid, before: Iterable[int], cells: Iterable[int], *, lift: bool
) -> tuple[int, ...]:
    """Return the no-go cells after some are added or lifted; raise ValueError if impossible."""
    known, given = {*before}, {*cells}
    if not given:
        raise ValueError('cells is empty: name at least one cell')
    if max(given) >= grid.cells:
        raise ValueError(f'cells has {max(given)}, off the map: allowed are 0 to {grid.cells - 1}')
    if lift:
        if strange := given - known:
            raise ValueError(f'cells has {min(strange)}, which is in no no-go area')
        return tuple(sorted(known - given))
    if bases := given & grid.bases:
        raise ValueError(f'cells has {min(bases)}, a base: robots start and end there')
    if given <= known:
        raise ValueError('all cells are in a no-go area already')
    left = without(grid, known | given)
    for base in sorted(grid.bases):
        # A cell is its own neighbour, since a robot may stay.
        if left.neighbors(base).size < 2:
            raise ValueError(
                f'no robot could leave the base {base}: pause the mission by the service pause'
            )
    return tuple(sorted(known | given))
