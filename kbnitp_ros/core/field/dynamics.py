# SPDX-License-Identifier: Apache-2.0
"""Dynamics of hazards: static, changing, moving, or used up by the robots that they strike."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field.check import probability
from kbnitp_ros.core.field.grid import Grid
import numpy as np
from numpy.typing import NDArray

HAZARDS = ('static', 'changing', 'used_up', 'moving')

# The rates that each kind has.
HAZARD_RATES = {'changing': ('appear', 'vanish'), 'moving': ('move',)}


@dataclass(frozen=True)
class Dynamics:
    """
    How hazards change from one deployment to the next.

    Parameters
    ----------
    kind : str
        ``'static'``: they stay, whatever they strike. ``'changing'``: before every deployment but
        the first, each cell changes by itself. ``'used_up'``: a hazard that strikes is gone,
        whether or not the robot survives. ``'moving'``: before every deployment but the first,
        each hazard may go to a neighbouring cell that has none and may have one.
    appear, vanish : float
        Of a changing field, the chances in [0, 1] that a cell without a hazard has one at the next
        deployment, and that a hazard is gone by then. Both 0 is a static field.
    move : float
        Of moving hazards, the chance in [0, 1] that one leaves its cell if it can. 0 is static.

    Raises
    ------
    ValueError
        If there is no such kind, a rate is NaN or outside [0, 1], or hazards of another kind are
        given rates.

    """

    kind: str = 'static'
    appear: float = 0.0
    vanish: float = 0.0
    move: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in HAZARDS:
            raise ValueError(f'dynamics is {self.kind!r}: it must be one of {", ".join(HAZARDS)}')
        for kind, names in HAZARD_RATES.items():
            for name in names:
                rate = probability(name, getattr(self, name))
                if rate and self.kind != kind:
                    raise ValueError(
                        f'{name} is {rate} and hazards are {self.kind}: only {kind} ones have it'
                    )
                object.__setattr__(self, name, rate)

    @property
    def effect(self) -> str:
        """Return the kind, which is static where hazards change at rates of 0."""
        has_effect = self.kind == 'used_up' or self.appear or self.vanish or self.move
        return self.kind if has_effect else 'static'

    def hazard_after(self, hazard: NDArray[np.float64]) -> NDArray[np.float64]:
        """
        Return P(Z = 1) after a change of a changing field.

        Equation :eq:`hazard-change`.

        Parameters
        ----------
        hazard : ndarray
            P(Z = 1), or Z, before it, of cells that may have a hazard; any shape.

        """
        after: NDArray[np.float64] = hazard * (1.0 - self.vanish) + (1.0 - hazard) * self.appear
        return after

    def joint_after(
        self, joint: NDArray[np.float64], possible: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """
        Return the cells' joints after a change of a changing field: targets stay.

        Equation :eq:`hazard-change`.

        Parameters
        ----------
        joint : ndarray, shape (cells, 2, 2, ...)
            P(Z = z, X = x) before it, and any axes of further cases.
        possible : ndarray of bool, shape (cells,)
            Which cells may have a hazard; the others stay free of it.

        """
        move = np.array([[1.0 - self.appear, self.appear], [self.vanish, 1.0 - self.vanish]])
        after = joint.copy()
        after[possible] = np.einsum('czx...,zy->cyx...', joint[possible], move)
        return after

    def joint_after_moves(
        self, joint: NDArray[np.float64], neighbors: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """
        Return the cells' joints after hazards moved, cells taken for independent: targets stay.

        Equations :eq:`hazard-leaves`, :eq:`hazard-arrives` and :eq:`hazard-moves`.

        Parameters
        ----------
        joint : ndarray, shape (cells, 2, 2, ...)
            P(Z = z, X = x) before it, and any axes of further cases.
        neighbors : ndarray of int, shape (cells, 8)
            The cells around each that may have a hazard; the number of cells for none.

        """
        hazard = joint[:, 1].sum(axis=1)

        def around(values: NDArray[np.float64], without: float) -> NDArray[np.float64]:
            """Return the values of the cells around each, (cells, 8, ...)."""
            padded = np.concatenate([values, np.full_like(values[:1], without)])
            return padded[neighbors]

        free = around(1.0 - hazard, 0.0).sum(axis=1)
        can_leave = 1.0 - around(hazard, 1.0).prod(axis=1)
        to_each = self.move * can_leave * inverse(free)
        comes = around(to_each * hazard, 0.0)
        into = 1.0 - (1.0 - comes).prod(axis=1)
        share = into * inverse(comes.sum(axis=1))
        out = to_each * around((1.0 - hazard) * share, 0.0).sum(axis=1)
        into, out = into[:, None], out[:, None]
        safe, hazardous = joint[:, 0], joint[:, 1]
        after = [safe * (1.0 - into) + hazardous * out, hazardous * (1.0 - out) + safe * into]
        return np.stack(after, axis=1)


def inverse(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 / x, 0 of 0."""
    inverted: NDArray[np.float64] = np.divide(
        1.0, values, out=np.zeros_like(values), where=values > 0.0
    )
    return inverted


def neighbors_to_move_to(grid: Grid, possible: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the cells around each that may have a hazard, (cells, 8); `grid.cells` for none."""
    table = np.delete(grid.neighbor_table, 4, axis=1)
    is_open = (table >= 0) & possible[table] & possible[:, None]
    return np.where(is_open, table, grid.cells)


STATIC = Dynamics()
