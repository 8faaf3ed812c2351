# SPDX-License-Identifier: Apache-2.0
"""Shannon entropies in nats."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def surprisal(probability: ArrayLike) -> NDArray[np.float64]:
    """Return -p log p, with 0 log 0 = 0; any shape, in nats (:eq:`shannon-entropy`)."""
    p = np.asarray(probability, dtype=np.float64)
    surprisals: NDArray[np.float64] = -p * np.log(np.where(p > 0.0, p, 1.0))
    return surprisals


def binary_entropy(probability: ArrayLike) -> NDArray[np.float64]:
    """
    Return h(p), the entropy of a coin that falls with probability p; any shape, in nats.

    Equation :eq:`shannon-entropy`.
    """
    p = np.asarray(probability, dtype=np.float64)
    return surprisal(p) + surprisal(1.0 - p)
