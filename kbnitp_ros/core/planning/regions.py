# SPDX-License-Identifier: Apache-2.0
"""Regions of the field, and cells that a team must avoid."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from kbnitp_ros.core.field.check import Floats, Places
from kbnitp_ros.core.field.grid import Grid
import numpy as np
from numpy.typing import ArrayLike, NDArray


def nested_regions(grid: Grid, path: ArrayLike) -> list[Places]:
    """Return regions around the far end of a path, the largest first."""
    cells = np.unique(path)
    steps = grid.at(int(np.asarray(path)[0])).steps_to_base
    farthest = cells[[np.argmax(steps[cells])]]

    def far(cells: Places) -> Places:
        kept: Places = cells[2 * steps[cells] > steps[farthest]]
        return kept[~np.isin(kept, list(grid.bases))]

    def around(cells: Places) -> Places:
        together: Places = np.unique(grid.neighbor_table[cells])
        return together[together >= 0]

    half = far(cells)
    return [far(around(half)), half, far(around(farthest)), far(farthest)]


def without(grid: Grid, cells: Iterable[int]) -> Grid:
    """Return the grid with these cells blocked."""
    blocked = {*grid.blocked, *map(int, cells)}
    return grid if blocked == grid.blocked else replace(grid, blocked=blocked)


def keepout_cells(
    grid: Grid,
    max_steps: int,
    bases: Sequence[int | None],
    rounds: Sequence[Sequence[ArrayLike]],
    max_distance: float = 0.0,
) -> Places:
    """Return the cells that the next round must avoid, given the operator's refused rounds."""

    def left(cells: Places) -> tuple[int, int]:
        """Return the least number of cells in reach of a base, and the number of any base."""
        open_grid = without(grid, cells)
        in_reach = [
            open_grid.at(base).in_reach(max_steps, max_distance) for base in dict.fromkeys(bases)
        ]
        return min(each.sum() for each in in_reach), np.any(in_reach, axis=0).sum()

    kept: Places = np.empty(0, dtype=np.intp)
    _, in_reach = left(kept)
    for paths in rounds:
        sizes = [
            np.unique(np.concatenate(each))
            for each in zip(*(nested_regions(grid, path) for path in paths))
        ]
        for cells in (*(np.union1d(kept, size) for size in sizes), *sizes, kept[:0]):
            of_one, of_any = left(cells)
            # A base is always in reach of itself.
            if of_any > len(bases) and of_one > 1 and 2 * of_any > in_reach - cells.size:
                break
        kept = cells
    return kept


# Maximum number of sweeps over the regions; further sweeps hardly change them.
SWEEPS = 50

# Rotation of the sites about their base, radians: no border then runs along a row or a diagonal,
# so cells change their region one by one.
TURN = 0.05


def divide(
    grids: Sequence[Grid],
    cells: Places,
    entropy: Floats,
    reach: NDArray[np.bool_],
) -> Places:
    """Return each cell's region, or -1; regions have about equal entropy (:eq:`power-diagram`)."""
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
    best, least = _regions(distance, entropy)
    for _ in range(SWEEPS if parts > 1 else 0):
        before = weight.copy()
        for site in range(parts):
            others = np.delete(distance - weight, site, axis=1).min(axis=1)
            weight[site] = _weight_for(share, distance[:, site] - others, entropy)
        found, excess = _regions(distance - weight, entropy)
        if excess < least:
            best, least = found, excess
        if np.array_equal(weight, before):
            break
    owner = np.full(grids[0].cells, -1)
    owner[cells] = best
    return owner


def _sector_centres(
    place: NDArray[np.complex128], mass: Floats, parts: int
) -> NDArray[np.complex128]:
    """Divide the plane around 0 into sectors of about equal mass; return centres, 0 if empty."""
    order = np.argsort(np.angle(place), kind='stable')
    middle = np.cumsum(mass[order]) - mass[order] / 2.0
    sector = np.empty(len(mass), dtype=np.intp)
    sector[order] = np.minimum(parts * middle / max(mass.sum(), 1e-300), parts - 1)
    of_sector = (sector == np.arange(parts)[:, None]) * mass
    total = of_sector.sum(axis=1)
    centres: NDArray[np.complex128] = of_sector @ place / np.where(total > 0.0, total, 1.0)
    return centres


def _weight_for(share: float, margin: Floats, mass: Floats) -> float:
    """Return the weight with which a site's region has about `share` of the mass."""
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


def _regions(power: Floats, mass: Floats) -> tuple[Places, float]:
    """Return the region of each place, and the fullest region's relative excess over the mean."""
    owner: Places = power.argmin(axis=1)
    held = np.bincount(owner, mass, power.shape[1]).astype(np.float64)
    mean = held.mean()
    return owner, float(held.max() / mean - 1.0) if mean > 0.0 else 0.0
