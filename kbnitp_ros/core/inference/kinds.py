# SPDX-License-Identifier: Apache-2.0
"""Kinds of hazards as hypotheses: a bank of filters for each, weighted by its evidence."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import Dynamics, Learnt, Unknowns
from kbnitp_ros.core.inference.bank import Bank, learnt_from, log_sum
from kbnitp_ros.core.inference.filter import (
    check_cells,
    Evidence,
    Floats,
    IMPOSSIBLE,
    RATES,
    safe_log,
)
import numpy as np
from numpy.typing import NDArray

# Prior probability of each kind. The evidence of a hundred robots hardly separates slow changes
# from static hazards, so with equal priors most static fields would be classified as changing.
PRIOR = {'static': 1 / 2, 'used_up': 1 / 3, 'changing': 1 / 12, 'moving': 1 / 12}


class Kinds:
    """A belief about hazards of unknown kind: a mixture of a bank for each kind (:eq:`kinds`)."""

    is_converged = True

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics,
        correlated: bool = True,
        count: int | None = None,
    ) -> None:
        if belief.grid is None:
            raise ValueError(
                'hazards of any kind may be moving, and moving hazards cannot be weighed: the '
                'prior has no grid for them to move on; make it with Belief.prior(grid, ...) or '
                'belief.on(grid)'
            )
        self._prior, self._known = belief, model
        self._priors = {**unknowns.priors, **dynamics.unknown_rates}
        self._banks = {
            each.kind: Bank(belief, model, unknowns, seed, each, correlated, count)
            for each in dynamics.kinds
        }
        self._ruled_out: frozenset[str] = frozenset()
        self.predicted: tuple[Floats, ...] = ()

    def copy(self) -> Kinds:
        """Return an independent copy; arrays are shared, since none is ever changed."""
        return copy(self)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Weight the kinds by the evidence of one more deployment."""
        check_cells(self._prior, observation)
        self.take(Evidence.of(observation, robot_type))

    def take(self, evidence: Evidence, is_predicted: bool = True) -> None:
        """Assimilate the outcome of a deployment, counted by cell."""
        banks, ruled_out, predicted = dict(self._banks), set(self._ruled_out), []
        # Weights underflow to 0 after hundreds of robots.
        log_weights = safe_log(self._weights)
        for (kind, bank), log_weight in zip(self._banks.items(), log_weights):
            if kind not in ruled_out:
                banks[kind] = bank = bank.copy()
                try:
                    bank.take(evidence, is_predicted)
                except ValueError:
                    ruled_out.add(kind)
                else:
                    predicted.append(log_weight + bank.predicted[-1])
        if not predicted:
            raise ValueError(IMPOSSIBLE)
        self._banks, self._ruled_out = banks, frozenset(ruled_out)
        self.predicted = (*self.predicted, log_sum(np.transpose(predicted)))
        for name in ('_weights', 'belief'):
            self.__dict__.pop(name, None)

    @cached_property
    def _weights(self) -> Floats:
        """Return the probability of each bank."""
        log_evidence = np.array(
            [
                -np.inf if kind in self._ruled_out else bank.log_evidence + np.log(PRIOR[kind])
                for kind, bank in self._banks.items()
            ]
        )
        weights: Floats = np.exp(log_evidence - log_sum(log_evidence))
        return weights

    @property
    def kinds(self) -> dict[str, float]:
        """Return the probability of each kind of hazards."""
        return dict(zip(self._banks, self._weights.tolist()))

    @cached_property
    def belief(self) -> Belief:
        """Return the weighted mean of the banks."""
        return Belief(
            sum(
                weight * bank.belief.joint
                for bank, weight in zip(self._banks.values(), self._weights)
            )
        )

    @property
    def model(self) -> SensorModel:
        """Return the sensor model with the posterior means of the learnt numbers."""
        models = [bank.model for bank in self._banks.values()]
        return replace(
            self._known,
            **{
                name: float(self._weights @ [getattr(each, name) for each in models])
                for name in RATES
                if name in self._priors
            },
        )

    @property
    def parameters(self) -> Mapping[str, Learnt]:
        """Return the posterior of each number, and of each rate given its kind."""
        told = [bank.parameters for bank in self._banks.values()]
        learnt = {}
        for name, prior in self._priors.items():
            by_kind = [each[name] for each in told if name in each]
            shares = np.array([w for w, each in zip(self._weights, told) if name in each])
            shares = shares / shares.sum() if shares.any() else np.full_like(shares, 1.0)
            weights = np.concatenate(
                [share * each.weights for share, each in zip(shares, by_kind)]
            )
            values = np.concatenate([each.bins.values for each in by_kind])
            learnt[name] = learnt_from(prior, values, weights, float(1.0 / (weights**2).sum()))
        return learnt

    @property
    def sampling_error(self) -> float:
        """Return the expected KL divergence of the belief due to sampling, nats."""
        return float(self._weights @ [bank.sampling_error for bank in self._banks.values()])

    def draws(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], float]:
        """Draw a kind for each draw, and its hazards by `Bank.draws`."""
        drawn = [bank.draws(share, rng) for bank, share in self._shares(count, rng)]
        return (
            rng.permutation(np.concatenate([hazardous for hazardous, _ in drawn])),
            sum(independent for _, independent in drawn),
        )

    def draws_with_models(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.bool_], list[SensorModel]]:
        """Draw hazards, each draw with the sensor model of its particle."""
        drawn = [bank.draws_with_models(share, rng) for bank, share in self._shares(count, rng)]
        hazardous = np.concatenate([hazardous for hazardous, _ in drawn])
        models = [model for _, models in drawn for model in models]
        order = rng.permutation(len(models))
        return hazardous[order], [models[place] for place in order]

    def _shares(self, count: int, rng: np.random.Generator) -> list[tuple[Bank, int]]:
        """Return the banks with draws, and the number of draws from each."""
        shares = rng.multinomial(count, self._weights)
        return [(bank, int(share)) for bank, share in zip(self._banks.values(), shares) if share]


def learning(
    belief: Belief,
    model: SensorModel,
    unknowns: Unknowns,
    seed: int,
    dynamics: Dynamics,
    correlated: bool,
    count: int | None = None,
) -> Bank | Kinds:
    """Return a bank, or a mixture of banks if the kind of hazards is learnt."""
    make = Kinds if dynamics.kind == 'learn' else Bank
    return make(belief, model, unknowns, seed, dynamics, correlated, count)
