# SPDX-License-Identifier: Apache-2.0
"""Losses of which it is known how well each step fits, in the chains of a sampler."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.field import compiled, inlined
import numpy as np
from numpy.typing import NDArray

# The chance of a loss is never less than this, so that a chain finds out of states that explain it
# not at all; nothing is subtracted in it.
LEAST_FIT = 1e-100
# Products are divided before they leave the range of floating point.
LARGE = 1e300


class LocatedGraph(NamedTuple):
    """The losses of which it is known how well each step fits."""

    # Shape (cells + 1,). Those through cell i are ``loss[first_entry[i]:first_entry[i + 1]]``.
    first_entry: NDArray[np.int32]
    # Shape (entries,). A loss, and its first and last steps into the cell.
    loss: NDArray[np.int32]
    first: NDArray[np.int32]
    last: NDArray[np.int32]
    # Shape (losses + 1,). The steps of loss a are those from ``first_step[a]`` to ``first_step[a +
    # 1] - 1``.
    first_step: NDArray[np.int32]
    # Shape (losses,). Of the robot.
    robot_type: NDArray[np.int32]
    # Shape (steps,). The cell that each step leads to.
    cell: NDArray[np.int32]
    # Shape (steps,). How well a loss in each step fits what was observed.
    lost_at: NDArray[np.float64]


class LocatedSums(NamedTuple):
    """Sums of one chain over the steps before and after each step of the located losses."""

    # Shape (steps,). Chance of the loss in the steps before this one, each by how well it fits.
    before: NDArray[np.float64]
    # Shape (steps,). Chance to survive the steps before this one.
    reached: NDArray[np.float64]
    # Shape (steps,). Chance of the loss from this step on, of a robot that reaches it.
    rest: NDArray[np.float64]
    # Shape (types, 2). s_z of one step, by robot type.
    survival: NDArray[np.float64]


@compiled
def new_sums(located: LocatedGraph, robot_types: int) -> LocatedSums:
    """Return the sums of one chain, not found yet."""
    steps = located.cell.size
    return LocatedSums(
        np.empty(steps), np.empty(steps), np.empty(steps), np.empty((robot_types, 2))
    )


@inlined
def sum_steps(
    sums: LocatedSums, located: LocatedGraph, hazardous: NDArray[np.int8], path: int
) -> None:
    """Find the sums of a located loss by the hazards of a chain (equation :eq:`loss-located`)."""
    survival = sums.survival[located.robot_type[path]]
    first, end = located.first_step[path], located.first_step[path + 1]
    before, reached = 0.0, 1.0
    for step in range(first, end):
        survived = survival[hazardous[located.cell[step]]]
        sums.before[step], sums.reached[step] = before, reached
        before += reached * located.lost_at[step] * (1.0 - survived)
        reached *= survived
    rest = 0.0
    for step in range(end - 1, first - 1, -1):
        survived = survival[hazardous[located.cell[step]]]
        rest = located.lost_at[step] * (1.0 - survived) + survived * rest
        sums.rest[step] = rest


@compiled
def sum_all_steps(
    sums: LocatedSums,
    located: LocatedGraph,
    hazardous: NDArray[np.int8],
    endured: NDArray[np.float64],
    spared: NDArray[np.float64],
) -> None:
    """Find the sums of all located losses by the hazards and the rates of a chain."""
    sums.survival[:, 0] = endured
    sums.survival[:, 1] = endured * spared
    for path in range(located.robot_type.size):
        sum_steps(sums, located, hazardous, path)


@inlined
def located_chance(
    sums: LocatedSums,
    located: LocatedGraph,
    hazardous: NDArray[np.int8],
    entry: int,
    hazard: int,
) -> float:
    """Return the chance of a located loss if the cell of an entry had this hazard."""
    path, first, last = located.loss[entry], located.first[entry], located.last[entry]
    survival, cell = sums.survival[located.robot_type[path]], located.cell[first]
    rest = sums.rest[last + 1] if last + 1 < located.first_step[path + 1] else 0.0
    for step in range(last, first - 1, -1):
        visited = located.cell[step]
        survived = survival[hazard if visited == cell else hazardous[visited]]
        rest = located.lost_at[step] * (1.0 - survived) + survived * rest
    return float(max(sums.before[first] + sums.reached[first] * rest, LEAST_FIT))


@compiled
def sum_through(
    sums: LocatedSums, located: LocatedGraph, hazardous: NDArray[np.int8], cell: int
) -> None:
    """Find the sums of the located losses through a cell again."""
    for entry in range(located.first_entry[cell], located.first_entry[cell + 1]):
        sum_steps(sums, located, hazardous, located.loss[entry])


@compiled
def located_ratio(
    sums: LocatedSums,
    located: LocatedGraph,
    hazardous: NDArray[np.int8],
    cell: int,
    hazard: int,
    ratio: float,
) -> float:
    """Return `ratio` times that of the chances with this hazard in a cell and with the other."""
    for entry in range(located.first_entry[cell], located.first_entry[cell + 1]):
        now = located_chance(sums, located, hazardous, entry, hazard)
        other = located_chance(sums, located, hazardous, entry, 1 - hazard)
        ratio = min(ratio * (now / other), LARGE)
    return ratio


@compiled
def weigh_by_located(
    hazardous: NDArray[np.int8],
    located: LocatedGraph,
    safe: NDArray[np.float64],
    exposed: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> None:
    """Weigh numbers by the located losses (:eq:`loss-located`)."""
    rest = np.empty(likelihood.shape[1])
    for chain in range(likelihood.shape[0]):
        own = likelihood[chain]
        for path in range(located.robot_type.size):
            robot_type = located.robot_type[path]
            rest[:] = 0.0
            for step in range(located.first_step[path + 1] - 1, located.first_step[path] - 1, -1):
                if hazardous[chain, located.cell[step]]:
                    survived = exposed[chain, robot_type]
                else:
                    survived = safe[chain, robot_type]
                weight = located.lost_at[step]
                for value in range(rest.size):
                    alive = survived[value]
                    rest[value] = weight * (1.0 - alive) + alive * rest[value]
            largest = 0.0
            for value in range(rest.size):
                own[value] *= max(rest[value], LEAST_FIT)
                largest = max(largest, own[value])
            for value in range(rest.size):
                own[value] /= largest
