# SPDX-License-Identifier: Apache-2.0
"""How far a believed map is from the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# A map may say 0 or 1 of a cell and be wrong; the loss of that is held finite, at 36 nats.
SMALLEST = np.finfo(np.float64).eps


def log_loss(probability: NDArray[np.float64], truth: ArrayLike) -> float:
    """
    Return the log loss of a map, summed over the cells.

    Parameters
    ----------
    probability : ndarray, shape (cells,)
        Believed P(present), e.g. `Belief.hazard`.
    truth : array_like of bool, shape (cells,)
        What is there.

    Returns
    -------
    float
        -sum log P(truth) in nats, at least 0; a cell counts at most 36.

    """
    given = np.where(np.asarray(truth, dtype=bool), probability, 1.0 - probability)
    return float(-np.log(given.clip(min=SMALLEST)).sum())


def brier_score(probability: NDArray[np.float64], truth: ArrayLike) -> float:
    """
    Return the squared error of a map, summed over the cells.

    Parameters
    ----------
    probability : ndarray, shape (cells,)
        Believed P(present), e.g. `Belief.target`.
    truth : array_like of bool, shape (cells,)
        What is there.

    """
    return float(((probability - np.asarray(truth, dtype=np.float64)) ** 2).sum())
