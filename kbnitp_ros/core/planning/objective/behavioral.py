# SPDX-License-Identifier: Apache-2.0
"""
The objective with behavioral entropies, which weigh what is likely and unlikely as people do.

The behavioral entropy of a coin is -w(p) ln w(p) - w(1-p) ln w(1-p) with the weight of Prelec,
w(p) = exp(-beta (-ln p)^alpha), where beta = (ln 2)^(1 - alpha) makes w(1/2) = 1/2 (Suresh,
Nieto-Granda, Martinez: Robotic Exploration using Generalized Behavioral Entropy,
arXiv:2402.10161). With alpha = 1 it is Shannon's.
"""

from __future__ import annotations

from functools import lru_cache
from math import log
from typing import NamedTuple

from kbnitp_ros.core.field import Belief, SensorModel, surprisal
from kbnitp_ros.core.planning.objective.information_kernels import (
    coin,
    new_falls,
    outcome_left_open,
    Readings,
)
from kbnitp_ros.core.planning.objective.joint_outcomes import JointOutcomes, nobody_deployed
from kbnitp_ros.core.planning.objective.moments import WEIGHTS as SHANNONS
from kbnitp_ros.core.planning.objective.options import SHANNON
from kbnitp_ros.core.planning.objective.prediction import predict
from kbnitp_ros.core.planning.objective.readings import of_cells
import numpy as np
from numpy.typing import ArrayLike, NDArray

# While labels are compared, the entropy of an outcome is a sum of these powers of a survival. As
# among those of Shannon's, the first moment is the predicted survival itself.
EXPONENTS = np.append(1.0, np.geomspace(0.1, 5000.0, 15))


def beta_of(alpha: float) -> float:
    """
    Return the beta with which 1/2 has the weight 1/2.

    Equation :eq:`behavioral-entropy`.
    """
    return float(log(2.0) ** (1.0 - alpha))


def behavioral_entropy(probability: ArrayLike, alpha: float) -> NDArray[np.float64]:
    """
    Return the behavioral entropy of a coin that falls with a probability.

    Equation :eq:`behavioral-entropy`.

    Parameters
    ----------
    probability : array_like
        Any shape, in [0, 1].
    alpha : float
        Of the Prelec weight, above 0. Up to 1 the entropy is concave.

    Returns
    -------
    ndarray
        Of the same shape, from 0 to ln 2, nats.

    """
    p = np.asarray(probability, dtype=np.float64)
    beta = beta_of(alpha)
    entropy = [coin(each, 1.0 - each, alpha, beta) for each in p.ravel().tolist()]
    return np.array(entropy, dtype=np.float64).reshape(p.shape)


def behavioral_information(
    belief: Belief,
    model: SensorModel,
    path: ArrayLike,
    alpha: float,
    outcomes: JointOutcomes | None = None,
    interest: NDArray[np.float64] | None = None,
) -> float:
    """
    Return what `path_information` is with behavioral entropies in place of Shannon's.

    Equation :eq:`behavioral-information`.

    With h the entropy of a coin, and h(X_i) that of a target given that n_i visits are survived,

        h(P0) - E_z[h(P(survive | z))] + P0 * sum_i (h(X_i) - E_y[h(X_i | y)])

    the information of the robot's return or loss about the hazards, and the expected fall of the
    entropies of the targets by the readings of a robot that returns.

    Parameters
    ----------
    belief : Belief
        Before the deployment.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    path : array_like of int, shape (steps + 1,)
        The cells in order.
    alpha : float
        Of the Prelec weight.
    outcomes : JointOutcomes, optional
        Of robots sent before, to which this adds, as for `added_information`; without it there
        are none.
    interest : ndarray, shape (cells,), optional
        What counts of the readings in each cell; all, unless given.

    Returns
    -------
    float
        Nats, at least 0 but for rounding where alpha is at most 1. Where it is more, a likely
        return or a likely target becomes less sure in the weighing, so it may be negative.

    """
    outcomes = nobody_deployed(belief) if outcomes is None else outcomes
    ahead = predict(belief, model, path, outcomes)
    fallen = falls(ahead.readings, ahead.joint, ahead.earlier, ahead.visits.counts, alpha)
    if interest is not None:
        fallen = fallen * interest[ahead.visits.cells]
    open_outcome = outcome_left_open(ahead.exposures, alpha, beta_of(alpha))
    outcome = behavioral_entropy(ahead.survival, alpha)
    of_each = outcome + ahead.survival * fallen.sum(axis=1) - open_outcome
    return float((outcomes.probability * of_each).sum())


def falls(
    read: Readings,
    joint: NDArray[np.float64],
    earlier: NDArray[np.float64],
    visits: NDArray[np.intp],
    alpha: float,
) -> NDArray[np.float64]:
    """
    Return what `new_information` does, for behavioral entropies.

    Parameters
    ----------
    read : Readings
        What the robot may read.
    joint, earlier, visits
        As there.
    alpha : float
        Of the Prelec weight.

    Returns
    -------
    ndarray, shape (..., cells)
        By how much the entropies of the targets are expected to fall, nats.

    """
    return of_cells(new_falls, read, joint, earlier, visits, alpha, beta_of(alpha))


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
    """
    Return the weights with which the powers of a label make the entropy left in its outcome.

    Parameters
    ----------
    alpha : float
        Of the Prelec weight.
    chance : ndarray, shape (outcomes,)
        Of each outcome of the robots sent before.

    Returns
    -------
    ndarray, shape (powers,)
        With behavioral entropies, first of the powers of the survival given the hazards; then of
        those of the survival in each outcome, whose entropy is not left open but found out.

    """
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
