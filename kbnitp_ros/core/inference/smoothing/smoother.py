# SPDX-License-Identifier: Apache-2.0
"""
Smoothing: all losses held as factors, by belief propagation conditioned on a few cells.

A loss ties the hazards of its path together, which a belief of independent cells forgets. Here
every lost path stays a factor over its cells, 1 - prod_i s_{z_i}^{n_i} or the sum over steps where
more is known of the loss, and every return a local log-likelihood. Sum-product messages between
them give the marginals. Where losses share cells the graph has cycles and plain messages count
evidence twice; the cells that carry most of it are therefore fixed to each of their joint values
in turn (cutset conditioning, Pearl 1988), and the answers are averaged with the Bethe
approximation of each value's evidence as weights.

All messages are kept from one deployment to the next, and only factors whose cells have something
new to tell send again. So a deployment costs what it changes, however many came before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from kbnitp_ros.core.field import Belief, Observation, RobotType, SensorModel, Visits
from kbnitp_ros.core.inference.filtering import (
    can_be_lost,
    check_cells,
    condition,
    KnownModel,
    returned_log_likelihood,
    survived_log_likelihood,
)
from kbnitp_ros.core.inference.smoothing.losses import Losses
from kbnitp_ros.core.inference.smoothing.message_kernels import MessageState, propagate
import numpy as np
from numpy.typing import NDArray

# The relative change of a cell's probability to destroy a robot above which it sends again.
TOLERANCE = 1e-4
ROUNDS = 30
CONDITIONED_CELLS = 4
# Decimals to which cells are compared before some are fixed, so that rounding decides nothing.
DECIMALS = 8


@dataclass(frozen=True)
class Messages:
    """
    What cells and factors tell each other, in rows: one for each value of the fixed cells.

    Attributes
    ----------
    losses : Losses
        The factors.
    first_silent : int
        The first factor that has sent nothing yet.
    rows : MessageState
        Each array has one row for each value.

    """

    losses: Losses
    first_silent: int
    rows: MessageState

    @classmethod
    def none(cls, losses: Losses) -> Messages:
        """Return one row, for no losses."""
        nothing = np.empty((1, 0))
        return cls(losses, 0, MessageState(nothing, nothing, nothing, nothing, np.zeros((1, 1))))

    def repeated(self, count: int) -> Messages:
        """Return so many rows, each a copy of the one that there is; all factors have sent."""
        rows = MessageState(*(np.repeat(each, count, axis=0) for each in self.rows))
        return Messages(self.losses, self.losses.factors, rows)

    def grown(self, losses: Losses, odds: NDArray[np.float64]) -> Messages:
        """
        Return a copy for one more loss, or none.

        Parameters
        ----------
        losses : Losses
            All of them now.
        odds : ndarray, shape (cells of the losses,)
            Log odds without the losses, which is what new cells tell.

        """
        known, graph = self.rows, losses.graph
        rows = MessageState(
            sent_odds=padded(known.sent_odds, odds),
            messages=padded(known.messages, np.zeros(len(graph.node))),
            message_sums=padded(known.message_sums, np.zeros(len(odds))),
            terms=padded(known.terms, np.zeros(losses.factors)),
            evidence=known.evidence.copy(),
        )
        first_silent = self.losses.factors
        for factor in np.flatnonzero(
            graph.copies[:first_silent] > self.losses.graph.copies
        ).tolist():
            entries = losses.entries(factor)
            rows.message_sums[:, graph.node[entries]] += rows.messages[:, entries]
            rows.evidence[:, 0] += rows.terms[:, factor]
        return Messages(losses, first_silent, rows)

    def propagate(self, odds: NDArray[np.float64], in_turn: bool) -> None:
        """
        Send messages until they hardly change.

        Parameters
        ----------
        odds : ndarray, shape (rows, cells of the losses)
            Log odds without the losses.
        in_turn : bool
            Whether each row starts from where the row before it ends.

        """
        graph, destroyed = self.losses.graph, self.losses.destroyed
        for row, row_odds in enumerate(odds):
            if in_turn and row:
                for each in self.rows:
                    each[row] = each[row - 1]
            state = MessageState(*(each[row] for each in self.rows))
            propagate(graph, state, self.first_silent, row_odds, destroyed, TOLERANCE, ROUNDS)

    def log_evidence(self, odds: NDArray[np.float64]) -> NDArray[np.float64]:
        """
        Return the Bethe log evidence of the losses, shape (rows,).

        Equation :eq:`loss-evidence`.
        """
        message_sums = self.rows.message_sums
        with np.errstate(invalid='ignore'):
            cells = softplus(odds + message_sums) - softplus(odds)
        cells = np.where(odds == np.inf, message_sums, np.where(odds == -np.inf, 0.0, cells))
        evidence: NDArray[np.float64] = self.rows.evidence[:, 0] + cells.sum(axis=1)
        return evidence


class Smoother(KnownModel):
    """
    The evidence of a mission and the belief it gives.

    No array is changed once a deployment is assimilated, so a shallow copy is independent.

    Parameters
    ----------
    prior : Belief
        Before the first deployment.
    model : SensorModel
        What robots like all others, and their sensors, are believed to be like.

    """

    version: ClassVar[int] = 2
    takes_lost_at: ClassVar[bool] = True

    def __init__(self, prior: Belief, model: SensorModel, *_: object) -> None:
        super().__init__(prior, model)
        self._prior = prior
        with np.errstate(divide='ignore'):
            self._log_prior = np.log(prior.joint)
        # What returns and last contacts say of single cells, and the hazards' log odds given that.
        self._local = np.zeros((prior.cells, 2, 2))
        self._odds = log_odds(self._log_prior)
        self._losses = Losses.none(prior.cells)
        self._plain = Messages.none(self._losses)
        self._fixed: NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self._conditioned = self._plain
        self._visited = np.zeros(prior.cells, dtype=bool)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """
        Assimilate one more deployment, at the cost of the messages that it changes.

        A ValueError says that its path leaves the field or the outcome is impossible.
        """
        check_cells(self._prior, observation)
        losses, model = self._losses, robot_type.model(self.model)
        if observation.readings is not None:
            visits = Visits.of(observation.path)
            log_likelihood = returned_log_likelihood(model, visits, observation.readings)
        else:
            visits = Visits.of(observation.path[: observation.steps_survived + 1])
            log_likelihood = survived_log_likelihood(model, visits)[:, :, None]
            path, lost_at = observation.lost_on
            losses = losses.with_loss(path, model, lost_at)
        local, odds = self._local.copy(), self._odds.copy()
        local[visits.cells] += log_likelihood
        odds[visits.cells] = log_odds((self._log_prior + local)[visits.cells])
        check_possible(odds, losses)
        self._local, self._odds, self._losses = local, odds, losses
        self._visited = self._visited.copy()
        self._visited[visits.cells] = self._visited[losses.cells] = True
        self.belief = self._belief()

    def _belief(self) -> Belief:
        evidence = self._local.copy()
        if self._losses.factors:
            evidence[self._losses.cells, 1] += self._smoothed()[:, None]
        joint = self._prior.joint.copy()
        joint[self._visited] = condition(joint[self._visited], evidence[self._visited])
        return Belief(joint)

    def _smoothed(self) -> NDArray[np.float64]:
        """
        Return what the losses add to the log odds of their cells.

        Equation :eq:`loss-cutset`.
        """
        odds = self._odds[self._losses.cells]
        self._plain = self._plain.grown(self._losses, odds)
        self._plain.propagate(odds[None], False)
        fixed = most_entangled(odds, self._plain.rows.message_sums[0])
        values = gray_code(fixed.size)
        conditioned = np.tile(odds, (len(values), 1))
        conditioned[:, fixed] = np.where(values, np.inf, -np.inf)
        is_new = not np.array_equal(fixed, self._fixed)
        if is_new:
            self._conditioned = self._plain.repeated(len(values))
        else:
            self._conditioned = self._conditioned.grown(self._losses, odds)
        self._fixed = fixed
        self._conditioned.propagate(conditioned, is_new)
        weight, total = self._given_fixed(odds)
        hazardous: NDArray[np.float64] = np.logaddexp.reduce(weight[:, None] - softplus(-total))
        safe: NDArray[np.float64] = np.logaddexp.reduce(weight[:, None] - softplus(total))
        is_open = np.isfinite(odds)
        return np.subtract(hazardous - safe, odds, out=np.zeros(odds.size), where=is_open)

    def _given_fixed(
        self, odds: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """
        Return the log weight of each value of the fixed cells, and all log odds with it.

        Equation :eq:`loss-cutset`. The shapes are (values,) and (values, cells of the losses).
        """
        values = gray_code(self._fixed.size)
        conditioned = np.tile(odds, (len(values), 1))
        conditioned[:, self._fixed] = np.where(values, np.inf, -np.inf)
        weight = self._conditioned.log_evidence(conditioned)
        weight -= softplus(np.where(values, -1.0, 1.0) * odds[self._fixed]).sum(axis=1)
        return weight, conditioned + self._conditioned.rows.message_sums

    def draws(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], float]:
        """Draw the fixed cells together, and all others independently given these."""
        hazard = np.tile(np.exp(-softplus(-self._odds)), (count, 1))
        if self._losses.factors:
            weight, total = self._given_fixed(self._odds[self._losses.cells])
            chance = np.exp(weight - np.logaddexp.reduce(weight))
            value = np.searchsorted(np.cumsum(chance)[:-1], rng.random(count), 'right')
            hazard[:, self._losses.cells] = np.exp(-softplus(-total))[value]
        return rng.random(hazard.shape) < hazard, float(count)


def check_possible(odds: NDArray[np.float64], losses: Losses) -> None:
    """
    Refuse evidence that not even a hazard in every cell that may have one explains.

    Parameters
    ----------
    odds : ndarray, shape (cells,)
        Log odds of each hazard without the losses; NaN where neither value is possible.
    losses : Losses
        The lost paths.

    Raises
    ------
    ValueError
        If it is impossible.

    """
    graph = losses.graph
    unexplained = False
    # Malfunctions explain the loss of every robot that has any.
    if (graph.lost[graph.first[:-1], 0] == 0.0).any():
        explained = (graph.lost[:, 1] > 0.0) & (odds[losses.cells[graph.node]] > -np.inf)
        explained |= graph.lost[:, 0] > 0.0
        unexplained = not np.logical_or.reduceat(explained, graph.first[:-1]).all()
        possible = np.stack([odds < np.inf, odds > -np.inf], axis=1)[losses.cells]
        for factor in np.flatnonzero(np.diff(graph.first_step)).tolist():
            steps = losses.steps(factor)
            unexplained = unexplained or not can_be_lost(
                possible[graph.node[losses.entries(factor)]],
                graph.place[steps],
                graph.lost_at[steps],
                graph.survived[factor],
                graph.died[factor],
            )
    if np.isnan(odds).any() or unexplained:
        raise ValueError(
            'the outcome is impossible under this prior, sensor model and what came before: '
            'allow for it with probabilities that are not exactly 0 or 1'
        )


def most_entangled(
    odds: NDArray[np.float64], message_sums: NDArray[np.float64]
) -> NDArray[np.intp]:
    """Return the undecided cells that the losses say most about, at most `CONDITIONED_CELLS`."""
    total = odds + message_sums
    hazard = np.exp(-softplus(-total))
    score = np.round(message_sums * hazard * np.exp(-softplus(total)), DECIMALS)
    best: NDArray[np.intp] = np.argsort(-score, kind='stable')[:CONDITIONED_CELLS]
    return np.sort(best[: np.count_nonzero(score[best])])


def gray_code(bits: int) -> NDArray[np.bool_]:
    """Return all values of so many bits, shape (values, bits), each one bit from the next."""
    number = np.arange(2**bits)
    code: NDArray[np.bool_] = ((number ^ number >> 1)[:, None] >> np.arange(bits) & 1).astype(bool)
    return code


def log_odds(log_joint: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the log odds of Z, shape (n,), from log P(Z, X); NaN where nothing is possible."""
    by_hazard = np.logaddexp.reduce(log_joint, axis=2)
    with np.errstate(invalid='ignore'):
        odds: NDArray[np.float64] = by_hazard[:, 1] - by_hazard[:, 0]
    return odds


def softplus(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log(1 + exp(x)) without overflow: minus the log of P(Z = 0) at log odds x."""
    result: NDArray[np.float64] = np.logaddexp(0.0, log_odds)
    return result


def padded(rows: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return new rows, each as long as `end` and with its last values where it was shorter."""
    grown = np.empty((len(rows), len(end)))
    grown[:, : rows.shape[1]] = rows
    known = rows.shape[1]
    grown[:, known:] = end[known:]
    return grown
