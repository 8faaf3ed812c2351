# SPDX-License-Identifier: Apache-2.0
"""Ways through the grid: paths in legs that can be driven, and ways that nobody planned."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise

from kbnitp_ros.core import Grid

# The cells of one goal, the one that the robot starts in first. A stay is its cell twice.
Leg = tuple[int, ...]


def legs_of(path: Sequence[int]) -> list[Leg]:
    """Return a path in legs that one goal of Nav2 each can drive."""
    # Nav2 counts a goal as reached near its last pose and takes the nearest point of a path for
    # the place of the robot. So no leg enters a cell twice; stays are legs of their own.
    legs: list[Leg] = []
    leg = [path[0]]
    for before, cell in pairwise(path):
        if cell in leg:
            if len(leg) > 1:
                legs.append(tuple(leg))
            leg = [before]
        if cell == before:
            legs.append((cell, cell))
        else:
            leg.append(cell)
    if len(leg) > 1:
        legs.append(tuple(leg))
    return legs


def without_loops(cells: Iterable[int]) -> list[int]:
    """Return a way from the first to the last of these cells that enters none of them twice."""
    way: dict[int, None] = {}
    for cell in cells:
        if cell in way:
            while next(reversed(way)) != cell:
                way.popitem()
        else:
            way[cell] = None
    return list(way)


def steps_within(cells: Sequence[int], most: int) -> list[int]:
    """Return which steps of a walk to tell of, if that may be only so many."""
    # As far as it goes that is the walk; from there the last way out of each cell leads home
    # without loops. A step that is left out is not reported.
    steps = len(cells) - 1
    if steps <= most:
        return list(range(1, steps + 1))
    last = {cell: number for number, cell in enumerate(cells)}
    steps_home = {cells[steps]: 0}
    for number in range(steps - 1, -1, -1):
        if last[cells[number]] == number:
            steps_home[cells[number]] = 1 + steps_home[cells[number + 1]]
    kept = max(number for number in range(most + 1) if number + steps_home[cells[number]] <= most)
    numbers = list(range(1, kept + 1))
    at = last[cells[kept]]
    while at < steps:
        numbers.append(at + 1)
        at = last[cells[at + 1]]
    return numbers


def shortest_way(grid: Grid, start: int, end: int) -> list[int]:
    """Return the cells of a way with the fewest steps, both ends included."""
    came_from = {start: start}
    frontier = deque([start])
    while frontier and end not in came_from:
        cell = frontier.popleft()
        for neighbor in grid.neighbors(cell).tolist():
            if neighbor not in came_from:
                came_from[neighbor] = cell
                frontier.append(neighbor)
    if end not in came_from:
        raise ValueError(f'no way leads from cell {start} to cell {end}')
    way = [end]
    while way[-1] != start:
        way.append(came_from[way[-1]])
    return way[::-1]
