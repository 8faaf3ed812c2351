# SPDX-License-Identifier: Apache-2.0
"""Entropies in nats, and how far a believed map is from the truth."""

from __future__ import annotations

from kbnitp_ros.core.field.check import in_short, yes_or_no
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


# A map may say 0 or 1 of a cell and be wrong; the loss of that is held finite, at 36 nats.
SMALLEST = np.finfo(np.float64).eps


def log_loss(probability: NDArray[np.float64], truth: ArrayLike) -> float:
    """
    Return the log loss of a map, summed over the cells.

    Equation :eq:`log-loss`.

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

    Raises
    ------
    ValueError
        If the truth has another shape.

    """
    given = np.where(truth_of(probability, truth), probability, 1.0 - probability)
    return float(-np.log(given.clip(min=SMALLEST)).sum())


def brier_score(probability: NDArray[np.float64], truth: ArrayLike) -> float:
    """
    Return the squared error of a map, summed over the cells: its Brier score.

    Equation :eq:`brier-score`.

    Parameters
    ----------
    probability : ndarray, shape (cells,)
        Believed P(present), e.g. `Belief.target`.
    truth : array_like of bool, shape (cells,)
        What is there.

    Raises
    ------
    ValueError
        If the truth has another shape.

    """
    return float(((probability - truth_of(probability, truth)) ** 2).sum())


def truth_of(probability: NDArray[np.float64], truth: ArrayLike) -> NDArray[np.bool_]:
    """Return `truth` as booleans if it is the truth of such a map."""
    if not isinstance(probability, np.ndarray):
        raise TypeError(
            f'probability is {in_short(probability)}: it must be a map, such as Belief.hazard'
        )
    present = yes_or_no('truth', truth)
    if present.shape != probability.shape:
        raise ValueError(f'truth has shape {present.shape}: the map has {probability.shape}')
    return present
