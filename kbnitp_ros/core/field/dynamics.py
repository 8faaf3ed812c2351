# SPDX-License-Identifier: Apache-2.0
"""Whether hazards stay, come and go, or are used up by the robots that they strike."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field.check import probability
import numpy as np
from numpy.typing import NDArray

HAZARDS = ('static', 'changing', 'used_up')


@dataclass(frozen=True)
class Dynamics:
    """
    How hazards change from one deployment to the next.

    Parameters
    ----------
    kind : str
        ``'static'``: they stay, whatever they strike. ``'changing'``: before every deployment but
        the first, each cell changes by itself. ``'used_up'``: a hazard that strikes is gone,
        whether or not the robot survives.
    appear, vanish : float
        Of a changing field, the chances in [0, 1] that a cell without a hazard has one at the next
        deployment, and that a hazard is gone by then. Both 0 is a static field.

    Raises
    ------
    ValueError
        If there is no such kind, a rate is NaN or outside [0, 1], or hazards of another kind are
        given rates.

    """

    kind: str = 'static'
    appear: float = 0.0
    vanish: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in HAZARDS:
            raise ValueError(f'dynamics is {self.kind!r}: it must be one of {", ".join(HAZARDS)}')
        for name in ('appear', 'vanish'):
            rate = probability(name, getattr(self, name))
            if rate and self.kind != 'changing':
                raise ValueError(
                    f'{name} is {rate} and hazards are {self.kind}: only changing ones have rates'
                )
            object.__setattr__(self, name, rate)

    @property
    def effect(self) -> str:
        """Return the kind, which is static where hazards change at rates of 0."""
        return self.kind if self.kind == 'used_up' or self.appear or self.vanish else 'static'

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
        joint : ndarray, shape (cells, 2, 2)
            P(Z = z, X = x) before it.
        possible : ndarray of bool, shape (cells,)
            Which cells may have a hazard; the others stay free of it.

        """
        move = np.array([[1.0 - self.appear, self.appear], [self.vanish, 1.0 - self.vanish]])
        after = joint.copy()
        after[possible] = np.einsum('czx,zy->cyx', joint[possible], move)
        return after


STATIC = Dynamics()
