# SPDX-License-Identifier: Apache-2.0
"""The information that deployments are expected to bring."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from math import lgamma

from kbnitp_ros.core.field import (
    as_path,
    Belief,
    binary_entropy,
    log_predicted_survival,
    SensorModel,
    surprisal,
    times_log,
    Visits,
)
from kbnitp_ros.core.planning.fates import after_sending, Fates, nobody_sent
from kbnitp_ros.core.planning.information_kernels import left_open, new_readings
import numpy as np
from numpy.typing import ArrayLike, NDArray


def path_information(belief: Belief, model: SensorModel, path: ArrayLike) -> float:
    """
    Return the mutual information between the field and the outcome of one deployment.

    The paper's objective I(X; Y | Theta) + I(Z; Theta) equals the whole I(Z, X; Theta, Y), since
    the readings tell of Z nothing that X does not. It is computed exactly as

        h(P0) - E_z[h(P(survive | z))] + P0 * sum_i I(X_i; Y_i^(n_i) | survived n_i visits)

    Parameters
    ----------
    belief : Belief
        Before the deployment.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    path : array_like of int, shape (steps + 1,)
        The cells in order.

    Returns
    -------
    float
        Nats, at least 0 but for rounding.

    Raises
    ------
    ValueError
        If the path has no step or leaves the belief's cells.

    """
    return added_information(belief, model, path, nobody_sent(belief))


def team_information(
    belief: Belief,
    model: SensorModel,
    paths: Iterable[ArrayLike],
    fates: Fates | None = None,
) -> float:
    """
    Return the mutual information between the field and the outcomes of several deployments.

    By the chain rule the sum of what each path adds to those before it, as `added_information`
    approximates that; of a single path exactly `path_information`.

    Parameters
    ----------
    belief : Belief
        Before the deployments.
    model : SensorModel
        What the robots and their sensors are believed to be like.
    paths : iterable of array_like of int, each of shape (steps + 1,)
        The cells of each robot's path in order.
    fates : Fates, optional
        Of robots that have left before, to whose information this is added; without it nobody
        has.

    Returns
    -------
    float
        Nats.

    Raises
    ------
    ValueError
        If a path has no step or leaves the belief's cells.

    """
    fates = nobody_sent(belief) if fates is None else fates
    information = 0.0
    for path in paths:
        information += added_information(belief, model, path, fates)
        fates = after_sending(fates, model, path)
    return information


def added_information(belief: Belief, model: SensorModel, path: ArrayLike, fates: Fates) -> float:
    """
    Return the information that a deployment is expected to add to what robots before it bring.

    Their readings of a cell and the path's own count together, less what theirs tell alone. Two
    things are approximated: that losses tie cells together is forgotten, and what the earlier
    robots' readings tell of hazards does not make the path's own fate any surer.

    Parameters
    ----------
    belief : Belief
        Before all of these deployments.
    model : SensorModel
        What the robots and their sensors are believed to be like.
    path : array_like of int, shape (steps + 1,)
        The cells in order.
    fates : Fates
        Of the robots before.

    Returns
    -------
    float
        Nats.

    Raises
    ------
    ValueError
        If the path has no step or leaves the belief's cells.

    """
    cells = as_path(path)
    if cells.min() < 0 or cells.max() >= belief.cells:
        raise ValueError(
            f'path has cells from {cells.min()} to {cells.max()}: '
            f'the belief has the cells 0 to {belief.cells - 1}'
        )
    visits = Visits.of(cells)
    joint, readings = fates.of_cells(visits.cells)
    hazard = joint[:, :, 1].sum(axis=-1).clip(max=1.0)
    log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival)
    survival = np.exp(log_survival.sum(axis=1))
    read = Readings.of(model, int(visits.counts.max()), readings.shape[-1] - 1)
    added = read.new(joint, readings, visits.counts).sum(axis=1)
    # What is left open is the same whatever became of the others.
    open_fate = left_open(visits.of_step, belief.hazard[visits.cells], *model.log_survival)
    of_each = binary_entropy(survival) + survival * added - open_fate
    return float((fates.probability * of_each).sum())


@dataclass(frozen=True, eq=False)
class Readings:
    """
    What any number of readings of a cell may be.

    Attributes
    ----------
    survival : ndarray, shape (most visits + 1, 2)
        P(n visits survived | Z = z), indexed [n, z].
    likelihood : ndarray, shape (most readings + 1, most readings + 1, 2)
        P(k of m readings are positive | X = x), indexed [m, k, x].
    noise : ndarray, shape (most readings + 1, 2)
        Entropy of that count, nats, indexed [m, x].

    """

    survival: NDArray[np.float64]
    likelihood: NDArray[np.float64]
    noise: NDArray[np.float64]

    @classmethod
    @lru_cache(maxsize=8)
    def of(cls, model: SensorModel, visits: int, earlier: int) -> Readings:
        """
        Return what up to `visits` readings of a robot, and up to `earlier` ones before, may be.

        Parameters
        ----------
        model : SensorModel
            What the robots and their sensors are believed to be like.
        visits, earlier : int
            At least 0.

        """
        most = visits + earlier
        m, k = np.ogrid[: most + 1, : most + 1]
        log_factorial = np.array([lgamma(count + 1.0) for count in range(most + 1)])
        orderings = log_factorial[m] - log_factorial[k] - log_factorial[np.maximum(m - k, 0)]
        read_not, read = model.log_reading
        log_likelihood = times_log(k[..., None], read)
        log_likelihood = log_likelihood + times_log(np.maximum(m - k, 0)[..., None], read_not)
        likelihood = np.exp(orderings[..., None] + log_likelihood) * (k <= m)[..., None]
        survival = np.exp(times_log(np.arange(visits + 1)[:, None], model.log_survival))
        return cls(survival, likelihood, surprisal(likelihood).sum(axis=1))

    def new(
        self,
        joint: NDArray[np.float64],
        earlier: NDArray[np.float64],
        visits: NDArray[np.intp],
    ) -> NDArray[np.float64]:
        """
        Return what a robot that survives n visits reads of cells on top of earlier readings.

        Parameters
        ----------
        joint : ndarray, shape (..., cells, 2, 2)
            P(Z = z, X = x).
        earlier : ndarray, shape (..., cells, most + 1)
            P(m earlier readings).
        visits : ndarray of int, shape (cells,)
            n, with a reading each.

        Returns
        -------
        ndarray, shape (..., cells)
            Nats; 0 where n visits cannot be survived.

        """
        information = np.empty(joint.shape[:-2])
        new_readings(
            np.ascontiguousarray(joint).reshape(-1, 2, 2),
            np.ascontiguousarray(earlier).reshape(-1, earlier.shape[-1]),
            np.broadcast_to(visits, information.shape).ravel(),
            self.survival,
            self.likelihood,
            self.noise,
            information.reshape(-1),
        )
        return information
