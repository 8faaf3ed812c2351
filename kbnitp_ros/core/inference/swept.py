# SPDX-License-Identifier: Apache-2.0
"""
Smoothing as it was computed first: all messages are sent again after each deployment.

Beliefs that were recorded then are reproduced bit for bit by the same arithmetic only. Beliefs are
the same as those of `smoothed` up to how far ten sweeps come, where they settle at all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

from kbnitp_ros.core.field import Belief, Kind, Observation, SensorModel, times_log, Visits
from kbnitp_ros.core.inference.evidence import check_cells, condition, returned_log_likelihood
from kbnitp_ros.core.inference.told import Told
import numpy as np
from numpy.typing import NDArray

# How far messages move in a sweep. All the way, they may swing between two answers for good where
# many losses share their cells.
STEP = 0.7
SWEEPS = 10
# A change of messages, in log odds, too small to go on for.
SETTLED = 1e-4
CONDITIONED_CELLS = 4
# Log odds beyond which a cell is as good as certain: keeps infinities out of the messages.
CERTAIN = 500.0
SMALLEST = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Losses:
    """
    The lost paths, one entry for each cell of each.

    Attributes
    ----------
    cell, factor : ndarray of int, shape (entries,)
        The cell, and which path it is a cell of.
    log_spared : ndarray, shape (entries, 2)
        log s_z^n of the path's n visits to the cell.
    count : int
        How many paths.

    """

    cell: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    factor: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    log_spared: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    count: int = 0

    def and_one_of(self, visits: Visits, model: SensorModel) -> Losses:
        """Return the losses and one more, of a robot that made these visits."""
        return Losses(
            np.concatenate([self.cell, visits.cells]),
            np.concatenate([self.factor, np.full(visits.cells.size, self.count)]),
            np.concatenate(
                [self.log_spared, times_log(visits.counts[:, None], model.log_survival)]
            ),
            self.count + 1,
        )


class SweptSmoother(Told):
    """
    The evidence of a mission and the belief it gives.

    No array is changed once it is made, so a shallow copy is a smoother of its own.

    Parameters
    ----------
    prior : Belief
        Before the first deployment.
    model : SensorModel
        What the robots and their sensors are believed to be like.

    """

    def __init__(self, prior: Belief, model: SensorModel, *_: object) -> None:
        super().__init__(prior, model)
        self._prior = prior
        with np.errstate(divide='ignore'):
            self._log_prior = np.log(prior.joint)
        self._returned = np.zeros((prior.cells, 2, 2))
        self._losses = Losses()
        self._messages: NDArray[np.float64] = np.empty((1, 0))
        self._visited = np.zeros(prior.cells, dtype=bool)

    def assimilate(self, observation: Observation, kind: Kind) -> None:
        """
        Take in one more deployment, at the cost of a few message sweeps.

        Raises
        ------
        ValueError
            If its path leaves the field or the outcome is impossible; the evidence then stays as
            it was.

        """
        check_cells(self._prior, observation)
        visits, model = Visits.of(observation.path), kind.model(self.model)
        returned, losses = self._returned, self._losses
        if observation.readings is not None:
            returned = returned.copy()
            returned[visits.cells] += returned_log_likelihood(model, visits, observation.readings)
        else:
            losses = losses.and_one_of(visits, model)
        self._check_possible(returned, losses)
        self._returned, self._losses = returned, losses
        self._messages = np.pad(
            self._messages, ((0, 0), (0, losses.cell.size - self._messages.shape[1]))
        )
        self._visited = self._visited.copy()
        self._visited[visits.cells] = True
        self.belief = self._belief()

    def _check_possible(self, returned: NDArray[np.float64], losses: Losses) -> None:
        """Refuse evidence that not even a hazard in every cell that may have one explains."""
        by_hazard = np.logaddexp.reduce(self._log_prior + returned, axis=2)
        explained = np.isfinite(by_hazard.max(axis=1)).all()
        hazardous = np.isfinite(by_hazard[losses.cell, 1]).astype(np.intp)
        spared = losses.log_spared[np.arange(losses.cell.size), hazardous]
        if not (explained and (sum_by(losses.factor, spared[None], losses.count) < 0.0).all()):
            raise ValueError(
                'the outcome is impossible under this prior, sensor model and what came before: '
                'allow for it with probabilities that are not exactly 0 or 1'
            )

    def _local_odds(self) -> NDArray[np.float64]:
        """Return the log odds of each hazard without the losses, shape (cells,)."""
        by_hazard = np.logaddexp.reduce(self._log_prior + self._returned, axis=2)
        odds: NDArray[np.float64] = by_hazard[:, 1] - by_hazard[:, 0]
        return odds

    def _belief(self) -> Belief:
        odds = self._local_odds().clip(-CERTAIN, CERTAIN)
        evidence = self._returned.copy()
        evidence[:, 1] += (self._smoothed_odds(odds) - odds)[:, None]
        joint = self._prior.joint.copy()
        joint[self._visited] = condition(joint[self._visited], evidence[self._visited])
        return Belief(joint)

    def _smoothed_odds(self, odds: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the log odds of each hazard given all evidence, from those without the losses."""
        if not self._losses.count:
            return odds
        self._messages = self._settled(odds[None], self._messages)
        fixed = self._most_entangled(odds)
        values = np.array(list(product((0.0, 1.0), repeat=fixed.size)), ndmin=2)
        conditioned = np.tile(odds, (len(values), 1))
        conditioned[:, fixed] = np.where(values, CERTAIN, -CERTAIN)
        messages = self._settled(conditioned, np.tile(self._messages, (len(values), 1)))
        weight = self._log_evidence(conditioned, messages)
        weight -= softplus(np.where(values, -1.0, 1.0) * odds[fixed]).sum(axis=1)
        total = self._total_odds(conditioned, messages)
        hazardous: NDArray[np.float64] = np.logaddexp.reduce(weight[:, None] - softplus(-total))
        safe: NDArray[np.float64] = np.logaddexp.reduce(weight[:, None] - softplus(total))
        return hazardous - safe

    def _most_entangled(self, odds: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the undecided cells that the losses say most about."""
        total = self._total_odds(odds[None], self._messages)[0]
        hazard = np.exp(-softplus(-total))
        said = np.bincount(self._losses.cell, np.abs(self._messages[0]), minlength=odds.size)
        score = said * hazard * (1.0 - hazard)
        best: NDArray[np.intp] = np.argsort(-score, kind='stable')[:CONDITIONED_CELLS]
        return best[: np.count_nonzero(score[best])]

    def _total_odds(
        self, odds: NDArray[np.float64], messages: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return each cell's log odds with all messages to it, shape (values, cells)."""
        return odds + sum_by(self._losses.cell, messages, odds.shape[1])

    def _cavity_survival(
        self, odds: NDArray[np.float64], messages: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return log odds and log S of each entry, without what its own factor says."""
        cavity = self._total_odds(odds, messages)[:, self._losses.cell] - messages
        hazard = 0.5 + 0.5 * np.tanh(0.5 * cavity)
        lost = -np.expm1(self._losses.log_spared)
        loss = lost[:, 0] + hazard * (lost[:, 1] - lost[:, 0])
        return cavity, np.log((1.0 - loss).clip(min=SMALLEST))

    def _settled(
        self, odds: NDArray[np.float64], messages: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the messages after enough damped sweeps that they hardly change, or `SWEEPS`."""
        for _ in range(SWEEPS):
            change = STEP * (self._sweep(odds, messages) - messages)
            messages = messages + change
            if np.abs(change).max() < SETTLED:
                break
        return messages

    def _sweep(
        self, odds: NDArray[np.float64], messages: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """
        Return the next messages of all factors at once.

        The message to cell i is log(1 - s1^n prod S_k) - log(1 - s0^n prod S_k), the products
        over the factor's other cells.

        Parameters
        ----------
        odds : ndarray, shape (values, cells)
            Log odds of each hazard without the losses, for each value of the fixed cells.
        messages : ndarray, shape (values, entries)
            Before.

        """
        _, survival = self._cavity_survival(odds, messages)
        others = (
            sum_by(self._losses.factor, survival, self._losses.count)[:, self._losses.factor]
            - survival
        )
        lost = -np.expm1(self._losses.log_spared + others[..., None])
        log_lost = np.log(lost.clip(min=SMALLEST))
        message: NDArray[np.float64] = log_lost[..., 1] - log_lost[..., 0]
        return message

    def _log_evidence(
        self, odds: NDArray[np.float64], messages: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the Bethe log evidence of the losses, shape (values,)."""
        cavity, survival = self._cavity_survival(odds, messages)
        total = self._total_odds(odds, messages)
        lost = -np.expm1(sum_by(self._losses.factor, survival, self._losses.count))
        factors = np.log(lost.clip(min=SMALLEST)).sum(axis=1)
        cells = (softplus(total) - softplus(odds)).sum(axis=1)
        entries = (softplus(cavity + messages) - softplus(cavity)).sum(axis=1)
        evidence: NDArray[np.float64] = factors + cells - entries
        return evidence


def softplus(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log(1 + exp(x)) without overflow: minus the log of P(Z = 0) at log odds x."""
    result: NDArray[np.float64] = np.logaddexp(0.0, log_odds)
    return result


def sum_by(
    group: NDArray[np.intp], values: NDArray[np.float64], groups: int
) -> NDArray[np.float64]:
    """Return the sums of `values`, shape (rows, entries), over equal `group`, (rows, groups)."""
    rows = len(values)
    place = np.arange(rows)[:, None] * groups + group
    sums = np.bincount(place.ravel(), values.ravel(), rows * groups)
    return sums.reshape(rows, groups).astype(np.float64, copy=False)
