# SPDX-License-Identifier: Apache-2.0
"""Maps of prior probabilities whose averages may be unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kbnitp_ros.core.field import Bins
import numpy as np
from numpy.typing import NDArray

# Log odds that stand for certainty where others are added to them: far above what evidence comes
# to, and low enough to keep it apart.
CERTAIN = 1e6
# Log odds beyond which a hazard is as good as certain, and a target.
CERTAIN_HAZARD = 300.0
CERTAIN_TARGET = 700.0
# Offsets of log odds within which that of any average is found, and how often they are halved.
FURTHEST = 1000.0
HALVINGS = 60


@dataclass(frozen=True, eq=False)
class PriorMap:
    """One probability a cell, the same as the prior's but for an offset common to all log odds."""

    # Shape (cells,). As the prior has them.
    log_odds: NDArray[np.float64]
    # Shape (cells,). Where the probability is neither 0 nor 1; elsewhere no offset changes it.
    undecided: NDArray[np.bool_]
    # Shape (values,). That takes the undecided cells to each value of their average; 0 alone if it
    # is known.
    offset: NDArray[np.float64]
    # Shape (cells, values). log (1 - p) with each offset; 0 where the probability is decided.
    log_absent: NDArray[np.float64]

    @classmethod
    def of(
        cls, probability: NDArray[np.float64], where: NDArray[np.bool_], average: Bins | None
    ) -> PriorMap:
        """Return a map."""
        with np.errstate(divide='ignore'):
            log_odds = np.log(probability) - np.log1p(-probability)
        log_odds = log_odds.clip(-CERTAIN, CERTAIN)
        undecided = where & (probability > 0.0) & (probability < 1.0)
        if average is None:
            offset: NDArray[np.float64] = np.zeros(1)
        elif undecided.any():
            offset = offsets(log_odds[undecided], average.values)
        else:
            raise ValueError('the prior leaves it open in no cell')
        log_absent = np.zeros((log_odds.size, offset.size))
        log_absent[undecided] = -softplus(log_odds[undecided, None] + offset)
        return cls(log_odds, undecided, offset, log_absent)

    def with_log_odds(self, log_odds: NDArray[np.float64]) -> PriorMap:
        """Return the map with each of these log odds, (values,), in all undecided cells."""
        return replace(
            self,
            log_odds=np.where(self.undecided, log_odds[0], self.log_odds),
            offset=log_odds - log_odds[0],
            log_absent=np.zeros((self.log_odds.size, 1)),
        )

    def within(self, cells: NDArray[np.intp]) -> PriorMap:
        """Return the map of some of the cells."""
        return replace(
            self,
            log_odds=self.log_odds[cells],
            undecided=self.undecided[cells],
            log_absent=self.log_absent[cells],
        )

    def at(
        self, place: NDArray[np.intp], cells: NDArray[np.intp] | slice = slice(None)
    ) -> NDArray[np.float64]:
        """Return log odds of cells in chains with these values, shape (1 or chains, cells)."""
        if self.offset.size == 1:
            return self.log_odds[None, cells]
        return self.log_odds[cells] + self.undecided[cells] * self.offset[place, None]

    def odds(self, lowest: float, highest: float) -> NDArray[np.float64]:
        """Return the odds with each value, of log odds in some range, shape (values, cells)."""
        log_odds = self.at(np.arange(self.offset.size))
        odds: NDArray[np.float64] = np.exp(log_odds.clip(lowest, highest))
        return odds

    def mean(self, log_prior: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probabilities averaged over the offsets, shape (cells,)."""
        shifted = self.log_odds[:, None] + self.undecided[:, None] * self.offset
        mean: NDArray[np.float64] = (expit(shifted) * np.exp(log_prior)).sum(axis=1)
        return mean


@dataclass(frozen=True, eq=False)
class PriorMaps:
    """What a prior says of each cell, one array or map of all cells each."""

    # Shape (cells,). Where there may be a hazard.
    possible: NDArray[np.bool_]
    # P(Z = 1), P(X = 1 | Z = 1) and P(X = 1 | Z = 0).
    hazard: PriorMap
    kappa: PriorMap
    background: PriorMap

    def within(self, cells: NDArray[np.intp]) -> PriorMaps:
        """Return what it says of some of the cells."""
        hazard, kappa, background = (
            each.within(cells) for each in (self.hazard, self.kappa, self.background)
        )
        return PriorMaps(self.possible[cells], hazard, kappa, background)

    def odds(self) -> dict[str, NDArray[np.float64]]:
        """Return the odds with each value of a map's average, (values, cells), by its name."""
        return {
            'hazard_density': self.hazard.odds(-CERTAIN_HAZARD, CERTAIN_HAZARD),
            'target_background': self.background.odds(-np.inf, CERTAIN_TARGET),
            'kappa': self.kappa.odds(-np.inf, CERTAIN_TARGET),
        }


def offsets(log_odds: NDArray[np.float64], averages: NDArray[np.float64]) -> NDArray[np.float64]:
    """
    Return what to add to log odds so that the probabilities have each of some averages.

    Equation :eq:`prior-offset`.
    """
    low, high = np.full_like(averages, -FURTHEST), np.full_like(averages, FURTHEST)
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        below = expit(log_odds[:, None] + middle).mean(axis=0) < averages
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    offset: NDArray[np.float64] = (low + high) / 2.0
    return offset


def softplus(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log(1 + exp(x)) without overflow."""
    result: NDArray[np.float64] = np.maximum(log_odds, 0.0) + np.log1p(np.exp(-np.abs(log_odds)))
    return result


def expit(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the probability at log odds x."""
    with np.errstate(over='ignore'):
        probability: NDArray[np.float64] = 1.0 / (1.0 + np.exp(-log_odds))
    return probability
