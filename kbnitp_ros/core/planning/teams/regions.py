# SPDX-License-Identifier: Apache-2.0
"""The field within reach divided into regions of about equal entropy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kbnitp_ros.core.field import frozen, Grid, Value
import numpy as np
from numpy.typing import NDArray

# More sweeps over the regions change next to nothing.
SWEEPS = 50

# By how much the sites are turned about their base, radians: no border then runs along a row or a
# diagonal, and cells cross it one by one.
TURN = 0.05


@dataclass(frozen=True, eq=False, repr=False)
class Regions(Value):
    """
    A partition of the cells that robots can visit and come back from.

    Attributes
    ----------
    owner : ndarray of int, shape (cells,)
        The region of each of these cells, from 0; -1 elsewhere.
    entropy : ndarray, shape (regions,)
        What each region holds of what was shared out, nats.

    """

    owner: NDArray[np.intp]
    entropy: NDArray[np.float64]

    def __post_init__(self) -> None:
        frozen(self.owner)
        frozen(self.entropy)

    @property
    def imbalance(self) -> float:
        """How far the fullest region is above the mean, as a part of the mean: 0 when even."""
        mean = self.entropy.mean()
        return float(self.entropy.max() / mean - 1.0) if mean > 0.0 else 0.0


def divide(
    grids: Sequence[Grid],
    cells: NDArray[np.intp],
    entropy: NDArray[np.float64],
    reach: NDArray[np.bool_],
) -> Regions:
    """
    Divide cells into the regions of a power diagram that hold about the same entropy.

    Equation :eq:`power-diagram`.

    A cell belongs to the site r of least |cell - site r|^2 - weight r, of those that reach it.
    Robots come from their bases, so the sites are the centres of sectors around each base, of the
    cells that are fewer steps from it than from the others; one after the other gets the weight at
    which its region holds an even share, until none changes, and the evenest of the divisions on
    the way is returned.
    """
    width, parts = grids[0].width, reach.shape[1]
    row, col = np.divmod(cells, width)
    base_row, base_col = np.divmod([grid.base for grid in grids], width)
    start = (base_col - base_col[0]) + 1j * (base_row - base_row[0])
    place = (col - base_col[0]) + 1j * (row - base_row[0])
    sites = np.empty(parts, dtype=np.complex128)
    steps = np.array([grid.steps_to_base[cells] for grid in grids])
    nearest = start[np.where(reach.T, steps, grids[0].cells).argmin(axis=0)]
    for at in dict.fromkeys(start.tolist()):
        own, near = start == at, nearest == at
        centres = _sector_centres(place[near] - at, entropy[near], own.sum())
        sites[own] = at + centres * np.exp(1j * TURN)
    distance = np.where(reach, np.abs(place[:, None] - sites) ** 2, np.inf)
    weight = np.zeros(parts)
    share = entropy.sum() / parts
    best = _regions(distance, entropy)
    for _ in range(SWEEPS if parts > 1 else 0):
        before = weight.copy()
        for site in range(parts):
            others = np.delete(distance - weight, site, axis=1).min(axis=1)
            weight[site] = _weight_for(share, distance[:, site] - others, entropy)
        found = _regions(distance - weight, entropy)
        if found.imbalance < best.imbalance:
            best = found
        if np.array_equal(weight, before):
            break
    owner = np.full(grids[0].cells, -1)
    owner[cells] = best.owner
    return Regions(owner, best.entropy)


def _sector_centres(
    place: NDArray[np.complex128], mass: NDArray[np.float64], parts: int
) -> NDArray[np.complex128]:
    """Return the centres of mass of sectors around 0 of about equal mass; 0 for empty ones."""
    order = np.argsort(np.angle(place), kind='stable')
    middle = np.cumsum(mass[order]) - mass[order] / 2.0
    sector = np.empty(len(mass), dtype=np.intp)
    sector[order] = np.minimum(parts * middle / max(mass.sum(), 1e-300), parts - 1)
    of_sector = (sector == np.arange(parts)[:, None]) * mass
    total = of_sector.sum(axis=1)
    centres: NDArray[np.complex128] = of_sector @ place / np.where(total > 0.0, total, 1.0)
    return centres


def _weight_for(share: float, margin: NDArray[np.float64], mass: NDArray[np.float64]) -> float:
    """
    Return the weight above whose margins lie cells of about `share` in all.

    Those that no other site reaches, of margin -inf, are among them whatever the weight.
    """
    share -= float(mass[margin == -np.inf].sum())
    is_open = np.isfinite(margin)
    margin, mass = margin[is_open], mass[is_open]
    if not margin.size:
        return 0.0
    order = np.argsort(margin, kind='stable')
    held = np.concatenate([[0.0], np.cumsum(mass[order])])
    taken = int(np.abs(held - share).argmin())
    edges = np.concatenate([margin[order[:1]] - 1.0, margin[order], margin[order[-1:]] + 1.0])
    return float((edges[taken] + edges[taken + 1]) / 2.0)


def _regions(power: NDArray[np.float64], mass: NDArray[np.float64]) -> Regions:
    """Return who owns each place, shape (places, parts), and what each region holds."""
    owner = power.argmin(axis=1)
    held = np.bincount(owner, mass, power.shape[1]).astype(np.float64)
    return Regions(owner, held)
