# SPDX-License-Identifier: Apache-2.0
"""Dynamics of hazards: static, changing, moving, or used up by the robots that they strike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from kbnitp_ros.core.field.check import probability
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.unknowns import Beta
import numpy as np
from numpy.typing import NDArray

HAZARDS = ('static', 'changing', 'used_up', 'moving', 'learn')

Rate: TypeAlias = 'float | Sequence[float] | Beta'
Rates: TypeAlias = 'float | NDArray[np.float64]'

# The rates that each kind has.
HAZARD_RATES = {'changing': ('appear', 'vanish'), 'moving': ('move',)}

# The prior of a rate of which nothing is known: log-uniform.
ANY_RATE = Beta(0.0, 1.0, 0.001, 0.1)


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
        each hazard may go to a neighbouring cell that has none and may have one. ``'learn'``: one
        of these, which the evidence tells.
    appear : float
        Of a changing field, the chance in [0, 1] that a cell without a hazard has one at the next
        deployment. 0 where `vanish` is unknown stands for the rate that keeps the expected number
        of hazards of the prior.
    vanish : float, (float, float) or Beta
        Of a changing field, the chance in [0, 1] that a hazard is gone by the next deployment.
        Two numbers, or a prior, where it is unknown: log-uniform between the two.
    move : float, (float, float) or Beta
        Of moving hazards, the chance in [0, 1] that one leaves its cell if it can, likewise.

    Rates of 0 are static hazards, but with 'learn', where 0 stands for a rate that is unknown,
    log-uniform from .001 to .1.

    Raises
    ------
    ValueError
        If there is no such kind, a rate is NaN or outside [0, 1], or hazards of another kind are
        given rates.

    """

    kind: str = 'static'
    appear: float = 0.0
    vanish: Rate = 0.0
    move: Rate = 0.0

    def __post_init__(self) -> None:
        if self.kind not in HAZARDS:
            raise ValueError(f'dynamics is {self.kind!r}: it must be one of {", ".join(HAZARDS)}')
        for kind, names in HAZARD_RATES.items():
            for name in names:
                rate = rate_of(name, getattr(self, name))
                if self.kind == 'learn' and name != 'appear' and not rate:
                    rate = ANY_RATE
                if rate and self.kind not in (kind, 'learn'):
                    raise ValueError(
                        f'{name} is {rate} and hazards are {self.kind}: only {kind} ones have it'
                    )
                object.__setattr__(self, name, rate)

    @property
    def effect(self) -> str:
        """Return the kind, which is static where hazards change at rates of 0."""
        always = self.kind in ('used_up', 'learn')
        return self.kind if always or self.appear or self.vanish or self.move else 'static'

    @property
    def unknown_rates(self) -> dict[str, Beta]:
        """Return the priors of the rates that are unknown, by name."""
        rates = {name: getattr(self, name) for name in ('vanish', 'move')}
        return {name: rate for name, rate in rates.items() if isinstance(rate, Beta)}

    @property
    def kinds(self) -> tuple[Dynamics, ...]:
        """Return the kinds that hazards may be of."""
        if self.kind != 'learn':
            return (self,)
        return (
            STATIC,
            Dynamics('used_up'),
            Dynamics('changing', self.appear, self.vanish),
            Dynamics('moving', move=self.move),
        )

    def known_rates(self) -> dict[str, float]:
        """
        Return the rates by name.

        Raises
        ------
        ValueError
            If the kind or a rate is unknown: no world can have such hazards.

        """
        if self.kind == 'learn':
            raise ValueError(
                "dynamics is 'learn', which is no kind that the hazards of a world can be of: "
                'use one of ' + ', '.join(HAZARDS[:-1])
            )
        for name, prior in self.unknown_rates.items():
            raise ValueError(
                f'{name} is unknown from {prior.low} to {prior.high}: that of a world is a number'
            )
        return {name: getattr(self, name) for name in ('appear', 'vanish', 'move')}


def rate_of(name: str, given: Rate) -> float | Beta:
    """Return a rate, or its prior where it is unknown."""
    if isinstance(given, Beta):
        return given
    if isinstance(given, int | float | np.number):
        return probability(name, given)
    if name == 'appear' or np.shape(given) != (2,):
        raise ValueError(
            f'{name} is {given}: it must be a number'
            + (' or low and high' if name != 'appear' else ', and is unknown with vanish')
        )
    low, high = (probability(name, each) for each in given)
    if not 0.0 < low < high:
        raise ValueError(f'{name} is unknown within {given}: it must go from above 0 to more')
    return Beta(0.0, 1.0, low, high)


def appearance(vanish: Any, density: Any) -> Any:
    """Return the rate of appearing that keeps a share of hazards (:eq:`tied-appearance`)."""
    return np.minimum(vanish * density / (1.0 - density), 1.0)


def joint_after_change(
    joint: NDArray[np.float64], possible: NDArray[np.bool_], appear: Rates, vanish: Rates
) -> NDArray[np.float64]:
    """
    Return the cells' joints after a change of a changing field: targets stay.

    Equation :eq:`hazard-change`.
    """
    safe, hazardous = joint[possible, 0], joint[possible, 1]
    after = joint.copy()
    after[possible, 0] = safe * (1.0 - appear) + hazardous * vanish
    after[possible, 1] = safe * appear + hazardous * (1.0 - vanish)
    return after


def joint_after_moves(
    joint: NDArray[np.float64], neighbors: NDArray[np.intp], move: Rates
) -> NDArray[np.float64]:
    """
    Return the cells' joints after hazards moved, cells taken for independent: targets stay.

    Equations :eq:`hazard-leaves`, :eq:`hazard-arrives` and :eq:`hazard-moves`.
    """
    hazard = joint[:, 1].sum(axis=1)

    def around(values: NDArray[np.float64], without: float) -> NDArray[np.float64]:
        """Return the values of the cells around each, (cells, 8, ...)."""
        padded = np.concatenate([values, np.full_like(values[:1], without)])
        return padded[neighbors]

    free = around(1.0 - hazard, 0.0).sum(axis=1)
    can_leave = 1.0 - around(hazard, 1.0).prod(axis=1)
    to_each = move * can_leave * inverse(free)
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
