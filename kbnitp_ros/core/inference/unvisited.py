# SPDX-License-Identifier: Apache-2.0
"""Cells of which nothing is told but by the numbers that are learnt of all."""

from __future__ import annotations

from collections.abc import Mapping

from kbnitp_ros.core.inference import gibbs
from kbnitp_ros.core.inference.chain_state import Floats, GROUPS, Places
from kbnitp_ros.core.inference.hypotheses import Hypotheses
import numpy as np


class Unvisited:
    """
    The cells that chains do not hold: their joints are the prior's, with the numbers of a chain.

    Parameters
    ----------
    hypotheses : Hypotheses
        The prior, and the values of its numbers.
    held : ndarray of int
        The cells that the chains hold.

    """

    def __init__(self, hypotheses: Hypotheses, held: Places) -> None:
        cells = np.setdiff1d(np.arange(hypotheses.belief.cells), held)
        if hypotheses.prior_is_known:
            # It is their joint as it stands: there is nothing to average.
            cells = cells[:0]
        self._cells = cells
        self._prior = hypotheses.belief.joint
        self._odds = hypotheses.maps.within(cells).odds()
        self._joints = np.zeros((GROUPS, cells.size, 2, 2))

    def add(self, place: Mapping[str, Places]) -> None:
        """Add the joints by the numbers of each chain, whose values `place` has by name."""
        hazard, target_if_safe, target_if_hazardous = (
            odds[place[name]] for name, odds in self._odds.items()
        )
        gibbs.add_joints(hazard, target_if_safe, target_if_hazardous, self._joints)

    def joints(self, sweeps: int) -> Floats:
        """
        Return the joints of a field, averaged over groups of chains.

        The shape is (groups, cells, 2, 2). Cells that the chains hold have the prior's.
        """
        joints = np.tile(self._prior, (GROUPS, 1, 1, 1))
        joints[:, self._cells] = self._joints / sweeps
        return joints
