# SPDX-License-Identifier: Apache-2.0
"""A robot's predicted survival of the cells it visits."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def times_log(count: ArrayLike, log: ArrayLike) -> NDArray[np.float64]:
    """Return ``count * log``, broadcast, with 0 * -inf = 0: the log of a power."""
    with np.errstate(invalid='ignore'):
        return np.where(np.equal(count, 0), 0.0, np.multiply(count, log))


def log_predicted_survival(
    hazard: NDArray[np.float64],
    counts: NDArray[np.intp],
    log_survival: NDArray[np.float64],
) -> NDArray[np.float64]:
    """
    Return log S, where S = (1 - z) s0^n + z s1^n is the chance to survive n visits to a cell.

    Equation :eq:`predicted-survival`.
    """
    log_power = times_log(np.asarray(counts)[..., None], log_survival)
    weight = np.stack([1.0 - hazard, hazard], axis=-1)
    loss = np.sum(weight * -np.expm1(log_power), axis=-1)
    with np.errstate(divide='ignore'):
        # 1 - loss cancels where nearly nobody survives, the plain sum where nearly everybody does.
        return np.where(
            loss < 0.5, np.log1p(-loss), np.log(np.sum(weight * np.exp(log_power), axis=-1))
        )


def sum_of_others(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return for each value the sum of all the others, shape (..., n); -inf is allowed."""
    none = np.zeros((*values.shape[:-1], 1))
    before = np.concatenate([none, np.cumsum(values[..., :-1], axis=-1)], axis=-1)
    after = np.cumsum(values[..., :0:-1], axis=-1)[..., ::-1]
    sums: NDArray[np.float64] = before + np.concatenate([after, none], axis=-1)
    return sums
