# SPDX-License-Identifier: Apache-2.0
"""Expected information of paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import typed
from kbnitp_ros.core.field.sensor import of_each, RobotType, SensorModel
from kbnitp_ros.core.planning.information_kernels import Places
from kbnitp_ros.core.planning.objective import JointOutcomes, Objective
from kbnitp_ros.core.planning.options import SearchOptions, SHANNON
from numpy.typing import ArrayLike


@typed
def path_information(
    belief: Belief, model: SensorModel, path: ArrayLike, alpha: float = SHANNON
) -> float:
    """
    Return the mutual information between the field and the outcome of one deployment.

    Equation :eq:`information`.

    The objective I(X; Y | Theta) + I(Z; Theta) of arXiv:2305.06929, eq. 1, equals
    I(Z, X; Theta, Y), since given X the readings are independent of Z. It is computed exactly as

        h(P0) - E_z[h(P(survive | z))] + P0 * sum_i I(X_i; Y_i^(n_i) | survived n_i visits)

    With another alpha than 1, behavioral entropies take the place of Shannon's in the entropies of
    the outcome and of the targets (:eq:`behavioral-information`).

    Parameters
    ----------
    belief : Belief
        Belief before the deployment.
    model : SensorModel
        Believed sensor model of the robot.
    path : array_like of int, shape (steps + 1,)
        The cells in order.
    alpha : float
        As in `SearchOptions`.

    Returns
    -------
    float
        Nats. At least 0 except for rounding if alpha is at most 1; else it may be slightly
        negative, since the entropies are then convex near certainty.

    Raises
    ------
    ValueError
        If the path has no step or leaves the belief's cells, or alpha is out of range.

    """
    options = None if alpha == SHANNON else SearchOptions(objective='behavioral', alpha=alpha)
    return Objective.of(belief, model, options).evaluate(path)[0]


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


# Decimals of compared values, nats: closer values are ties, so rounding errors never decide.
DECIMALS = 9


class Candidate(NamedTuple):
    """A closed path and its objective value."""

    # The objective value, nats, rounded.
    value: float
    # Cells, the base first and last, shape (steps + 1,).
    path: Places

    @classmethod
    def along(cls, path: Places, objective: Objective) -> Candidate:
        """Return a path, shape (steps + 1,), with its exact value (:eq:`objective-value`)."""
        information, _ = objective.evaluate(path)
        lost = 1.0 - objective.survival(path)
        return cls(round(float(information - objective.loss_cost * lost), DECIMALS), path)
