# SPDX-License-Identifier: Apache-2.0
"""The information that deployments are expected to bring."""

from __future__ import annotations

from collections.abc import Iterable
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
from kbnitp_ros.core.planning.fates import after_sending, Fate, nobody_sent
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
    fates: tuple[Fate, ...] | None = None,
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
    fates : tuple of Fate, optional
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


def added_information(
    belief: Belief, model: SensorModel, path: ArrayLike, fates: tuple[Fate, ...]
) -> float:
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
    fates : tuple of Fate
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
    steps = len(cells) - 1
    exposures = np.zeros(steps + 1)
    exposures[0] = 1.0
    for z, count in zip(belief.hazard[visits.cells], visits.counts):
        exposures[count:] = (1.0 - z) * exposures[count:] + z * exposures[:-count]
        exposures[:count] *= 1.0 - z
    left_open = float(exposures @ fate_entropy(model, steps))
    information = 0.0
    for fate in fates:
        hazard = fate.belief.hazard[visits.cells]
        survival = np.exp(log_predicted_survival(hazard, visits.counts, model.log_survival).sum())
        read = sum(
            new_reading_information(fate, model, visits.cells[visits.counts == count], count).sum()
            for count in np.unique(visits.counts)
        )
        # What is left open is the same whatever became of the others.
        information += fate.probability * (binary_entropy(survival) - left_open + survival * read)
    return float(information)


def fate_entropy(model: SensorModel, steps: int) -> NDArray[np.float64]:
    """
    Return the entropy of a robot's fate for each number of exposures to hazards.

    Parameters
    ----------
    model : SensorModel
        Gives s0 and s1.
    steps : int
        Of the path, at least 1.

    Returns
    -------
    ndarray, shape (steps + 1,)
        h(s0^(steps - c) s1^c) for c = 0 to `steps` steps into hazardous cells, in nats.

    """
    exposures = np.arange(steps + 1)
    safe, deadly = model.log_survival
    return binary_entropy(
        np.exp(times_log(steps - exposures, safe) + times_log(exposures, deadly))
    )


def new_reading_information(
    fate: Fate, model: SensorModel, cells: NDArray[np.intp], visits: int
) -> NDArray[np.float64]:
    """
    Return what a robot that survives n visits reads of cells on top of earlier robots' readings.

    Parameters
    ----------
    fate : Fate
        Of the earlier robots.
    model : SensorModel
        What the robots and their sensors are believed to be like.
    cells : ndarray of int, shape (n_cells,)
        Which.
    visits : int
        n, at least 1, with a reading each.

    Returns
    -------
    ndarray, shape (n_cells,)
        Nats; 0 where n visits cannot be survived.

    """
    information = np.zeros(len(cells))
    for earlier, chance in enumerate(fate.readings[cells].T):
        some = chance > 0.0
        if not some.any():
            continue
        joint = fate.belief.joint[cells[some]]
        added = reading_information(joint, model, visits, visits + earlier)
        if earlier:
            added -= reading_information(joint, model, visits, earlier)
        information[some] += chance[some] * added
    return information


def reading_information(
    joint: NDArray[np.float64], model: SensorModel, visits: int, readings: int
) -> NDArray[np.float64]:
    """
    Return I(X; Y^m | a robot survived n visits) of cells, with m readings in each.

    The readings enter through their count of positives, which is sufficient.

    Parameters
    ----------
    joint : ndarray, shape (n_cells, 2, 2)
        The cells' joint beliefs.
    model : SensorModel
        What the robot and its sensor are believed to be like.
    visits : int
        n, at least 1.
    readings : int
        m, at least 1.

    Returns
    -------
    ndarray, shape (n_cells,)
        Nats; 0 where n visits cannot be survived.

    """
    survived = joint * np.exp(visits * model.log_survival)[:, None]
    total = survived.sum(axis=(1, 2))
    target = survived.sum(axis=1) / np.where(total > 0.0, total, 1.0)[:, None]
    positives = np.arange(readings + 1)
    orderings = np.array(
        [lgamma(readings + 1) - lgamma(k + 1) - lgamma(readings - k + 1) for k in positives]
    )
    read_not, read = model.log_reading
    given = np.exp(
        orderings[:, None]
        + times_log(positives[:, None], read)
        + times_log((readings - positives)[:, None], read_not)
    )
    entropy: NDArray[np.float64] = surprisal(target @ given.T).sum(axis=1)
    entropy -= target @ surprisal(given).sum(axis=0)
    return entropy
