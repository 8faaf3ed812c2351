# SPDX-License-Identifier: Apache-2.0
"""What a path is worth by the objective, and by the behavioral entropy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

from kbnitp_ros.core.field import Belief, Grid, SensorModel, surprisal
from kbnitp_ros.core.planning.objective.information_kernels import coin
from kbnitp_ros.core.planning.objective.joint_outcomes import (
    after_deployment,
    JointOutcomes,
    nobody_deployed,
)
from kbnitp_ros.core.planning.objective.options import beta_of, SearchOptions, SHANNON
from kbnitp_ros.core.planning.objective.readings import WEIGHTS as SHANNONS
import numpy as np
from numpy.typing import ArrayLike, NDArray

# While labels are compared, the entropy of an outcome is a sum of these powers of a survival. As
# among those of Shannon's, the first moment is the predicted survival itself.
BEHAVIORAL_EXPONENTS = np.append(1.0, np.geomspace(0.1, 5000.0, 15))


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
    return SHANNONS.size if alpha == SHANNON else BEHAVIORAL_EXPONENTS.size * (1 + outcomes)


def powers_weights(alpha: float, chance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights with which the powers of a label make the entropy left in its outcome."""
    if alpha == SHANNON:
        return SHANNONS
    weights = weights_of(alpha)
    return np.concatenate([weights.entropy, *(-each * weights.rest for each in chance)])


@lru_cache(maxsize=16)
def weights_of(alpha: float) -> Weights:
    """
    Return the weights of `BEHAVIORAL_EXPONENTS` for an alpha, by least squares on [0, 1].

    Equation :eq:`behavioral-powers`.
    """
    ends = np.geomspace(1e-8, 1e-2, 300)
    survival = np.concatenate([ends, np.linspace(0.01, 0.99, 600), 1.0 - ends[::-1]])
    powers = survival[:, None] ** BEHAVIORAL_EXPONENTS
    entropy = behavioral_entropy(survival, alpha)
    targets = np.stack([entropy, entropy - surprisal(1.0 - survival)], axis=1)
    found, *_ = np.linalg.lstsq(powers, targets, rcond=1e-10)
    return Weights(*np.ascontiguousarray(found.T))


@dataclass(frozen=True, eq=False)
class Objective:
    """
    The information a path is expected to add, less the cost of the robots it is expected to lose.

    Attributes
    ----------
    belief : Belief
        Before the round.
    model : SensorModel
        What the robot and its sensors are believed to be like.
    loss_cost : float
        The cost of its loss, nats, at least 0.
    interest : ndarray, shape (cells,)
        What counts of the information of readings in each cell, in [0, 1].
    outcomes : JointOutcomes
        Of the robots that leave in the same round and whose paths are known.
    alpha : float
        Of the Prelec weight of what is likely and unlikely: 1 for Shannon's entropy, otherwise
        `behavioral_information` is in the place of the information.

    """

    belief: Belief
    model: SensorModel
    loss_cost: float
    interest: NDArray[np.float64]
    outcomes: JointOutcomes
    alpha: float = SHANNON

    @classmethod
    def alone(
        cls, grid: Grid, belief: Belief, model: SensorModel, options: SearchOptions
    ) -> Objective:
        """Return the objective of a robot that goes alone."""
        if belief.cells != grid.cells:
            raise ValueError(f'belief has {belief.cells} cells: the grid has {grid.cells}')
        interest, nobody = np.ones(belief.cells), nobody_deployed(belief)
        return cls(belief, model, options.loss_cost, interest, nobody, options.alpha)

    def after(self, path: NDArray[np.intp]) -> JointOutcomes:
        """Return what may become of the robots once this one takes `path` as well."""
        return after_deployment(self.outcomes, self.model, path)

    def given(self, outcomes: JointOutcomes) -> Objective:
        """Return the objective of the robot if others have left before."""
        return replace(self, outcomes=outcomes)
