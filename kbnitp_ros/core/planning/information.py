# SPDX-License-Identifier: Apache-2.0
"""Expected information of paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import typed
from kbnitp_ros.core.field.observation import as_path, Visits
from kbnitp_ros.core.field.sensor import log_predicted_survival, of_each, RobotType, SensorModel
from kbnitp_ros.core.planning.objective import JointOutcomes, Objective
from kbnitp_ros.core.planning.options import SearchOptions
import numpy as np
from numpy.typing import ArrayLike, NDArray


def path_log_survival(belief: Belief, model: SensorModel, path: NDArray[np.intp]) -> float:
    """Return the log probability of a return under the belief (:eq:`path-survival`)."""
    visits = Visits.of(path)
    hazard = belief.hazard[visits.cells]
    return float(log_predicted_survival(hazard, visits.counts, model.log_survival).sum())


@typed
def path_information(belief: Belief, model: SensorModel, path: ArrayLike) -> float:
    """
    Return the mutual information between the field and the outcome of one deployment.

    Equation :eq:`information`.

    The objective I(X; Y | Theta) + I(Z; Theta) of arXiv:2305.06929, eq. 1, equals
    I(Z, X; Theta, Y), since given X the readings are independent of Z. It is computed exactly as

        h(P0) - E_z[h(P(survive | z))] + P0 * sum_i I(X_i; Y_i^(n_i) | survived n_i visits)

    Parameters
    ----------
    belief : Belief
        Belief before the deployment.
    model : SensorModel
        Believed sensor model of the robot.
    path : array_like of int, shape (steps + 1,)
        The cells in order.

    Returns
    -------
    float
        Nats, at least 0 except for rounding.

    Raises
    ------
    ValueError
        If the path has no step or leaves the belief's cells.

    """
    return Objective.of(belief, model).evaluate(path)[0]


@typed
def team_information(
    belief: Belief,
    model: SensorModel,
    paths: Sequence[ArrayLike],
    outcomes: JointOutcomes | None = None,
    robot_types: Sequence[RobotType] = (),
) -> float:
    """
    Return the mutual information between the field and the outcomes of several deployments.

    Equation :eq:`team-information`.

    By the chain rule it is the sum of the information that each path adds to the earlier paths,
    approximated by :eq:`added-information`. For a single path it equals `path_information`.

    Parameters
    ----------
    belief, model
        As in `path_information`; the model is that of the common robot type.
    paths : sequence of array_like of int, each of shape (steps + 1,)
        The cells of each robot's path in order.
    outcomes : JointOutcomes, optional
        Joint outcomes of robots sent before, whose information is excluded; by default none.
    robot_types : sequence of RobotType
        Type of each robot; empty if all are alike.

    Returns
    -------
    float
        Nats.

    Raises
    ------
    ValueError
        If a path has no step or leaves the belief's cells, or the numbers of types and paths
        differ.

    """
    information = 0.0
    for path, robot_type in zip(paths, of_each(len(paths), robot_types)):
        objective = Objective.of(belief, robot_type.model(model), outcomes=outcomes)
        information += objective.evaluate(path)[0]
        outcomes = objective.after(path)
    return information


@typed
def behavioral_information(
    belief: Belief,
    model: SensorModel,
    path: ArrayLike,
    alpha: float,
    outcomes: JointOutcomes | None = None,
) -> float:
    """
    Return the information of a path with behavioral entropies instead of Shannon's.

    Equation :eq:`behavioral-information`: the information that a return or loss gives about the
    hazards, plus the expected entropy of targets that readings of a returned robot remove.

    Parameters
    ----------
    belief, model, path
        As in `path_information`.
    alpha : float
        As in `SearchOptions`.
    outcomes : JointOutcomes, optional
        Joint outcomes of robots sent before; by default none.

    Returns
    -------
    float
        Nats; if alpha is at most 1, at least 0 except for rounding. With alpha above 1 it may be
        slightly negative, since the entropies are then convex near certainty.

    """
    options = SearchOptions(objective='behavioral', alpha=alpha)
    return Objective.of(belief, model, options, outcomes).evaluate(path)[0]


# Decimals of compared values, nats: closer values are ties, so rounding errors never decide.
DECIMALS = 9


class Candidate(NamedTuple):
    """A closed path and its objective value."""

    # The objective value, nats, rounded.
    value: float
    # Cells, the base first and last, shape (steps + 1,).
    path: NDArray[np.intp]

    @classmethod
    def along(cls, path: NDArray[np.intp], objective: Objective) -> Candidate:
        """Return a path, shape (steps + 1,), with its exact value (:eq:`objective-value`)."""
        lost = -np.expm1(path_log_survival(objective.belief, objective.model, as_path(path)))
        information, _ = objective.evaluate(path)
        return cls(round(float(information - objective.loss_cost * lost), DECIMALS), path)

    def survival(self, objective: Objective) -> float:
        """Return the chance that a robot returns, under the belief of the objective."""
        return float(np.exp(path_log_survival(objective.belief, objective.model, self.path)))
