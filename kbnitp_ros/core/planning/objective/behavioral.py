# SPDX-License-Identifier: Apache-2.0
"""
Behavioral entropies, which weigh what is likely and unlikely as people do.

The behavioral entropy of a coin is -w(p) ln w(p) - w(1-p) ln w(1-p) with the weight of Prelec,
w(p) = exp(-beta (-ln p)^alpha), where beta = (ln 2)^(1 - alpha) makes w(1/2) = 1/2 (Suresh,
Nieto-Granda, Martinez: Robotic Exploration using Generalized Behavioral Entropy,
arXiv:2402.10161). With alpha = 1 it is Shannon's.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from kbnitp_ros.core.field import surprisal
from kbnitp_ros.core.planning.objective.information_kernels import coin
from kbnitp_ros.core.planning.objective.moments import WEIGHTS as SHANNONS
from kbnitp_ros.core.planning.objective.options import beta_of, SHANNON
import numpy as np
from numpy.typing import ArrayLike, NDArray

# While labels are compared, the entropy of an outcome is a sum of these powers of a survival. As
# among those of Shannon's, the first moment is the predicted survival itself.
EXPONENTS = np.append(1.0, np.geomspace(0.1, 5000.0, 15))


def behavioral_entropy(probability: ArrayLike, alpha: float) -> NDArray[np.float64]:
    """
    Return the behavioral entropy of a coin that falls with a probability.

    Equation :eq:`behavioral-entropy`.
    """
    p = np.asarray(probability, dtype=np.float64)
    beta = beta_of(alpha)
    entropy = [coin(each, 1.0 - each, alpha, beta) for each in p.ravel().tolist()]
    return np.array(entropy, dtype=np.float64).reshape(p.shape)


class Weights(NamedTuple):
    """
    Of the powers that the entropy of an outcome is a sum of, each shape (powers,).

    Attributes
    ----------
    entropy : ndarray
        With these it is h(p).
    rest : ndarray
        With these it is h(p) + (1 - p) ln(1 - p), what a label search does not add by itself.

    """

    entropy: NDArray[np.float64]
    rest: NDArray[np.float64]


def powers_of(alpha: float, outcomes: int) -> int:
    """Return how many powers the labels of a search carry that may have so many outcomes."""
    return SHANNONS.size if alpha == SHANNON else EXPONENTS.size * (1 + outcomes)


def powers_weights(alpha: float, chance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights with which the powers of a label make the entropy left in its outcome."""
    if alpha == SHANNON:
        return SHANNONS
    weights = weights_of(alpha)
    return np.concatenate([weights.entropy, *(-each * weights.rest for each in chance)])


@lru_cache(maxsize=16)
def weights_of(alpha: float) -> Weights:
    """
    Return the weights of `EXPONENTS` for an alpha, by least squares on the whole of [0, 1].

    Equation :eq:`behavioral-powers`.
    """
    ends = np.geomspace(1e-8, 1e-2, 300)
    survival = np.concatenate([ends, np.linspace(0.01, 0.99, 600), 1.0 - ends[::-1]])
    powers = survival[:, None] ** EXPONENTS
    entropy = behavioral_entropy(survival, alpha)
    targets = np.stack([entropy, entropy - surprisal(1.0 - survival)], axis=1)
    found, *_ = np.linalg.lstsq(powers, targets, rcond=1e-10)
    return Weights(*np.ascontiguousarray(found.T))
