# SPDX-License-Identifier: Apache-2.0
"""
A bank of one-pass filters, one for each of many guesses of unknown numbers.

Iterated batch importance sampling (Chopin 2002): a particle is a guess with the filter's joints of
all cells, weighted by the evidence of each deployment. When few particles have most of the weight,
particles are resampled, and moved by Metropolis steps that filter all evidence again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import (
    appearance,
    Beta,
    Bins,
    Dynamics,
    Learnt,
    STATIC,
    Unknowns,
)
from kbnitp_ros.core.inference.filter import (
    check_cells,
    condition,
    Effects,
    Evidence,
    Floats,
    hazard_change,
    IMPOSSIBLE,
    independent,
    predict_outcome,
    RATES,
    safe_log,
)
from kbnitp_ros.core.inference.prior_maps import expit, make_joint, MAPS, offsets, prior_maps
import numpy as np
from numpy.typing import NDArray

# Number of particles for up to three unknown numbers, and for four or more.
FEW, MANY = 192, 512

# Number of Metropolis steps after each resampling.
MOVES = 3

# Factor on the number of particles if all are drawn anew, since none allows the evidence.
MORE = 8

# Number of copies of all joints in memory, including those of resampling and moves.
COPIES = MORE + 24

# Maximum bytes of a bank.
MAX_MEMORY = 4 << 30

# Number of groups of particles; the spread of their beliefs gives the sampling error.
GROUPS = 8


class Bank:
    """A belief and learnt numbers, by a bank of filters."""

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics = STATIC,
        correlated: bool = True,
        count: int | None = None,
    ) -> None:
        self._prior, self._known, self._seed = belief, model, seed
        self._dynamics, self._correlated = dynamics, correlated
        priors = {**unknowns.priors, **dynamics.unknown_rates}
        self._names, self._priors = tuple(priors), tuple(priors.values())
        if not self._correlated and 'kappa' in self._names:
            raise ValueError('kappa cannot be learnt by a method without kappa: use kappa_bnitp')
        self._maps = prior_maps(belief, model, self._names)
        self.predicted: tuple[Floats, ...] = ()
        # Log probability of all outcomes so far.
        self.log_evidence = 0.0
        self._evidence: tuple[Evidence, ...] = ()
        enough = FEW if len(priors) < 4 else MANY
        self._count = count or (enough if priors else 1)
        estimate = 32 * belief.cells * self._count * COPIES
        if self._count > 1 and estimate > MAX_MEMORY:
            raise ValueError(
                f'learning numbers on {belief.cells} cells takes about {estimate / 1e9:.1f} '
                f'GB, and {MAX_MEMORY / 1e9:.1f} GB are allowed: take a smaller field, or learn '
                'nothing'
            )
        self._numbers = stratified(self._priors, self._count, np.random.default_rng([seed, 0]))
        # Cache for the latest numbers: these, their change between deployments, `Effects` by type.
        self._effects: (
            tuple[Floats, Callable[[Floats], Floats], dict[RobotType, Effects]] | None
        ) = None
        self._joints = self._first_joints(self._numbers)
        # By particle: log likelihood of all outcomes, and of outcomes since the last resampling.
        self._log_likelihood: Floats = np.zeros(self._count)
        self._log_weights: Floats = np.zeros(self._count)

    def copy(self) -> Bank:
        """Return an independent copy; arrays are shared, since they are never changed."""
        return copy(self)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Weight the particles by one more deployment; resample if few keep most of the weight."""
        check_cells(self._prior, observation)
        self.take(Evidence.of(observation, robot_type))

    def take(self, evidence: Evidence, is_predicted: bool = True) -> None:
        """Assimilate evidence counted by cell; several banks may share the counts."""
        has_begun = bool(self._evidence)
        rng = np.random.default_rng([self._seed, len(self._evidence) + 1])
        numbers, log_likelihood, log_weights = (
            self._numbers,
            self._log_likelihood,
            self._log_weights,
        )
        deployment = [evidence], has_begun, is_predicted
        joints, log_chances = self._fold(self._joints, numbers, *deployment)
        if (log_weights + log_chances[0]).max() == -np.inf:
            numbers = stratified(self._priors, MORE * self._count, rng)
            before, (log_likelihood, *_) = self._fold(
                self._first_joints(numbers), numbers, self._evidence
            )
            log_weights = log_likelihood
            joints, log_chances = self._fold(before, numbers, *deployment)
            if (log_weights + log_chances[0]).max() == -np.inf:
                raise ValueError(IMPOSSIBLE)
        predicted = log_sum(log_weights - log_sum(log_weights) + log_chances)
        self.predicted = (*self.predicted, predicted)
        self.log_evidence += float(predicted[0])
        self._evidence, self._numbers, self._joints = (*self._evidence, evidence), numbers, joints
        self._log_likelihood = log_likelihood + log_chances[0]
        self._log_weights = log_weights + log_chances[0]
        is_due = self._effective() < 0.5 * self._count or len(numbers) > self._count
        if is_due and self._priors:
            self._resample(rng)
        self.__dict__.pop('belief', None)

    @property
    def weights(self) -> Floats:
        """Return the probability of each particle, shape (particles,)."""
        weights: Floats = np.exp(self._log_weights - self._log_weights.max())
        weights /= weights.sum()
        return weights

    def _effective(self) -> float:
        """Return the effective number of particles."""
        return float(1.0 / (self.weights**2).sum())

    @cached_property
    def belief(self) -> Belief:
        """Return the weighted mean of the filters."""
        joint = self._joints @ self.weights
        return Belief(joint / joint.sum(axis=(1, 2), keepdims=True))

    @property
    def model(self) -> SensorModel:
        """Return the sensor model with the posterior means of the learnt numbers."""
        means = dict(zip(self._names, self.weights @ self._numbers))
        return replace(self._known, **{name: means[name] for name in RATES if name in means})

    @property
    def parameters(self) -> Mapping[str, Learnt]:
        """Return the posterior of each number."""
        return {
            name: learnt_from(prior, values, self.weights, self._effective())
            for name, prior, values in zip(self._names, self._priors, self._numbers.T)
        }

    @property
    def sampling_error(self) -> float:
        """Return the expected KL divergence of the belief due to sampling, nats (by groups)."""
        weights = self.weights
        hazard = self._joints[:, 1].sum(axis=1).T
        groups = np.arange(weights.size) % GROUPS
        shares = np.array([weights[groups == group].sum() for group in range(GROUPS)])
        means = np.array(
            [weights[groups == group] @ hazard[groups == group] for group in range(GROUPS)]
        )
        means = means[shares > 0.0] / shares[shares > 0.0, None]
        mean = self.belief.hazard
        spread = means.var(axis=0, ddof=1) if len(means) > 1 else np.zeros_like(mean)
        chance = mean * (1.0 - mean)
        return float((spread[chance > 0.0] / (2.0 * GROUPS * chance[chance > 0.0])).sum())

    is_converged = True

    def draws(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], float]:
        """Draw particles, and then the hazards of each cell independently."""
        hazardous, _ = self._drawn(count, rng)
        return hazardous, float(min(count, self._effective()))

    def draws_with_models(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.bool_], list[SensorModel]]:
        """Draw hazards, each draw with the sensor model of its particle."""
        hazardous, particles = self._drawn(count, rng)
        models = [
            replace(
                self._known,
                **{name: value for name, value in zip(self._names, numbers) if name in RATES},
            )
            for numbers in self._numbers[particles].tolist()
        ]
        return hazardous, models

    def _drawn(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
        """Return hazards of all cells, shape (count, cells), and the particle of each draw."""
        particles = rng.choice(len(self._numbers), count, p=self.weights)
        hazard = self._joints[:, 1].sum(axis=1).T[particles]
        return rng.random(hazard.shape) < hazard, particles

    def _first_joints(self, numbers: Floats) -> Floats:
        """Return the prior of each particle, shape (cells, 2, 2, particles)."""
        if not set(MAPS) & set(self._names):
            return np.repeat(self._prior.joint[..., None], len(numbers), axis=-1)
        learnt = dict(zip(self._names, numbers.T))
        hazard, kappa, background = (
            with_average(*self._maps[name], learnt[name])
            if name in learnt
            else self._maps[name][0][:, None]
            for name in MAPS
        )
        return make_joint(*np.broadcast_arrays(hazard, kappa, background))

    def _fold(
        self,
        joints: Floats,
        numbers: Floats,
        deployments: Sequence[Evidence],
        has_begun: bool = False,
        is_predicted: bool = False,
    ) -> tuple[Floats, Floats]:
        """Fold deployments into joints; return joints, and logs of chances and predictions."""
        joints = np.array(joints)
        log_chances: Floats = np.zeros((1, len(numbers)))
        learnt = dict(zip(self._names, numbers.T))
        if self._effects is None or self._effects[0] is not numbers:
            rates = {name: learnt[name] for name in self._dynamics.unknown_rates}
            if 'vanish' in rates and not self._dynamics.appear:
                density = learnt.get('hazard_density', prior_density(self._prior))
                rates['appear'] = appearance(rates['vanish'], density)
            self._effects = numbers, hazard_change(self._prior, self._dynamics, rates), {}
        _, change, effects = self._effects
        for evidence in deployments:
            if has_begun:
                joints = change(joints)
            has_begun = True
            robot_type, cells = evidence.robot_type, evidence.visits.cells
            if robot_type not in effects:
                model = robot_type.model(self._known)
                # Numbers that the robot type sets replace learnt numbers.
                of_all = {k: v for k, v in learnt.items() if k not in robot_type.sensors}
                own = {
                    name: np.broadcast_to(
                        of_all.get(name, getattr(model, name)), numbers.shape[:1]
                    )
                    for name in RATES
                }
                are_used_up = self._dynamics.kind == 'used_up'
                effects[robot_type] = Effects.of(own, model.false_negative, are_used_up)
            joint = joints[cells]
            if not self._correlated:
                joint = independent(joint)
            joints[cells], log_chance = condition(joint, evidence, effects[robot_type])
            chances = [log_chance]
            if is_predicted:
                chances.extend(predict_outcome(joint, evidence, effects[robot_type]))
            log_chances = log_chances + np.stack(chances)
        return joints, log_chances

    def _resample(self, rng: np.random.Generator) -> None:
        """Resample the particles by their weights, and move them."""
        low, high = np.array([(prior.low, prior.high) for prior in self._priors]).T
        weights = self.weights
        logits = np.log(self._numbers - low) - np.log(high - self._numbers)
        centred = logits - weights @ logits
        covariance = (centred * weights[:, None]).T @ centred + 1e-9 * np.eye(logits.shape[1])
        scale = 2.38 / np.sqrt(logits.shape[1]) * np.linalg.cholesky(covariance).T
        points = (np.arange(self._count) + rng.random()) / self._count
        chosen = np.searchsorted(weights.cumsum(), points).clip(max=weights.size - 1)
        logits, joints = logits[chosen], self._joints[..., chosen]
        log_likelihood = self._log_likelihood[chosen]
        for _ in range(MOVES):
            proposed = logits + rng.standard_normal(logits.shape) @ scale
            numbers = expit_within(proposed, self._priors)
            folded, (log_proposed, *_) = self._fold(
                self._first_joints(numbers), numbers, self._evidence
            )
            log_ratio = log_proposed - log_likelihood
            log_ratio += log_prior(proposed, self._priors) - log_prior(logits, self._priors)
            is_moved = np.log(rng.random(self._count)) < log_ratio
            logits = np.where(is_moved[:, None], proposed, logits)
            log_likelihood = np.where(is_moved, log_proposed, log_likelihood)
            joints = np.where(is_moved, folded, joints)
        self._numbers, self._joints = expit_within(logits, self._priors), joints
        self._log_likelihood, self._log_weights = log_likelihood, np.zeros(self._count)


def with_average(probability: Floats, undecided: NDArray[np.bool_], averages: Floats) -> Floats:
    """Shift a map to each particle's average, (cells, particles) (:eq:`prior-offset`)."""
    shifted = np.repeat(probability[:, None], averages.size, axis=1)
    open_to = probability[undecided]
    if np.ptp(open_to) == 0.0:
        shifted[undecided] = averages
    else:
        odds = np.log(open_to) - np.log1p(-open_to)
        shifted[undecided] = expit(odds[:, None] + offsets(odds, averages))
    return shifted


def prior_density(belief: Belief) -> float:
    """Return the mean hazard of the cells that may have a hazard."""
    hazard = belief.hazard
    return float(hazard[hazard > 0.0].mean()) if hazard.any() else 0.0


def learnt_from(prior: Beta, values: Floats, weights: Floats, effective: float) -> Learnt:
    """Return the posterior of a number from weighted particles."""
    order = np.argsort(values, kind='stable')
    ascending = values[order]
    edges = [prior.low, *((ascending[1:] + ascending[:-1]) / 2.0), prior.high]
    bins = Bins(np.array(edges), ascending, np.full(values.size, -np.log(values.size)))
    return Learnt(bins, weights[order], effective)


def log_sum(logs: Floats) -> Floats:
    """Return the log of the sum of exponentials along the last axis."""
    peak = logs.max(axis=-1, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    total: Floats = peak[..., 0] + safe_log(np.exp(logs - peak).sum(axis=-1))
    return total


def stratified(priors: Sequence[Beta], count: int, rng: np.random.Generator) -> Floats:
    """Draw numbers, shape (count, priors), one in each stratum of each prior."""
    columns = []
    for prior in priors:
        bins = prior.bins()
        below = np.concatenate([[0.0], np.exp(bins.log_prior).cumsum()])
        points = (rng.permutation(count) + rng.random(count)) / count
        columns.append(np.interp(points * below[-1], below, bins.edges))
    return within(np.stack(columns, axis=1), priors) if priors else np.empty((count, 0))


def within(numbers: Floats, priors: Sequence[Beta]) -> Floats:
    """Clip numbers inside their intervals, at whose ends the logit is infinite."""
    low, high = np.array([(prior.low, prior.high) for prior in priors]).T
    margin = 1e-9 * (high - low)
    return numbers.clip(low + margin, high - margin)


def expit_within(logits: Floats, priors: Sequence[Beta]) -> Floats:
    """Convert log odds to numbers within their intervals."""
    low, high = np.array([(prior.low, prior.high) for prior in priors]).T
    return within(low + (high - low) * expit(logits), priors)


def log_prior(logits: Floats, priors: Sequence[Beta]) -> Floats:
    """Return the log prior density of log odds up to a constant, shape (particles,)."""
    numbers = expit_within(logits, priors)
    a, b = np.array([(prior.a, prior.b) for prior in priors]).T
    density = (a - 1.0) * np.log(numbers) + (b - 1.0) * np.log1p(-numbers)
    share = expit(logits)
    density += np.log(share) + np.log1p(-share)
    total: Floats = density.sum(axis=1)
    return total
