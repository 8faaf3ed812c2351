# SPDX-License-Identifier: Apache-2.0
"""
The particles: guesses of all unknown numbers, each with its filter, weighted by the evidence.

Those of one kind of hazards. Everything known is one particle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple, overload, TypeVar

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import Floats, Places, shallow_copy
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import (
    appearance,
    Beta,
    Dynamics,
    STATIC,
    TARGET_VANISH,
    targets_after,
    Unknowns,
)
from kbnitp_ros.core.inference.filter import (
    condition,
    Effects,
    Evidence,
    hazard_change,
    IMPOSSIBLE,
    NUMBERS,
    predict_outcome,
    RATES,
    ratio,
    safe_log,
    take_finding,
)
from kbnitp_ros.core.inference.prior_maps import (
    classes_of_cells,
    expit,
    make_joint,
    MAPS,
    prior_maps,
    with_average,
)
import numpy as np
from numpy.typing import NDArray

# Number of particles for up to three unknown numbers, and for four or more; and the least numbers,
# where more do not fit into memory.
FEW, MANY = (192, 40), (512, 128)

# Number of Metropolis steps after each resampling.
MOVES = 3

# Share of proposed steps by which a number becomes 0, or is 0 no longer.
SWITCHES = 0.2

# Factor on the number of particles if all are drawn anew, since none allows the evidence.
MORE = 8

# Number of copies of all joints in memory, including those of resampling and moves.
COPIES = MORE + 24

# Maximum bytes of the filters of a kind.
MAX_MEMORY = 4 << 30

# Number of groups of particles; the spread of their beliefs gives the sampling error.
GROUPS = 8

T = TypeVar('T')


class Series(Sequence[T]):
    """A sequence that grows in constant time; items added to it are not in the original."""

    def __init__(self, items: list[T] | None = None, size: int = 0) -> None:
        # The items, which may be followed by those of a series that grew from this one.
        self._items, self._size = items or [], size

    def plus(self, item: T) -> Series[T]:
        """Return the series with one more item."""
        is_last = len(self._items) == self._size
        items = self._items if is_last else self._items[: self._size]
        items.append(item)
        return Series(items, self._size + 1)

    def __len__(self) -> int:
        return self._size

    @overload
    def __getitem__(self, place: int) -> T: ...

    @overload
    def __getitem__(self, place: slice) -> list[T]: ...

    def __getitem__(self, place: int | slice) -> T | list[T]:
        if isinstance(place, slice):
            return self._items[: self._size][place]
        return self._items[range(self._size)[place]]


class ParticleGroup(NamedTuple):
    """Neighbouring particles that are folded together, and what follows from their numbers."""

    particles: slice
    # Whether their hazards may reach.
    reaches: bool
    # The change of hazards between deployments; None if there is none.
    change: Callable[[Floats], Floats] | None
    # Those of the group whose targets change, and the rates at which targets appear and vanish.
    changing: slice
    rates: tuple[Floats, Floats]
    # Effects of a step by robot type.
    effects: dict[RobotType, Effects]


# As `condition`.
Condition = Callable[[Floats, Evidence, Effects], tuple[Floats, Floats]]


class Filters:
    """
    The filters of one kind of hazards, one for each guess of the unknown numbers.

    Joints have a row for each cell that evidence was of, and one for all other cells of an equal
    prior. Particles are in the order of those that are folded together.

    Iterated batch importance sampling (Chopin 2002): a particle is a guess with the filter's
    joints of all cells, weighted by the evidence of each deployment. When few particles have most
    of the weight, particles are resampled, and moved by Metropolis steps that filter all evidence
    again.
    """

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
        self._seed, self._on_loss = seed, on_loss
        self._dynamics, self._targets = dynamics, targets
        priors = {**unknowns.priors, **dynamics.unknown_rates, **targets.target_rates}
        self.names, self._priors = tuple(priors), tuple(priors.values())
        self._zero = np.array([prior.zero for prior in self._priors])
        self._log_odds = np.log1p(-self._zero) - np.log(np.where(self._zero, self._zero, 1.0))
        # The row of each cell, and the class of each row: cells of equal priors are one class, of
        # which the first cells and the numbers of cells are kept.
        are_apart = dynamics.effect not in ('static', 'used_up')
        self._first, self._row, self._sizes = self._classes(belief, are_apart)
        self._class: Places = np.arange(self._first.size)
        # Classes whose targets may change, and the last deployment that updated each row.
        self._may_change = (belief.target[self._first] > 0.0) & (targets.effect != 'static')
        self._updated: Places = np.zeros(self._first.size, np.intp)
        self._set_prior(belief, model)
        self.has_duds = 'duds' in priors or model.duds > 0.0
        reaches = 'reach' in priors or model.reach > 0.0
        self._around = belief.neighbors_in_reach() if reaches else None
        # Log probability of all outcomes so far.
        self.log_evidence = 0.0
        # Evidence in order, and the number of deployments in it.
        self._evidence, self._deployments = Series[Evidence | Finding](), 0
        enough, least = FEW if len(priors) < 4 else MANY
        of_each = (48 if self.has_duds else 32) * belief.cells * COPIES
        if priors and count is None and least * of_each > MAX_MEMORY:
            raise ValueError(
                f'learning numbers on {belief.cells} cells takes about '
                f'{least * of_each / 1e9:.1f} GB, and {MAX_MEMORY / 1e9:.1f} GB are allowed: '
                'take a smaller field, or learn nothing'
            )
        self._count = (count or min(enough, MAX_MEMORY // of_each)) if priors else 1
        # The numbers of each particle, shape (particles, numbers).
        self.numbers = self._first_numbers(self._count, np.random.default_rng([seed, 0]))
        # Cache of the groups of the latest numbers.
        self._groups = self.numbers, self._grouped(self.numbers)
        self._joints = self._first_joints(self.numbers)
        # By particle: log likelihood of all outcomes, and of outcomes since the last resampling.
        self._log_likelihood: Floats = np.zeros(self._count)
        self._log_weights: Floats = np.zeros(self._count)

    def take(self, evidence: Evidence | Finding, is_predicted: bool = False) -> Floats:
        """Weight the particles by evidence, and resample if need be; return predictions."""
        is_finding = isinstance(evidence, Finding)
        if self._around is not None and not isinstance(evidence, Finding):
            evidence = evidence.with_reach(self._around)
        self._give_rows(getattr(evidence, 'in_reach', None) or evidence)
        latest = [evidence], self._deployments, is_predicted, self._updated
        joints = self._joints.copy()
        log_chances = self._fold(joints, self.numbers, *latest)
        predicted = log_chances[:, 0]
        if self.names:
            rng = np.random.default_rng([self._seed, len(self._evidence) + 1])
            if (self._log_weights + log_chances[0]).max() == -np.inf:
                joints, log_chances = self._drawn_anew(latest, rng)
            log_weights = self._log_weights
            predicted = log_sum(log_weights - log_sum(log_weights) + log_chances)
        if predicted[0] == -np.inf:
            raise ValueError(IMPOSSIBLE)
        self.log_evidence += float(predicted[0])
        self._evidence, self._joints = self._evidence.plus(evidence), joints
        self._log_likelihood = self._log_likelihood + log_chances[0]
        self._updated = self._updated.copy()
        self._deployments += not is_finding
        self._updated[self._row[evidence.cells]] = self._last
        if self.names:
            self._log_weights = self._log_weights + log_chances[0]
            self.__dict__.pop('weights', None)
            if self.effective() < 0.5 * self._count or len(self.numbers) > self._count:
                self._resample(rng)
                self.__dict__.pop('weights', None)
        return predicted

    def _drawn_anew(
        self,
        latest: tuple[list[Evidence | Finding], int, bool, Places],
        rng: np.random.Generator,
    ) -> tuple[Floats, Floats]:
        """Draw more particles from the prior, since none allows the evidence; fold it again."""
        self.numbers = self._first_numbers(MORE * self._count, rng)
        joints, self._log_likelihood = self._refold(self.numbers, self._evidence)
        self._log_weights = self._log_likelihood
        return joints, self._fold(joints, self.numbers, *latest)

    @property
    def _last(self) -> int:
        """Return the number of the last deployment; 0 also before the first."""
        return max(self._deployments - 1, 0)

    @cached_property
    def weights(self) -> Floats:
        """Return the probability of each particle, shape (particles,)."""
        weights: Floats = np.exp(self._log_weights - self._log_weights.max())
        weights /= weights.sum()
        return weights

    def joint(self) -> tuple[Floats, Floats | None]:
        """Return the weighted mean of the joints at the last deployment, and of duds in them."""
        joint = self._live_joint()[self._row]
        if not self.has_duds:
            return joint, None
        duds: Floats = ((self._joints[:, 0] * self._joints[:, 2]) @ self.weights)[self._row]
        joint[:, 0] = (joint[:, 0] - duds).clip(min=0.0)
        joint[:, 1] += duds
        return joint, duds

    def _live_joint(self) -> Floats:
        """Return the weighted mean of each row's joints of live hazards at the last deployment."""
        joints, weights = self._joints[:, :2], self.weights
        may_change = np.flatnonzero(self._may_change[self._class])
        joint: Floats = joints @ weights if self._count > 1 else joints[..., 0].copy()
        if may_change.size and self._evidence:
            still, ticks = weights.copy(), self._last - self._updated[may_change]
            changed = np.zeros_like(joint[may_change])
            for group in self._groups_of_particles(self.numbers):
                own = joints[..., group.particles][..., group.changing][may_change]
                shares = weights[group.particles][group.changing]
                changed += targets_after(own, ticks, *group.rates) @ shares
                still[group.particles][group.changing] = 0.0
            joint[may_change] = (joints @ still)[may_change] + changed
        if self._count > 1:
            joint /= joint.sum(axis=(1, 2), keepdims=True)
        return joint

    def mean(self, name: str) -> float:
        """Return the posterior mean of a number."""
        return float(self.weights @ self.numbers[:, self.names.index(name)])

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
        mean = self._live_joint()[:, 1].sum(axis=1)
        spread = means.var(axis=0, ddof=1) if len(means) > 1 else np.zeros_like(mean)
        return float(ratio(spread, 2.0 * GROUPS * mean * (1.0 - mean))[self._row].sum())

    def hazard(self) -> Floats:
        """Return P(hazard) of each cell by particle, shape (particles, cells)."""
        # Rounding may give a certain hazard a probability above 1.
        hazard: Floats = self._joints[:, 1].sum(axis=1)
        if self.has_duds:
            hazard = hazard + (self._joints[:, 0] * self._joints[:, 2]).sum(axis=1)
        return hazard.clip(max=1.0)[self._row].T

    def live(self) -> Floats:
        """Return P(live hazard) of each cell by particle, shape (particles, cells)."""
        live: Floats = self._joints[:, 1].sum(axis=1).clip(max=1.0)[self._row].T
        return live

    def models(self, particles: Places) -> list[SensorModel]:
        """Return the sensor models of some particles."""
        return [
            replace(self._known, **{k: v for k, v in zip(self.names, numbers) if k in NUMBERS})
            for numbers in self.numbers[particles].tolist()
        ]

    def draws(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.bool_], Places]:
        """Draw particles, and then hazards of each cell; return both."""
        particles = rng.choice(len(self.numbers), count, p=self.weights)
        hazard = self.hazard()[particles]
        return rng.random(hazard.shape) < hazard, particles

    def effective(self) -> float:
        """Return the effective number of particles."""
        return float(1.0 / (self.weights**2).sum())

    def retold(
        self, belief: Belief, model: SensorModel, own: Callable[[RobotType], RobotType]
    ) -> Filters:
        """Return the filters of the same particles with another prior, model and robot types."""
        other = shallow_copy(self)
        other._set_prior(belief, model)
        other._groups = self.numbers, other._grouped(self.numbers)
        evidence = [
            each if isinstance(each, Finding) else each.with_type(own(each.robot_type))
            for each in self._evidence
        ]
        other._joints, log_likelihood = other._refold(self.numbers, evidence)
        if log_likelihood.max() == -np.inf:
            raise ValueError(IMPOSSIBLE)
        gain = log_likelihood - self._log_likelihood
        other._log_likelihood = log_likelihood
        other._log_weights = self._log_weights + gain
        other.log_evidence = self.log_evidence + float(log_sum(np.log(self.weights) + gain))
        other.__dict__.pop('weights', None)
        return other

    @staticmethod
    def _classes(belief: Belief, are_apart: bool) -> tuple[Places, Places, Places]:
        """Return the first cell of each class of cells, the class of each cell, and the sizes."""
        cells = np.arange(belief.cells)
        if are_apart:
            return cells, cells, np.ones_like(cells)
        return classes_of_cells(belief)

    def _set_prior(self, belief: Belief, model: SensorModel) -> None:
        """Set the prior and the known numbers."""
        self._prior, self._known = belief, model
        self._maps = {
            name: (values[self._first], undecided[self._first])
            for name, (values, undecided) in prior_maps(belief, model, self.names).items()
        }

    def _give_rows(self, evidence: Evidence | Finding) -> None:
        """Give each cell of evidence a row of its own."""
        rows = self._row[evidence.cells]
        is_shared = rows < self._sizes.size
        is_shared[is_shared] = self._sizes[rows[is_shared]] > 1
        if not is_shared.any():
            return
        self._row, shared = self._row.copy(), rows[is_shared]
        self._row[evidence.cells[is_shared]] = len(self._class) + np.arange(shared.size)
        self._class = np.concatenate([self._class, shared])
        self._updated = np.concatenate([self._updated, self._updated[shared]])
        self._joints = np.concatenate([self._joints, self._joints[shared]])

    def _first_numbers(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw the numbers of particles, shape (count, numbers), in their order."""
        numbers = stratified(self._priors, count, rng)
        return numbers[self._order(numbers)]

    def _first_joints(self, numbers: Floats) -> Floats:
        """
        Return the prior of each particle on live hazards, shape (classes, 2, 2, particles).

        If some may be duds, of shape (classes, 3, 2, particles) with P(dud | no live hazard, X) in
        the third row (:eq:`duds`), which only findings change.
        """
        joints = self._whole_joints(numbers)
        if self.has_duds:
            duds = dict(zip(self.names, numbers.T)).get('duds', self._known.duds)
            never = joints[:, 1] * duds
            joints[:, 0] += never
            joints[:, 1] -= never
            share = ratio(never, joints[:, 0])
            joints = np.concatenate([joints, share[:, None]], axis=1)
        return joints

    def _whole_joints(self, numbers: Floats) -> Floats:
        """Return the prior of each particle on all hazards, shape (classes, 2, 2, particles)."""
        if not set(MAPS) & set(self.names):
            return np.repeat(self._prior.joint[self._first, ..., None], len(numbers), axis=-1)
        learnt = dict(zip(self.names, numbers.T))
        hazard, kappa, background = (
            with_average(*self._maps[name], learnt[name], self._sizes)
            if name in learnt
            else self._maps[name][0][:, None]
            for name in MAPS
        )
        return make_joint(*np.broadcast_arrays(hazard, kappa, background))

    def _refold(
        self, numbers: Floats, evidence: Sequence[Evidence | Finding]
    ) -> tuple[Floats, Floats]:
        """Fold evidence into the prior; return joints, and the log likelihood of each particle."""
        joints = self._first_joints(numbers)[self._class]
        return joints, self._fold(joints, numbers, evidence)[0]

    def _fold(
        self,
        joints: Floats,
        numbers: Floats,
        events: Sequence[Evidence | Finding],
        start: int = 0,
        is_predicted: bool = False,
        updated: Places | None = None,
    ) -> Floats:
        """Fold evidence into joints in place; return logs of its chances and predictions."""
        log_chances = []
        rest = events, start, is_predicted, updated
        for group in self._groups_of_particles(numbers):
            some = group.particles
            log_chances.append(self._fold_group(joints[..., some], numbers[some], group, *rest))
        return np.concatenate(log_chances, axis=1)

    def _fold_group(
        self,
        joints: Floats,
        numbers: Floats,
        group: ParticleGroup,
        events: Sequence[Evidence | Finding],
        number: int,
        is_predicted: bool,
        updated: Places | None,
    ) -> Floats:
        """Fold evidence after `number` deployments into joints; return logs of its chances."""
        log_chances: Floats = np.zeros((1, len(numbers)))
        updated = np.zeros(len(joints), np.intp) if updated is None else updated.copy()
        # Outcomes change joints of live hazards, and findings the shares of duds as well.
        live = joints[:, :2]
        for event in events:
            # A finding takes no time: it is of the field at the last deployment.
            is_finding = isinstance(event, Finding)
            now = max(number - 1, 0) if is_finding else number
            if number and not is_finding and group.change is not None:
                live[:] = group.change(live)
            rows = self._row[event.cells]
            if group.rates[0].size:
                changed = rows[self._may_change[self._class[rows]]]
                own, ticks = live[..., group.changing], now - updated[changed]
                own[changed] = targets_after(own[changed], ticks, *group.rates)
                updated[changed] = now
            if isinstance(event, Finding):
                joints[rows], log_chance = take_finding(joints[rows], event)
            else:
                log_chance = self._take_outcome(live, numbers, group, event, is_predicted)
                number += 1
            log_chances = log_chances + log_chance
        return log_chances

    def _take_outcome(
        self,
        live: Floats,
        numbers: Floats,
        group: ParticleGroup,
        evidence: Evidence,
        is_predicted: bool,
    ) -> Floats:
        """Condition joints of live hazards on an outcome; return its ln P, and predictions."""
        seen = evidence
        if group.reaches:
            assert evidence.in_reach is not None
            seen = evidence.in_reach
        robot_type, rows = seen.robot_type, self._row[seen.cells]
        if robot_type not in group.effects:
            group.effects[robot_type] = self._step_effects(robot_type, numbers)
        joint, effects = live[rows], group.effects[robot_type]
        how = self._on_loss if seen.is_lost else condition
        live[rows], log_chance = how(joint, seen, effects)
        if not is_predicted:
            return log_chance[None]
        return np.concatenate([log_chance[None], predict_outcome(joint, seen, effects)])

    def _groups_of_particles(self, numbers: Floats) -> list[ParticleGroup]:
        """Return the groups of particles that are in `_order`, from the cache if known."""
        if self._groups[0] is not numbers:
            self._groups = numbers, self._grouped(numbers)
        return self._groups[1]

    def _kinds(self, numbers: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return whether hazards of each particle reach, and whether its targets change."""
        learnt = dict(zip(self.names, numbers.T))
        reaches = np.full(len(numbers), self._around is not None)
        if 'reach' in learnt:
            reaches = learnt['reach'] > 0.0
        changes = np.full(len(numbers), bool(self._may_change.any()))
        if TARGET_VANISH in learnt and self._targets.kind == 'learn':
            changes &= learnt[TARGET_VANISH] > 0.0
        return reaches, changes

    def _order(self, numbers: Floats) -> Places:
        """Return the order of particles in which those that are folded together are neighbours."""
        reaches, changes = self._kinds(numbers)
        return np.argsort(2 * reaches + changes, kind='stable')

    def _grouped(self, numbers: Floats) -> list[ParticleGroup]:
        """Group particles by whether hazards reach, which costs more."""
        groups = []
        reaches, changes = self._kinds(numbers)
        for reaching in np.unique(reaches).tolist():
            places = np.flatnonzero(reaches == reaching)
            some = slice(places[0], places[-1] + 1)
            own, still = numbers[some], np.count_nonzero(~changes[some])
            changing = slice(still, len(own))
            rates = self._target_rates(own[changing]) if still < len(own) else (np.zeros(0),) * 2
            groups.append(ParticleGroup(some, reaching, self._change(own), changing, rates, {}))
        return groups

    def _change(self, numbers: Floats) -> Callable[[Floats], Floats] | None:
        """Return the change of hazards between deployments."""
        learnt = dict(zip(self.names, numbers.T))
        rates = {name: learnt[name] for name in self._dynamics.unknown_rates}
        if 'vanish' in rates and not self._dynamics.appear:
            density = learnt.get('hazard_density', prior_density(self._prior))
            rates['appear'] = appearance(rates['vanish'], density)
        return hazard_change(self._prior, self._dynamics, rates)

    def _target_rates(self, numbers: Floats) -> tuple[Floats, Floats]:
        """Return the rates at which targets appear and vanish, shape (particles,)."""
        known, vanish = self._targets, dict(zip(self.names, numbers.T)).get(TARGET_VANISH)
        if vanish is None:
            # Without an unknown rate, both are numbers.
            return np.full(len(numbers), known.appear), np.full(len(numbers), known.vanish)
        if known.appear:
            return np.full(len(numbers), known.appear), vanish
        target = self._first_joints(numbers)[self._may_change, :2, 1].sum(axis=1)
        density = np.average(target, axis=0, weights=self._sizes[self._may_change])
        rates: Floats = appearance(vanish, density)
        return rates, vanish

    def _step_effects(self, robot_type: RobotType, numbers: Floats) -> Effects:
        """Return the effects of a step; numbers that the robot type sets replace learnt ones."""
        model = robot_type.model(self._known)
        own = {name: np.full(len(numbers), getattr(model, name)) for name in RATES}
        own |= {
            name: values
            for name, values in zip(self.names, numbers.T)
            if name in RATES and name not in robot_type.sensors
        }
        return Effects.of(own, model.false_negative, self._dynamics.kind == 'used_up')

    def _resample(self, rng: np.random.Generator) -> None:
        """Resample the particles by their weights, and move them."""
        low, high = np.array([(prior.low, prior.high) for prior in self._priors]).T
        weights, is_there = self.weights, self.numbers > 0.0
        # Numbers that are 0 have a logit only for arithmetic.
        inside = np.where(is_there, self.numbers, (low + high) / 2.0)
        logits = np.log(inside - low) - np.log(high - inside)
        mean = weights @ (is_there * logits) / np.maximum(weights @ is_there, 1e-9)
        centred = is_there * (logits - mean)
        covariance = (centred * weights[:, None]).T @ centred + 1e-9 * np.eye(logits.shape[1])
        scale = 2.38 / np.sqrt(logits.shape[1]) * np.linalg.cholesky(covariance).T
        points = (np.arange(self._count) + rng.random()) / self._count
        chosen = np.searchsorted(weights.cumsum(), points).clip(max=weights.size - 1)
        logits, joints = logits[chosen], self._joints[..., chosen]
        is_there, log_likelihood = is_there[chosen], self._log_likelihood[chosen]
        for _ in range(MOVES):
            proposed, is_then = self._propose(logits, is_there, scale, rng)
            numbers = np.where(is_then, expit_within(proposed, self._priors), 0.0)
            order = self._order(numbers)
            back = order.argsort()
            folded, log_proposed = self._refold(numbers[order], self._evidence)
            log_proposed = log_proposed[back]
            log_ratio = log_proposed - log_likelihood
            # A number that becomes or is no longer 0 is drawn by its prior: its density cancels.
            gain = log_density(proposed, self._priors) - log_density(logits, self._priors)
            log_ratio += (gain * (is_there & is_then)).sum(axis=1)
            log_ratio += (is_then * 1.0 - is_there) @ self._log_odds
            is_moved = np.log(rng.random(self._count)) < log_ratio
            logits = np.where(is_moved[:, None], proposed, logits)
            is_there = np.where(is_moved[:, None], is_then, is_there)
            log_likelihood = np.where(is_moved, log_proposed, log_likelihood)
            joints[..., is_moved] = folded[..., back[is_moved]]
        numbers = np.where(is_there, expit_within(logits, self._priors), 0.0)
        order = self._order(numbers)
        self.numbers, self._joints = numbers[order], joints[..., order]
        self._log_likelihood, self._log_weights = log_likelihood[order], np.zeros(self._count)

    def _propose(
        self,
        logits: Floats,
        is_there: NDArray[np.bool_],
        scale: Floats,
        rng: np.random.Generator,
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Propose a step of all numbers, or of some particles a number that is 0 or no longer."""
        proposed = logits + rng.standard_normal(logits.shape) @ scale
        may_be_zero = np.flatnonzero(self._zero)
        if not may_be_zero.size:
            return proposed, is_there
        is_then, which = is_there.copy(), rng.choice(may_be_zero, len(logits))
        switches = rng.random(len(logits)) < SWITCHES
        proposed[switches] = logits[switches]
        for number in may_be_zero.tolist():
            prior, some = self._priors[number], np.flatnonzero(switches & (which == number))
            drawn = within(prior.quantiles(rng.random(some.size))[:, None], [prior])[:, 0]
            proposed[some, number] = np.log(drawn - prior.low) - np.log(prior.high - drawn)
            is_then[some, number] ^= True
        return proposed, is_then


def prior_density(belief: Belief) -> float:
    """Return the mean hazard of the cells that may have a hazard."""
    hazard = belief.hazard
    return float(hazard[hazard > 0.0].mean()) if hazard.any() else 0.0


def log_sum(logs: Floats) -> Floats:
    """Return the log of the sum of exponentials along the last axis."""
    peak = logs.max(axis=-1, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    total: Floats = peak[..., 0] + safe_log(np.exp(logs - peak).sum(axis=-1))
    return total


def stratified(priors: Sequence[Beta], count: int, rng: np.random.Generator) -> Floats:
    """Draw numbers, shape (count, priors), one in each stratum of each prior."""
    columns = [
        prior.quantiles((rng.permutation(count) + rng.random(count)) / count) for prior in priors
    ]
    if not priors:
        return np.empty((count, 0))
    numbers = within(np.stack(columns, axis=1), priors)
    for column, prior in zip(numbers.T, priors):
        if prior.zero:
            column[(rng.permutation(count) + rng.random(count)) / count < prior.zero] = 0.0
    return numbers


def within(numbers: Floats, priors: Sequence[Beta]) -> Floats:
    """Clip numbers inside their intervals, at whose ends the logit is infinite."""
    low, high = np.array([(prior.low, prior.high) for prior in priors]).T
    margin = 1e-9 * (high - low)
    return numbers.clip(low + margin, high - margin)


def expit_within(logits: Floats, priors: Sequence[Beta]) -> Floats:
    """Convert log odds to numbers within their intervals."""
    low, high = np.array([(prior.low, prior.high) for prior in priors]).T
    return within(low + (high - low) * expit(logits), priors)


def log_density(logits: Floats, priors: Sequence[Beta]) -> Floats:
    """Return the log prior density of log odds up to a constant, shape (particles, numbers)."""
    numbers = expit_within(logits, priors)
    a, b = np.array([(prior.a, prior.b) for prior in priors]).T
    density: Floats = (a - 1.0) * np.log(numbers) + (b - 1.0) * np.log1p(-numbers)
    share = expit(logits)
    density += np.log(share) + np.log1p(-share)
    return density
