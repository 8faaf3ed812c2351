# SPDX-License-Identifier: Apache-2.0
"""
The bank of filters: an estimator as a mixture of hypotheses, weighted by their evidence.

A hypothesis is a kind of hazards and a guess of all unknown numbers. Everything known is a bank of
one. Particles, random numbers and resampling are of each kind, so that a kind of low prior
probability keeps its particles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import Floats, Places, shallow_copy
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import (
    Bins,
    Dynamics,
    Learnt,
    STATIC,
    TARGET_VANISH,
    Unknowns,
)
from kbnitp_ros.core.inference.filter import (
    check_cells,
    condition,
    Evidence,
    IMPOSSIBLE,
    NUMBERS,
    RATES,
    safe_log,
)
from kbnitp_ros.core.inference.particles import Condition, Filters, log_sum, Series
import numpy as np
from numpy.typing import NDArray

# Prior probability of each kind. The evidence of a hundred robots hardly separates slow changes
# from static hazards, so with equal priors most static fields would be classified as changing.
PRIOR = {'static': 1 / 2, 'used_up': 1 / 3, 'changing': 1 / 12, 'moving': 1 / 12}


class Bank:
    """A belief about hazards of one kind, or of several: a mixture of `Filters` (:eq:`kinds`)."""

    is_converged = True

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics,
        on_loss: Condition = condition,
        count: int | None = None,
        targets: Dynamics = STATIC,
    ) -> None:
        if dynamics.kind == 'learn' and belief.grid is None:
            raise ValueError(
                'hazards of any kind may be moving, and moving hazards cannot be weighed: the '
                'prior has no grid for them to move on; make it with Belief.prior(grid, ...) or '
                'belief.on(grid)'
            )
        self._prior, self._known = belief, model
        self._priors = {**unknowns.priors, **dynamics.unknown_rates, **targets.target_rates}
        self._targets = targets
        self._filters = {
            each.kind: Filters(belief, model, unknowns, seed, each, on_loss, count, targets)
            for each in dynamics.kinds
        }
        self._ruled_out: frozenset[str] = frozenset()
        self.predicted = Series[Floats]()
        self._is_known = len(self._filters) == 1 and not self._priors

    def copy(self) -> Bank:
        """Return an independent copy; arrays are shared, since none is ever changed."""
        return shallow_copy(self)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Weight the hypotheses by the evidence of one more deployment."""
        check_cells(self._prior, observation)
        self.take(Evidence.of(observation, robot_type), not self._is_known)

    def assimilate_finding(self, finding: Finding) -> None:
        """Weight the hypotheses by a finding, or have all of them take a change of the field."""
        finding.check(self._prior)
        self.take(finding)

    def take(self, evidence: Evidence | Finding, is_predicted: bool = True) -> None:
        """Assimilate a finding, or an outcome counted by cell, whose counts banks may share."""
        filters, ruled_out, predicted = dict(self._filters), set(self._ruled_out), []
        for kind, each in self._filters.items():
            if kind not in ruled_out:
                filters[kind] = each = shallow_copy(each)
                try:
                    predicted.append(each.take(evidence, is_predicted))
                except ValueError:
                    ruled_out.add(kind)
        if not predicted:
            raise ValueError(IMPOSSIBLE)
        mixed = predicted[0]
        if len(filters) > 1:
            # Weights underflow to 0 after hundreds of robots.
            weights = [w for kind, w in zip(filters, self._weights) if kind not in ruled_out]
            mixed = log_sum(safe_log(np.array(weights)) + np.transpose(predicted))
        self._filters, self._ruled_out = filters, frozenset(ruled_out)
        self.predicted = self.predicted.plus(mixed)
        for name in ('_weights', 'belief'):
            self.__dict__.pop(name, None)

    def retold(
        self, belief: Belief, model: SensorModel, own: Callable[[RobotType], RobotType]
    ) -> Bank:
        """Return the bank of the same particles with another prior, model and robot types."""
        other = shallow_copy(self)
        other._prior, other._known, other._filters = belief, model, dict(self._filters)
        for kind, each in self._filters.items():
            if kind not in self._ruled_out:
                other._filters[kind] = each.retold(belief, model, own)
        for name in ('_weights', 'belief'):
            other.__dict__.pop(name, None)
        return other

    @cached_property
    def _weights(self) -> Floats:
        """Return the probability of each kind."""
        if len(self._filters) == 1:
            return np.ones(1)
        log_evidence = np.array(
            [
                -np.inf if kind in self._ruled_out else each.log_evidence + np.log(PRIOR[kind])
                for kind, each in self._filters.items()
            ]
        )
        weights: Floats = np.exp(log_evidence - log_sum(log_evidence))
        return weights

    @property
    def kinds(self) -> dict[str, float]:
        """Return the probability of each kind of hazards."""
        return dict(zip(self._filters, self._weights.tolist()))

    @property
    def target_kinds(self) -> dict[str, float]:
        """Return the probability of each kind of targets."""
        if self._targets.kind != 'learn':
            return {self._targets.kind: 1.0}
        still = self.parameters[TARGET_VANISH].zero
        return {'static': still, 'changing': 1.0 - still}

    @cached_property
    def belief(self) -> Belief:
        """Return the weighted mean of the filters."""
        if self._is_known and not self.predicted:
            return self._prior
        (joint, duds), *others = [each.joint() for each in self._filters.values()]
        if others:
            joints = [joint, *(each for each, _ in others)]
            joint = sum(w * each for w, each in zip(self._weights, joints))
        return Belief.computed(joint, self._prior.grid, duds)

    @property
    def model(self) -> SensorModel:
        """Return the sensor model with the posterior means of the learnt numbers."""
        means = {
            name: float(self._weights @ [each.mean(name) for each in self._filters.values()])
            for name in NUMBERS
            if name in self._priors
        }
        return replace(self._known, **means) if means else self._known

    @property
    def parameters(self) -> Mapping[str, Learnt]:
        """Return the posterior of each number, and of each rate given its kind."""
        learnt = {}
        for name, prior in self._priors.items():
            having = [each for each in self._filters.values() if name in each.names]
            shares = np.array(
                [w for w, each in zip(self._weights, self._filters.values()) if each in having]
            )
            shares = shares / shares.sum() if shares.any() else np.ones_like(shares)
            weights = np.concatenate([w * each.weights for w, each in zip(shares, having)])
            values = np.concatenate([each.numbers[:, each.names.index(name)] for each in having])
            order = np.argsort(values, kind='stable')
            ascending = values[order]
            low = 0.0 if prior.zero else prior.low
            edges = [low, *((ascending[1:] + ascending[:-1]) / 2.0), prior.high]
            bins = Bins(np.array(edges), ascending, np.full(values.size, -np.log(values.size)))
            learnt[name] = Learnt(bins, weights[order], float(1.0 / (weights**2).sum()))
        return learnt

    @property
    def sampling_error(self) -> float:
        """Return the expected KL divergence of the belief due to sampling, nats."""
        if self._is_known:
            return 0.0
        errors = [each.sampling_error() for each in self._filters.values()]
        return float(self._weights @ errors)

    def hypotheses(self) -> tuple[Floats, Floats, dict[str, Floats]]:
        """Return P(hazard) by hypothesis, their weights, and learnt numbers of the sensors."""
        filters = [*self._filters.values()]
        return (
            np.concatenate([each.hazard() for each in filters]),
            np.concatenate([w * each.weights for w, each in zip(self._weights, filters)]),
            {
                name: np.concatenate([each.numbers[:, each.names.index(name)] for each in filters])
                for name in self._priors
                if name in RATES
            }
            | ({'live': filters[0].live()} if filters[0].has_duds else {}),
        )

    @property
    def particles(self) -> float:
        """Return the least number of particles of a kind with unknown numbers."""
        return min((len(e.numbers) for e in self._filters.values() if e.names), default=np.inf)

    def draws(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], float]:
        """Draw hypotheses, and then the hazards of each cell independently."""
        if self._is_known:
            hazard = self.belief.hazard
            return rng.random((count, hazard.size)) < hazard, float(count)
        drawn, order = self._draw(count, rng)
        independent = sum(min(len(hazards), each.effective()) for each, hazards, _ in drawn)
        return np.concatenate([hazards for _, hazards, _ in drawn])[order], float(independent)

    def draws_with_models(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.bool_], list[SensorModel]]:
        """Draw hazards, each draw with the sensor model of its hypothesis."""
        if self._is_known:
            return self.draws(count, rng)[0], [self._known] * count
        drawn, order = self._draw(count, rng)
        models = [model for each, _, particles in drawn for model in each.models(particles)]
        hazardous = np.concatenate([hazards for _, hazards, _ in drawn])
        return hazardous[order], [models[place] for place in order]

    def _draw(
        self, count: int, rng: np.random.Generator
    ) -> tuple[list[tuple[Filters, NDArray[np.bool_], Places]], Places]:
        """Draw hazards and particles of each kind; return them, and an order of all draws."""
        filters = [*self._filters.values()]
        if len(filters) == 1:
            return [(filters[0], *filters[0].draws(count, rng))], np.arange(count)
        shares = rng.multinomial(count, self._weights).tolist()
        drawn = [(each, *each.draws(n, rng)) for each, n in zip(filters, shares) if n]
        return drawn, rng.permutation(count)
