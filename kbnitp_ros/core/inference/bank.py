# SPDX-License-Identifier: Apache-2.0
"""
A bank of one-pass filters, one for each of many guesses of the numbers that are not known.

Iterated batch importance sampling (Chopin 2002): a particle is a guess with the filter's joints of
all cells, and the evidence of each deployment weighs it. Where few particles have most of the
weight they are drawn anew, and moved by Metropolis steps that fold all evidence again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

from kbnitp_ros.core.field import (
    Belief,
    Beta,
    Bins,
    Dynamics,
    Learnt,
    Observation,
    RobotType,
    SensorModel,
    STATIC,
    Unknowns,
    Visits,
)
from kbnitp_ros.core.inference.filtering import check_cells
from kbnitp_ros.core.inference.filtering.evidence import change_of, IMPOSSIBLE, loss_weights
from kbnitp_ros.core.inference.sampling.prior_map import expit, offsets
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Particles for up to two numbers, and for more.
FEW, MANY = 192, 512

# Metropolis steps after each resampling.
MOVES = 3

# Particles drawn, as a multiple, where the evidence is impossible for all that there are.
MORE = 8

# Groups of particles whose beliefs are compared to find the sampling error.
GROUPS = 8

RATES = ('lethality', 'malfunction', 'true_positive', 'false_positive')
MAPS = ('hazard_density', 'kappa', 'target_background')


@dataclass(frozen=True, eq=False)
class Evidence:
    """
    The outcome of one deployment, counted by cell.

    Attributes
    ----------
    visits : Visits
        To the cells of the path.
    positive, negative : ndarray of int, shape (n,)
        Readings of each cell; none of a lost robot.
    before : ndarray of int, shape (steps,)
        Visits to the cell of each step before it.
    inside, elsewhere : ndarray, shape (n * (most visits + 1), steps)
        1 for the cell of each step, or for each other cell, with its visits before; else 0.
    lost_in : ndarray or None, shape (steps,)
        How well a loss in each step fits what was observed; None of a return.
    robot_type : RobotType
        Of the robot.

    """

    visits: Visits
    positive: NDArray[np.intp]
    negative: NDArray[np.intp]
    before: NDArray[np.intp]
    inside: Floats
    elsewhere: Floats
    lost_in: Floats | None
    robot_type: RobotType

    @classmethod
    def of(cls, observation: Observation, robot_type: RobotType) -> Evidence:
        """Count what came of a robot."""
        visits = Visits.of(observation.path)
        readings = observation.readings
        read = np.full(observation.steps, -1) if readings is None else readings
        cells = visits.cells.size
        positive, negative = (
            np.bincount(visits.of_step[read == reading], minlength=cells) for reading in (1, 0)
        )
        entered = visits.of_step[:, None] == np.arange(cells)
        made = entered.cumsum(axis=0) - entered
        at = np.eye(visits.counts.max() + 1)[made]
        inside, elsewhere = (
            (at * where[..., None]).reshape(observation.steps, -1).T
            for where in (entered, ~entered)
        )
        lost_in = None if observation.survived else loss_weights(observation)
        return cls(
            visits, positive, negative, made[entered], inside, elsewhere, lost_in, robot_type
        )


class Bank:
    """
    A belief and numbers that are learnt, by a bank of filters.

    Parameters
    ----------
    belief : Belief
        Before the first deployment.
    model : SensorModel
        What is known of the robots and their sensors.
    unknowns : Unknowns
        Which numbers are not known, at least one.
    seed : int
        Of the random numbers.
    dynamics : Dynamics
        How hazards change.
    correlated : bool
        Whether the filters hold hazard and target correlated.

    """

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics = STATIC,
        correlated: bool = True,
    ) -> None:
        self._prior, self._known, self._seed = belief, model, seed
        self._dynamics, self._correlated = dynamics, correlated
        self._maps, self._change = prior_maps(belief), change_of(belief, dynamics)
        self._names = tuple(unknowns.priors)
        self._priors = tuple(unknowns.priors.values())
        self._check()
        self._evidence: tuple[Evidence, ...] = ()
        self._count = FEW if len(self._priors) < 3 else MANY
        self._numbers = stratified(self._priors, self._count, np.random.default_rng([seed, 0]))
        self._joints = self._first_joints(self._numbers)
        # Of all outcomes so far, and of those since the particles were drawn.
        self._log_likelihood: Floats = np.zeros(self._count)
        self._log_weights: Floats = np.zeros(self._count)

    def copy(self) -> Bank:
        """Return a bank that goes on by itself from here; no array is ever changed."""
        return copy(self)

    def assimilate(self, observation: Observation, robot_type: RobotType) -> None:
        """Weigh the particles by the evidence of one more deployment; resample them if due."""
        check_cells(self._prior, observation)
        evidence = (*self._evidence, Evidence.of(observation, robot_type))
        rng = np.random.default_rng([self._seed, len(evidence)])
        numbers = self._numbers
        joints, log_chance = self._fold(self._joints, numbers, evidence[-1:], bool(self._evidence))
        log_likelihood, log_weights = (
            self._log_likelihood + log_chance,
            self._log_weights + log_chance,
        )
        if log_weights.max() == -np.inf:
            numbers = stratified(self._priors, MORE * self._count, rng)
            joints, log_likelihood = self._fold(self._first_joints(numbers), numbers, evidence)
            log_weights = log_likelihood
            if log_weights.max() == -np.inf:
                raise ValueError(IMPOSSIBLE)
        self._evidence, self._numbers, self._joints = evidence, numbers, joints
        self._log_likelihood, self._log_weights = log_likelihood, log_weights
        if self._effective() < 0.5 * self._count or len(numbers) > self._count:
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
        """Return the sensor model of the mean numbers."""
        means = dict(zip(self._names, self.weights @ self._numbers))
        return replace(self._known, **{name: means[name] for name in RATES if name in means})

    @property
    def parameters(self) -> Mapping[str, Learnt]:
        """Return the posterior of each number."""
        weights, learnt = self.weights, {}
        for name, prior, values in zip(self._names, self._priors, self._numbers.T):
            order = np.argsort(values, kind='stable')
            ascending = values[order]
            edges = [prior.low, *((ascending[1:] + ascending[:-1]) / 2.0), prior.high]
            bins = Bins(np.array(edges), ascending, np.full(values.size, -np.log(values.size)))
            learnt[name] = Learnt(bins, weights[order], self._effective())
        return learnt

    @property
    def sampling_error(self) -> float:
        """Return the expected KL divergence of the belief by chance, nats (by groups)."""
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
        """Draw particles, and the hazards of each cell independently given the particle."""
        hazardous, _ = self._drawn(count, rng)
        return hazardous, float(min(count, self._effective()))

    def draws_with_models(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.bool_], list[SensorModel]]:
        """Draw hazards, with the sensor model of the particle of each."""
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
        """Return hazards of all cells, shape (count, cells), and their particles."""
        particles = rng.choice(len(self._numbers), count, p=self.weights)
        hazard = self._joints[:, 1].sum(axis=1).T[particles]
        return rng.random(hazard.shape) < hazard, particles

    def _check(self) -> None:
        """Refuse unknown numbers that make no difference."""
        if not self._correlated and 'kappa' in self._names:
            raise ValueError(
                'kappa cannot be unknown to a method that keeps none: use kappa_bnitp'
            )
        if 'lethality' in self._names and self._known.false_negative == 1.0:
            raise ValueError(
                'lethality is unknown, and makes no difference: '
                'with a false_negative of 1 every robot survives a strike'
            )
        for name in set(MAPS) & set(self._names):
            if not self._maps[name].undecided.any():
                raise ValueError(
                    f'{name} is unknown, and makes no difference: the prior leaves it open in no '
                    'cell'
                )

    def _first_joints(self, numbers: Floats) -> Floats:
        """Return the prior of each particle, shape (cells, 2, 2, particles)."""
        if not set(MAPS) & set(self._names):
            return np.repeat(self._prior.joint[..., None], len(numbers), axis=-1)
        learnt = dict(zip(self._names, numbers.T))
        hazard, kappa, background = (
            self._maps[name].with_average(learnt[name])
            if name in learnt
            else self._maps[name].probability[:, None]
            for name in MAPS
        )
        hazard, kappa, background = np.broadcast_arrays(hazard, kappa, background)
        safe = 1.0 - hazard
        joint = [safe * (1.0 - background), safe * background, hazard * (1.0 - kappa)]
        return np.stack([*joint, hazard * kappa], axis=1).reshape(-1, 2, 2, len(numbers))

    def _fold(
        self,
        joints: Floats,
        numbers: Floats,
        deployments: Sequence[Evidence],
        has_begun: bool = False,
    ) -> tuple[Floats, Floats]:
        """Return the joints after some deployments, and the log probability of their outcomes."""
        joints, log_likelihood = np.array(joints), np.zeros(len(numbers))
        steps: dict[RobotType, Steps] = {}
        for evidence in deployments:
            if has_begun:
                joints = self._change(joints)
            has_begun = True
            robot_type, cells = evidence.robot_type, evidence.visits.cells
            if robot_type not in steps:
                steps[robot_type] = self._steps(numbers, robot_type)
            joints[cells], log_chance = assimilated(
                joints[cells], steps[robot_type], evidence, self._correlated
            )
            log_likelihood += log_chance
        return joints, log_likelihood

    def _steps(self, numbers: Floats, robot_type: RobotType) -> Steps:
        """Return the steps of robots of a type in each particle; their own numbers are known."""
        model = robot_type.model(self._known)
        learnt = {
            name: values
            for name, values in zip(self._names, numbers.T)
            if name not in robot_type.sensors
        }
        rates = {
            name: np.broadcast_to(learnt.get(name, getattr(model, name)), len(numbers))
            for name in RATES
        }
        return Steps.of(rates, model.false_negative, self._dynamics.kind == 'used_up')

    def _resample(self, rng: np.random.Generator) -> None:
        """Draw the particles anew by their weights, and move them."""
        weights, logits = self.weights, logit(self._numbers, self._priors)
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
            folded, log_proposed = self._fold(self._first_joints(numbers), numbers, self._evidence)
            log_ratio = log_proposed - log_likelihood
            log_ratio += log_prior(proposed, self._priors) - log_prior(logits, self._priors)
            is_moved = np.log(rng.random(self._count)) < log_ratio
            logits = np.where(is_moved[:, None], proposed, logits)
            log_likelihood = np.where(is_moved, log_proposed, log_likelihood)
            joints = np.where(is_moved, folded, joints)
        self._numbers, self._joints = expit_within(logits, self._priors), joints
        self._log_likelihood, self._log_weights = log_likelihood, np.zeros(self._count)


@dataclass(frozen=True, eq=False)
class Map:
    """A map of the prior whose average may not be known."""

    # Shape (cells,).
    probability: Floats
    # Shape (cells,). Where the prior leaves it open.
    undecided: NDArray[np.bool_]

    def with_average(self, averages: Floats) -> Floats:
        """Return the map shifted to averages, (cells, particles) (:eq:`prior-offset`)."""
        shifted = np.repeat(self.probability[:, None], averages.size, axis=1)
        open_to = self.probability[self.undecided]
        if np.ptp(open_to) == 0.0:
            shifted[self.undecided] = averages
        else:
            odds = np.log(open_to) - np.log1p(-open_to)
            shifted[self.undecided] = expit(odds[:, None] + offsets(odds, averages))
        return shifted


def prior_maps(belief: Belief) -> dict[str, Map]:
    """Return P(Z = 1), P(X = 1 | Z = 1) and P(X = 1 | Z = 0) by their names."""
    hazard, joint = belief.hazard, belief.joint
    safe = joint[:, 0].sum(axis=1)
    background = ratio(joint[:, 0, 1], safe).clip(max=1.0)
    return {
        name: Map(values, where & (values > 0.0) & (values < 1.0))
        for name, values, where in (
            ('hazard_density', hazard, hazard > 0.0),
            ('kappa', belief.kappa, hazard > 0.0),
            ('target_background', background, safe > 0.0),
        )
    }


@dataclass(frozen=True, eq=False)
class Steps:
    """
    Effects of a step into a cell, by particle.

    Attributes
    ----------
    survive, lose : ndarray, shape (2, 2, particles)
        P(survived or lost, hazard y after it | hazard z before it), indexed [z, y, particle].
    read : ndarray, shape (2, 2, particles)
        P(reading y | X = x), indexed [y, x, particle].

    """

    survive: Floats
    lose: Floats
    read: Floats

    @classmethod
    def of(cls, rates: Mapping[str, Floats], false_negative: float, are_used_up: bool) -> Steps:
        """Return the steps of robots with these `RATES`, each of shape (particles,)."""
        lethality, malfunction, true_positive, false_positive = (rates[name] for name in RATES)
        endured, none = 1.0 - malfunction, np.zeros_like(malfunction)
        spared, deadly = lethality * false_negative, lethality * (1.0 - false_negative)
        survive = [endured, none, none, endured * (1.0 - deadly)]
        lose = [malfunction, none, none, malfunction + endured * deadly]
        if are_used_up:
            survive = [endured, none, endured * spared, endured * (1.0 - lethality)]
            lose = [malfunction, none, endured * deadly, malfunction]
        read = [1.0 - false_positive, 1.0 - true_positive, false_positive, true_positive]
        return cls(*(np.stack(each).reshape(2, 2, -1) for each in (survive, lose, read)))


def assimilated(
    joint: Floats, steps: Steps, evidence: Evidence, correlated: bool
) -> tuple[Floats, Floats]:
    """
    Return the joints of the cells of a path given an outcome, and its log probability.

    Equations :eq:`bank-returned` and :eq:`bank-lost`; shapes (n, 2, 2, particles) and
    (particles,).
    """
    hazard = joint.sum(axis=2)
    if not correlated:
        joint = hazard[:, :, None] * joint.sum(axis=1)[:, None]
    counts, cell, before = evidence.visits.counts, evidence.visits.of_step, evidence.before
    # So many visits survived, shape (visits, z, y, particles).
    powers = [np.eye(2)[..., None] + np.zeros_like(steps.survive)]
    for _ in range(counts.max()):
        powers.append(then(powers[-1], steps.survive))
    if evidence.lost_in is None:
        negative, positive = (
            np.cumprod([np.ones_like(read), *[read] * number.max()], axis=0)[number]
            for read, number in zip(steps.read, (evidence.negative, evidence.positive))
        )
        moved = moved_by(np.array(powers)[counts], joint) * (negative * positive)[:, None]
        return normalised(moved, joint), log_of(moved.sum(axis=(1, 2))).sum(axis=0)
    # Of cells with so many visits before, (n, visits, particles): these survived, and then lost.
    spared = np.stack(
        [hazard[:, 0, None] * each[0] + hazard[:, 1, None] * each[1] for each in powers], 1
    )
    alive, fatal = spared.sum(axis=2), (spared * steps.lose.sum(axis=1)).sum(axis=2)
    here = alive[cell, before]
    goes_on = ratio(alive[cell, before + 1], here)
    reached = np.cumprod(np.concatenate([np.ones_like(here[:1]), goes_on[:-1]]), axis=0)
    # Lost in each step, and that over what the hazard of its own cell has to do with it.
    fits = ratio(reached * evidence.lost_in[:, None], here)
    lost = fits * fatal[cell, before]
    elsewhere = ratio((evidence.elsewhere @ lost).reshape(alive.shape), alive)
    inside = (evidence.inside @ fits).reshape(alive.shape)
    after = np.zeros((counts.size, *steps.survive.shape))
    for count, power in enumerate(powers):
        after += elsewhere[:, count, None, None] * power
        after += inside[:, count, None, None] * then(power, steps.lose)
    return normalised(moved_by(after, joint), joint), log_of(lost.sum(axis=0))


def then(first: Floats, second: Floats) -> Floats:
    """Return one change of hazards after another, each (z, y, particles)."""
    both: Floats = first[:, 0, None] * second[0] + first[:, 1, None] * second[1]
    return both


def moved_by(moves: Floats, joint: Floats) -> Floats:
    """Return joints, (n, z, x, particles), with their hazards changed by (n, z, y, particles)."""
    safe, hazardous = moves[:, 0, :, None], moves[:, 1, :, None]
    moved: Floats = safe * joint[:, 0, None] + hazardous * joint[:, 1, None]
    return moved


def log_of(chance: Floats) -> Floats:
    """Return the logarithm, -inf of 0."""
    log: Floats = np.log(chance, out=np.full_like(chance, -np.inf), where=chance > 0.0)
    return log


def ratio(part: Floats, whole: Floats) -> Floats:
    """Return part / whole, 0 where both are 0."""
    share: Floats = np.divide(part, whole, out=np.zeros_like(part), where=whole > 0.0)
    return share


def normalised(moved: Floats, joint: Floats) -> Floats:
    """Return joints that sum to 1; those before where the outcome is impossible."""
    total = moved.sum(axis=(1, 2), keepdims=True)
    posterior: Floats = np.divide(moved, total, out=joint.copy(), where=total > 0.0)
    return posterior


def stratified(priors: Sequence[Beta], count: int, rng: np.random.Generator) -> Floats:
    """Draw numbers, shape (count, priors), one in each stratum of each prior."""
    columns = []
    for prior in priors:
        bins = prior.bins()
        below = np.concatenate([[0.0], np.exp(bins.log_prior).cumsum()])
        points = (rng.permutation(count) + rng.random(count)) / count
        columns.append(np.interp(points * below[-1], below, bins.edges))
    return within(np.stack(columns, axis=1), priors)


def within(numbers: Floats, priors: Sequence[Beta]) -> Floats:
    """Keep numbers off the ends of their intervals, where they have no logit."""
    low, high = np.array([(prior.low, prior.high) for prior in priors]).T
    margin = 1e-9 * (high - low)
    return numbers.clip(low + margin, high - margin)


def logit(numbers: Floats, priors: Sequence[Beta]) -> Floats:
    """Return the log odds of numbers within their intervals."""
    low, high = np.array([(prior.low, prior.high) for prior in priors]).T
    log_odds: Floats = np.log(numbers - low) - np.log(high - numbers)
    return log_odds


def expit_within(logits: Floats, priors: Sequence[Beta]) -> Floats:
    """Return the numbers with some log odds within their intervals."""
    low, high = np.array([(prior.low, prior.high) for prior in priors]).T
    return within(low + (high - low) * expit(logits), priors)


def log_prior(logits: Floats, priors: Sequence[Beta]) -> Floats:
    """Return the log density of log odds, but for a constant, shape (particles,)."""
    numbers = expit_within(logits, priors)
    a, b = np.array([(prior.a, prior.b) for prior in priors]).T
    density = (a - 1.0) * np.log(numbers) + (b - 1.0) * np.log1p(-numbers)
    share = expit(logits)
    density += np.log(share) + np.log1p(-share)
    total: Floats = density.sum(axis=1)
    return total
