# SPDX-License-Identifier: Apache-2.0
"""Draws of the numbers that are not known, for many chains side by side."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.field import compiled
from kbnitp_ros.core.inference.sampling.gibbs_kernels import lost
import numpy as np
from numpy.typing import NDArray

# How many losses may be multiplied up before products are divided.
OFTEN = 6


class LossSurvival(NamedTuple):
    """The chance to survive each lost path as a product of two, of which a rate changes one."""

    # Shape (chains, losses). The chance that the rate has nothing to do with.
    fixed: NDArray[np.float64]
    # Shape (chains, losses). The row of the other.
    place: NDArray[np.int32]
    # Shape (places, values). The other for each value of the rate.
    by_rate: NDArray[np.float64]


@compiled
def draw_values(
    weights: NDArray[np.float64], uniform: NDArray[np.float64], place: NDArray[np.intp]
) -> None:
    """Draw the place of each chain by its `weights`, (chains, values), and normalise these."""
    for chain in range(weights.shape[0]):
        own = weights[chain]
        total = 0.0
        for value in range(own.size):
            total += own[value]
        sought, below, drawn = uniform[chain] * total, 0.0, 0
        for value in range(own.size):
            below += own[value]
            if below <= sought:
                drawn = value + 1
            own[value] /= total
        place[chain] = min(drawn, own.size - 1)


@compiled
def weigh_by_losses(survival: LossSurvival, likelihood: NDArray[np.float64]) -> None:
    r"""
    Multiply `likelihood`, (chains, values), by that of all losses, for each value of a rate.

    Equation :eq:`rate-conditional`.
    """
    for chain in range(likelihood.shape[0]):
        own = likelihood[chain]
        for path in range(survival.fixed.shape[1]):
            fixed = survival.fixed[chain, path]
            by_rate = survival.by_rate[survival.place[chain, path]]
            for value in range(own.size):
                own[value] *= lost(fixed * by_rate[value])
            if path % OFTEN == OFTEN - 1:
                largest = 0.0
                for value in range(own.size):
                    largest = max(largest, own[value])
                for value in range(own.size):
                    own[value] /= largest


@compiled
def sum_of_cells(
    chosen: NDArray[np.bool_], table: NDArray[np.float64], total: NDArray[np.float64]
) -> None:
    """
    Add to `total`, (chains, values), the rows of `table`, (cells, values), of those chosen.

    Equation :eq:`map-conditional`.
    """
    for chain in range(chosen.shape[0]):
        for cell in range(chosen.shape[1]):
            if chosen[chain, cell]:
                for value in range(table.shape[1]):
                    total[chain, value] += table[cell, value]
