# SPDX-License-Identifier: Apache-2.0
"""What may have become of robots that are sent but have not reported."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import prod

from kbnitp_ros.core.field import (
    as_path,
    Belief,
    log_predicted_survival,
    SensorModel,
    times_log,
    Visits,
)
from kbnitp_ros.core.inference import condition, lost_likelihood
from kbnitp_ros.core.planning.objective.readings import Camera, Most, most_counted
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Each robot doubles the joint outcomes; beyond these the least probable are merged.
MOST_OUTCOMES = 16

# A joint outcome less likely than this decides nothing, and its numbers would run out of digits.
NEGLIGIBLE = 1e-15


@dataclass(frozen=True, eq=False)
class JointOutcomes:
    """
    What may have become of the robots sent before: who of them returned and who was lost.

    Attributes
    ----------
    belief : Belief
        Before any of them was sent; it holds on in the cells that none of them visits.
    probability : ndarray, shape (outcomes,)
        Of each outcome.
    cells : ndarray of int, shape (n,)
        The cells that they visit, ascending.
    joint : ndarray, shape (outcomes, n, 2, 2)
        P(Z = z, X = x) of these cells given who returned and who was lost, but not yet what the
        returned ones read.
    readings : ndarray, shape (outcomes, n, *counts)
        P(the returned robots bring so many readings of the cell by each of their cameras), from 0
        up along an axis for each: certain but where several outcomes are merged.
    cameras : tuple of Camera
        Those of the robots.

    """

    belief: Belief
    probability: NDArray[np.float64]
    cells: NDArray[np.intp]
    joint: NDArray[np.float64]
    readings: NDArray[np.float64]
    cameras: tuple[Camera, ...] = ()

    @property
    def most_readings(self) -> Most:
        """Return the most readings of a cell by each camera."""
        return tuple(zip(self.cameras, (count - 1 for count in self.readings.shape[2:])))

    @property
    def states(self) -> int:
        """Return how many numbers of readings by each camera there may be."""
        return prod(self.readings.shape[2:])

    def states_after(self, model: SensorModel, visits: int) -> int:
        """Return how many there may be with so many visits of one more robot."""
        own = dict(self.most_readings).get(Camera.of(model), 0) + 1
        return self.states // own * (own + visits)

    def of_cells(self, cells: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the joints and the readings of any cells."""
        outcomes = self.probability.size
        joint = np.tile(self.belief.joint[cells], (outcomes, 1, 1, 1))
        readings = np.zeros((outcomes, cells.size, self.states))
        readings[:, :, 0] = 1.0
        here, there = self.places_of(cells)
        joint[:, here] = self.joint[:, there]
        readings[:, here] = self.readings[:, there].reshape(outcomes, there.size, self.states)
        return joint, readings

    def places_of(self, cells: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return where in any `cells`, shape (k,), and where in its own the same cells stand."""
        there = np.searchsorted(self.cells, cells)
        here = np.flatnonzero(np.append(self.cells, -1)[there] == cells)
        return here, there[here]


def nobody_deployed(belief: Belief) -> JointOutcomes:
    """Return the only joint outcome of no robots: all is as believed."""
    none = np.empty(0, dtype=np.intp)
    return JointOutcomes(belief, np.ones(1), none, np.empty((1, 0, 2, 2)), np.empty((1, 0)))


def after_deployment(
    outcomes: JointOutcomes, model: SensorModel, path: ArrayLike
) -> JointOutcomes:
    """
    Return the joint outcomes once one more robot is sent.

    Equation :eq:`joint-outcomes`.

    Each splits in two. A return is assimilated exactly; of a loss the cells keep their exact
    marginals but not their dependence. Of more than `MOST_OUTCOMES` the least probable
    become one, each cell their average.
    """
    visits = Visits.of(as_path(path))
    cells = np.union1d(outcomes.cells, visits.cells)
    at = np.searchsorted(cells, visits.cells)
    joint, readings = outcomes.of_cells(cells)
    camera, counts = Camera.of(model), outcomes.readings.shape[2:]
    cameras = outcomes.cameras
    if camera not in cameras:
        cameras, counts = (*cameras, camera), (*counts, 1)
    axis = 2 + cameras.index(camera)
    room = [(0, 0)] * (2 + len(cameras))
    room[axis] = (0, visits.counts.max())
    readings = np.pad(readings.reshape(*readings.shape[:2], *counts), room)

    hazard = joint[:, at, 1].sum(axis=-1).clip(max=1.0)
    log_survival = log_predicted_survival(hazard, visits.counts, model.log_survival).sum(axis=1)

    # Each outcome's loss and then its return, without those that are next to impossible.
    chance = np.stack([-np.expm1(log_survival), np.exp(log_survival)], axis=1)
    probability = (outcomes.probability[:, None] * chance).ravel()
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
        readings[more] = np.roll(readings[more], count, axis=axis)
    readings = _counted(readings, most_counted(len(cameras)))
    return _merged(JointOutcomes(outcomes.belief, probability, cells, joint, readings, cameras))


def _counted(readings: NDArray[np.float64], most: int | None) -> NDArray[np.float64]:
    """Return readings by several cameras, of which those beyond `most` by one count no more."""
    if most is None:
        return readings
    for axis in range(2, readings.ndim):
        beyond = np.moveaxis(readings, axis, -1)
        if beyond.shape[-1] > most + 1:
            last = beyond[..., most:].sum(axis=-1, keepdims=True)
            readings = np.moveaxis(np.concatenate([beyond[..., :most], last], -1), -1, axis)
    return readings


def _merged(outcomes: JointOutcomes) -> JointOutcomes:
    """
    Return at most `MOST_OUTCOMES`: the last ones become one, in each cell their average.

    Equation :eq:`merged-outcomes`.
    """
    if outcomes.probability.size <= MOST_OUTCOMES:
        return outcomes
    alone = MOST_OUTCOMES - 1
    weights = outcomes.probability[alone:]
    joint, readings = (
        np.concatenate([each[:alone], np.average(each[alone:], axis=0, weights=weights)[None]])
        for each in (outcomes.joint, outcomes.readings)
    )
    probability = np.append(outcomes.probability[:alone], weights.sum())
    return replace(outcomes, probability=probability, joint=joint, readings=readings)
