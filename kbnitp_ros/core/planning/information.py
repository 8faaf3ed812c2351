# SPDX-License-Identifier: Apache-2.0
"""Expected information of paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from kbnitp_ros.core.field.belief import Belief, binary_entropy
from kbnitp_ros.core.field.check import typed
from kbnitp_ros.core.field.observation import as_path, Visits
from kbnitp_ros.core.field.sensor import log_predicted_survival, of_each, RobotType, SensorModel
from kbnitp_ros.core.planning.information_kernels import exposed, left_open, outcome_left_open
from kbnitp_ros.core.planning.objective import (
    after_deployment,
    behavioral_entropy,
    JointOutcomes,
    new_information,
    nobody_deployed,
    Objective,
    possible_readings,
)
from kbnitp_ros.core.planning.options import prelec_beta, SHANNON
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
    return added_information(belief, model, path, nobody_deployed(belief))


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
    approximated by `added_information`. For a single path it equals `path_information`.

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
    outcomes = nobody_deployed(belief) if outcomes is None else outcomes
    models = [each.model(model) for each in of_each(len(paths), robot_types)]
    information = 0.0
    for number, (path, own) in enumerate(zip(paths, models)):
        if number:
            outcomes = after_deployment(outcomes, models[number - 1], paths[number - 1])
        information += added_information(belief, own, path, outcomes)
    return information


def added_information(
    belief: Belief,
    model: SensorModel,
    path: ArrayLike,
    outcomes: JointOutcomes,
    alpha: float = SHANNON,
    interest: NDArray[np.float64] | None = None,
) -> float:
    """Return the information of a path (:eq:`added-information`, :eq:`behavioral-information`)."""
    cells = as_path(path)
    if cells.min() < 0 or cells.max() >= belief.cells:
        raise ValueError(
            f'path has cells from {cells.min()} to {cells.max()}: '
            f'the belief has the cells 0 to {belief.cells - 1}'
        )
    return information_and_survival(belief, model, cells, outcomes, alpha, interest)[0]


def information_and_survival(
    belief: Belief,
    model: SensorModel,
    path: NDArray[np.intp],
    outcomes: JointOutcomes,
    alpha: float = SHANNON,
    interest: NDArray[np.float64] | None = None,
) -> tuple[float, NDArray[np.float64]]:
    """Return the information added, and the chance of a return given each joint outcome."""
    visits = Visits.of(path)
    joint, earlier = outcomes.of_cells(visits.cells)
    hazard = joint[:, :, 1].sum(axis=-1).clip(max=1.0)
    log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival)
    survival = np.exp(log_survival.sum(axis=1))
    readings = possible_readings(model, int(visits.counts.max()), outcomes.most_readings)
    exposures = exposed(visits.of_step, belief.hazard[visits.cells], *model.log_survival)
    added = new_information(readings, joint, earlier, alpha)
    added = added[:, np.arange(visits.cells.size), visits.counts - 1]
    if interest is not None:
        added = added * interest[visits.cells]
    if alpha == SHANNON:
        outcome, open_outcome = binary_entropy(survival), left_open(*exposures)
    else:
        outcome = behavioral_entropy(survival, alpha)
        open_outcome = outcome_left_open(*exposures, alpha, prelec_beta(alpha))
    of_each = outcome + survival * added.sum(axis=1) - open_outcome
    return float((outcomes.probability * of_each).sum()), survival


@typed
def behavioral_information(
    belief: Belief,
    model: SensorModel,
    path: ArrayLike,
    alpha: float,
    outcomes: JointOutcomes | None = None,
    interest: NDArray[np.float64] | None = None,
) -> float:
    """
    Return the information of a path with behavioral entropies instead of Shannon's.

    Equation :eq:`behavioral-information`: the information that a return or loss gives about the
    hazards, plus the expected entropy of targets that readings of a returned robot remove.

    Parameters
    ----------
    belief, model, path
        As in `path_information`.
    alpha, interest
        As in `Objective`.
    outcomes : JointOutcomes, optional
        Joint outcomes of robots sent before; by default none.

    Returns
    -------
    float
        Nats; if alpha is at most 1, at least 0 except for rounding. With alpha above 1 it may be
        slightly negative, since the entropies are then convex near certainty.

    """
    outcomes = nobody_deployed(belief) if outcomes is None else outcomes
    return added_information(belief, model, path, outcomes, alpha, interest)


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
        belief, model = objective.belief, objective.model
        lost = -np.expm1(path_log_survival(belief, model, as_path(path)))
        alpha = objective.alpha
        interest = None if alpha == SHANNON else objective.interest
        information = added_information(belief, model, path, objective.outcomes, alpha, interest)
        return cls(round(float(information - objective.loss_cost * lost), DECIMALS), path)

    def survival(self, objective: Objective) -> float:
        """Return the chance that a robot returns, under the belief of the objective."""
        return float(np.exp(path_log_survival(objective.belief, objective.model, self.path)))
