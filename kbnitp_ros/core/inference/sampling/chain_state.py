# SPDX-License-Identifier: Apache-2.0
"""Where the chains of a sampler are between deployments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from kbnitp_ros.core.field import Bins
from kbnitp_ros.core.inference.sampling.hypotheses import Hypotheses
from kbnitp_ros.core.inference.sampling.prior_map import expit
import numpy as np
from numpy.typing import NDArray

CHAINS = 256
# Chains are independent of each other, so groups of them tell how far chance takes an average.
GROUPS = 16

Floats = NDArray[np.float64]
Places = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ChainState:
    """What each chain holds. No array is changed once it is made."""

    # Shape (chains,). Which value of its bins each number has, by name.
    place: Mapping[str, Places]
    # Shape (held,). The cells whose hazards the chains draw, in ascending order.
    cells: Places
    # Shape (chains, held). Z of these.
    hazardous: NDArray[np.int8]

    @classmethod
    def start(cls, all_bins: Mapping[str, Bins], rng: np.random.Generator) -> ChainState:
        """Return chains that hold numbers drawn from their priors, and no cells."""
        place = {
            name: np.searchsorted(
                np.cumsum(np.exp(bins.log_prior))[:-1], even(1, rng)[:, 0], 'right'
            )
            for name, bins in all_bins.items()
        }
        return cls(place, np.empty(0, np.intp), np.empty((CHAINS, 0), np.int8))

    def with_cells(
        self, cells: Places, hypotheses: Hypotheses, rng: np.random.Generator
    ) -> ChainState:
        """Return the state with `cells`, those that it holds among them."""
        is_held = np.isin(cells, self.cells)
        offset = hypotheses.offset('hazard_density', self.place)
        probability = expit(hypotheses.maps.hazard.at(offset, cells[~is_held]))
        hazardous = np.empty((CHAINS, cells.size), np.int8)
        hazardous[:, is_held] = self.hazardous
        hazardous[:, ~is_held] = even(np.count_nonzero(~is_held), rng) < probability
        return ChainState(self.place, cells, hazardous)


def even(numbers: int, rng: np.random.Generator) -> Floats:
    """Return `numbers` uniform numbers a chain, each spread evenly over the chains."""
    order = rng.permuted(np.tile(np.arange(CHAINS), (numbers, 1)), axis=1).T
    uniform: Floats = (order + rng.random(order.shape)) / CHAINS
    return uniform
