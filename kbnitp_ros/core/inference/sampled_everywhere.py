# SPDX-License-Identifier: Apache-2.0
"""
Sampling as it was computed first: chains hold all cells of the field, visited or not.

Beliefs that were recorded then are reproduced bit for bit by the same draws only. They differ from
those of `sampled` as with another seed.
"""

from __future__ import annotations

from typing import ClassVar

from kbnitp_ros.core.inference.chain_state import Places
from kbnitp_ros.core.inference.sampled import Sampler
from kbnitp_ros.core.inference.tally import Tally
import numpy as np


class EverywhereSampler(Sampler):
    """A `Sampler` that draws the hazards and targets of all cells, and settles for less."""

    settled: ClassVar[float] = 5e-4

    def _drawn(self, tally: Tally) -> tuple[Places, Places]:
        everywhere = np.arange(self.belief.cells)
        return everywhere, everywhere
