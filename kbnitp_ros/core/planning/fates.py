# SPDX-License-Identifier: Apache-2.0
"""What may have become of robots that are sent but have not reported."""

from __future__ import annotations

from dataclasses import dataclass

from kbnitp_ros.core.field import (
    as_path,
    Belief,
    log_predicted_survival,
    SensorModel,
    times_log,
    Visits,
)
from kbnitp_ros.core.inference import condition, lost_likelihood
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Each robot doubles the fates; beyond these the least probable are merged.
MOST_FATES = 16

# A fate less likely than this decides nothing, and its numbers would run out of digits.
NEGLIGIBLE = 1e-15


@dataclass(frozen=True, eq=False)
class Fates:
    """
    What may have become of the robots sent before: who of them returned and who was lost.

    Attributes
    ----------
    belief : Belief
        Before any of them was sent; it holds on in the cells that none of them visits.
    probability : ndarray, shape (fates,)
        Of each fate.
    cells : ndarray of int, shape (n,)
        The cells that they visit, ascending.
    joint : ndarray, shape (fates, n, 2, 2)
        P(Z = z, X = x) of these cells given who returned and who was lost, but not yet what the
        returned ones read.
    readings : ndarray, shape (fates, n, most + 1)
        P(the returned robots bring m readings of the cell) for m = 0 to `most`: certain but where
        several fates are merged.

    """

    belief: Belief
    probability: NDArray[np.float64]
    cells: NDArray[np.intp]
    joint: NDArray[np.float64]
    readings: NDArray[np.float64]

    def of_cells(self, cells: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """
        Return the joints and the readings of any cells.

        Parameters
        ----------
        cells : ndarray of int, shape (k,)
            In any order.

        Returns
        -------
        joint : ndarray, shape (fates, k, 2, 2)
            As the attribute.
        readings : ndarray, shape (fates, k, most + 1)
            As the attribute.

        """
        fates, _, most = self.readings.shape
        joint = np.tile(self.belief.joint[cells], (fates, 1, 1, 1))
        readings = np.zeros((fates, cells.size, most))
        readings[:, :, 0] = 1.0
        here, there = self.places_of(cells)
        joint[:, here] = self.joint[:, there]
        readings[:, here] = self.readings[:, there]
        return joint, readings

    def places_of(self, cells: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return where in any `cells`, shape (k,), and where in its own the same cells stand."""
        there = np.searchsorted(self.cells, cells)
        here = np.flatnonzero(np.append(self.cells, -1)[there] == cells)
        return here, there[here]


def nobody_sent(belief: Belief) -> Fates:
    """Return the only fate of no robots: all is as believed."""
    none = np.empty(0, dtype=np.intp)
    return Fates(belief, np.ones(1), none, np.empty((1, 0, 2, 2)), np.empty((1, 0, 1)))


def after_sending(fates: Fates, model: SensorModel, path: ArrayLike) -> Fates:
    """
    Return the fates once one more robot is sent.

    Each fate splits in two. A return is taken in exactly; of a loss the cells keep their exact
    marginals but not that it ties them together. Of more than `MOST_FATES` the least probable
    become one, each cell their average.

    Parameters
    ----------
    fates : Fates
        Of the robots before.
    model : SensorModel
        What the robots are believed to be like.
    path : array_like of int, shape (steps + 1,)
        Of the robot, its cells in order.

    Returns
    -------
    Fates
        Their probabilities sum to 1 but for rounding.

    """
    visits = Visits.of(as_path(path))
    cells = np.union1d(fates.cells, visits.cells)
    at = np.searchsorted(cells, visits.cells)
    joint, readings = fates.of_cells(cells)
    readings = np.pad(readings, ((0, 0), (0, 0), (0, visits.counts.max())))

    hazard = joint[:, at, 1].sum(axis=-1).clip(max=1.0)
    log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival).sum(axis=1)

    # Each fate's loss and then its return, without those that are next to impossible.
    chance = np.stack([-np.expm1(log_survival), np.exp(log_survival)], axis=1)
    probability = (fates.probability[:, None] * chance).ravel()
    order = np.argsort(-probability, kind='stable')
    kept = order[probability[order] > NEGLIGIBLE]
    origin, is_return = kept // 2, kept % 2 == 1
    probability, joint, readings = probability[kept], joint[origin], readings[origin]

    log_likelihood = np.tile(
        times_log(visits.counts[:, None], model.log_survival), (kept.size, 1, 1)
    )
    with np.errstate(divide='ignore'):
        log_likelihood[~is_return] = np.log(
            lost_likelihood(hazard[origin[~is_return]], model, visits)
        )
    visited = joint[:, at].reshape(-1, 2, 2)
    joint[:, at] = condition(visited, log_likelihood.reshape(-1, 2, 1)).reshape(
        kept.size, at.size, 2, 2
    )
    for count in np.unique(visits.counts):
        more = np.ix_(is_return, at[visits.counts == count])
        readings[more] = np.roll(readings[more], count, axis=-1)
    return _merged(Fates(fates.belief, probability, cells, joint, readings))


def _merged(fates: Fates) -> Fates:
    """Return at most `MOST_FATES`: the last ones become one, in each cell their average."""
    if fates.probability.size <= MOST_FATES:
        return fates
    alone = MOST_FATES - 1
    weights = fates.probability[alone:]
    return Fates(
        fates.belief,
        np.append(fates.probability[:alone], weights.sum()),
        fates.cells,
        *(
            np.concatenate([each[:alone], np.average(each[alone:], axis=0, weights=weights)[None]])
            for each in (fates.joint, fates.readings)
        ),
    )
