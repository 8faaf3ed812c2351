# SPDX-License-Identifier: Apache-2.0
"""
The filter: joints of the cells under each of many hypotheses, given a deployment in closed form.

A hypothesis is a guess of all numbers. Joints have the shape (cells, 2, 2, hypotheses), indexed
[cell, z, x, hypothesis]. A filter of known numbers has one hypothesis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import Floats
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.observation import Exposures, Observation, Visits
from kbnitp_ros.core.field.sensor import ORDINARY, RobotType, SensorModel, times_log
from kbnitp_ros.core.field.unknowns import (
    Dynamics,
    joint_after_change,
    joint_after_moves,
    neighbors_to_move_to,
    Rates,
)
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Numbers of a sensor model that can be unknown.
RATES = ('lethality', 'malfunction', 'true_positive', 'false_positive', 'reach')

# All numbers of a sensor model that can be unknown.
NUMBERS = (*RATES, 'duds')

# Text of the exception for impossible evidence.
IMPOSSIBLE = (
    'the outcome is impossible under this belief and sensor model: '
    'allow for it with probabilities that are not exactly 0 or 1'
)

# Maximum number of values of an array over steps, cells and hypotheses.
MAX_VALUES = 1_000_000

# Lowest log of a power: what is possible stays so, where products would underflow.
LOWEST = -340.0

# Factors on the odds of a positive reading in alternatives of the model check.
READING_SHIFTS = (2.0, 0.5)


def safe_log(chance: Floats) -> Floats:
    """Return the logarithm, -inf for 0."""
    log: Floats = np.log(chance, out=np.full_like(chance, -np.inf), where=chance > 0.0)
    return log


def ratio(part: Floats, whole: Floats) -> Floats:
    """Return part / whole, 0 if both are 0."""
    share: Floats = np.divide(part, whole, out=np.zeros_like(part), where=whole > 0.0)
    return share


def power(count: ArrayLike, log: Floats) -> Floats:
    """Return the log of a power, at least `LOWEST` or -inf."""
    exact = times_log(count, log)
    return np.where(log > -np.inf, np.maximum(exact, LOWEST), exact)


def check_cells(belief: Belief, observation: Observation) -> None:
    """Check that a path lies in the field of a belief."""
    if observation.path.max() >= belief.cells:
        beyond = observation.path[observation.path >= belief.cells]
        raise ValueError(
            f'path has the cell {beyond[0]}: the belief has the cells 0 to {belief.cells - 1}'
        )


def hazard_change(
    prior: Belief, dynamics: Dynamics, rates: Mapping[str, Rates] = MappingProxyType({})
) -> Callable[[Floats], Floats] | None:
    """Return the update of joints for hazard changes between deployments; None if all stay."""
    possible = prior.hazard > 0.0
    appear, vanish, move = (
        rates.get(name, getattr(dynamics, name)) for name in ('appear', 'vanish', 'move')
    )
    if dynamics.effect == 'changing':
        return partial(joint_after_change, possible=possible, appear=appear, vanish=vanish)
    if dynamics.effect == 'moving':
        if prior.grid is None:
            raise ValueError(
                'hazards are moving, and the prior has no grid for them to move on: make it with '
                'Belief.prior(grid, ...) or belief.on(grid)'
            )
        neighbors = neighbors_to_move_to(prior.grid, possible)
        return partial(joint_after_moves, neighbors=neighbors, move=move)
    return None


@dataclass(frozen=True, eq=False)
class Evidence:
    """The outcome of one deployment, counted by cell."""

    # Visits to the cells of the path.
    visits: Visits
    # Numbers of readings of each cell, shape (n,); 0 for a lost robot.
    positive: NDArray[np.intp]
    negative: NDArray[np.intp]
    # Whether the robot was lost, the steps that it is known to have survived, and the likelihood
    # of a loss in each step, shape (steps,); None if all later steps are alike.
    is_lost: bool
    first: int = 0
    lost_at: Floats | None = None
    # Whether a hazard is known to be the cause of a loss, or not to be; None if that is unknown.
    by_hazard: bool | None = None
    robot_type: RobotType = ORDINARY
    # Where hazards reach: exposures of all cells of `visits`, inside and beside.
    exposures: Exposures | None = None
    # The same evidence with the cells around those of the path, where hazards may reach.
    in_reach: Evidence | None = None

    @classmethod
    def of(cls, observation: Observation, robot_type: RobotType = ORDINARY) -> Evidence:
        """Count an outcome by cell."""
        path, readings = observation.evidence
        visits = Visits.of(path)
        positive = negative = np.zeros_like(visits.counts)
        if readings is not None:
            seen, unseen = (visits.of_step[readings == reading] for reading in (1, 0))
            positive, negative = (np.bincount(e, minlength=positive.size) for e in (seen, unseen))
        located = observation.steps_survived, observation.lost_at, observation.by_hazard
        return cls(visits, positive, negative, not observation.survived, *located, robot_type)

    def with_type(self, robot_type: RobotType) -> Evidence:
        """Return the evidence of a robot of another type."""
        wide = self.in_reach and self.in_reach.with_type(robot_type)
        return replace(self, robot_type=robot_type, in_reach=wide)

    def with_reach(self, around: NDArray[np.intp]) -> Evidence:
        """Return the evidence with its `in_reach`, given `Grid.around`."""
        steps = self.visits.cells[self.visits.of_step]
        found = Exposures.of(np.append(steps[:1], steps), around)
        place = found.cells.searchsorted(self.visits.cells)
        counts, positive, negative = np.zeros((3, found.cells.size), np.intp)
        counts[place], positive[place] = self.visits.counts, self.positive
        negative[place] = self.negative
        visits = Visits(found.cells, counts, found.of_step)
        wide = replace(self, visits=visits, positive=positive, negative=negative, exposures=found)
        return replace(self, in_reach=wide)

    @property
    def cells(self) -> NDArray[np.intp]:
        """Return the cells of the path."""
        return self.visits.cells

    @cached_property
    def lost_in(self) -> Floats:
        """Return the likelihood of a loss in each step, shape (steps,)."""
        if self.lost_at is not None:
            return self.lost_at
        return (np.arange(self.visits.of_step.size) >= self.first).astype(float)

    @cached_property
    def has_readings(self) -> bool:
        """Detect readings of any cell."""
        return not self.is_lost and bool(self.negative.any() or self.positive.any())

    @cached_property
    def made(self) -> NDArray[np.intp]:
        """Return the visits to each cell before each step, and after all, (steps + 1, n)."""
        entered = self.visits.of_step[:, None] == np.arange(self.visits.cells.size)
        made: NDArray[np.intp] = np.concatenate([entered[:1] & False, entered]).cumsum(axis=0)
        return made


class Powers(NamedTuple):
    """Effects of 0, 1, 2, ... survived visits, each of shape (visits, hypotheses)."""

    # P(survived, Z stays as it is | Z), shape (visits, 2, hypotheses), and P(survived, the hazard
    # is used up); None if no hazard is used up.
    same: Floats
    spared: Floats | None
    # Log P(Z stays as it is | Z, no malfunction), shape (visits, 2, hypotheses).
    log_kept: Floats
    # P(survived | hazard, no malfunction) and its complement.
    survived: Floats
    lost: Floats


@dataclass(frozen=True, eq=False)
class Effects:
    """Effects of a step on the robot and on the hazard of its cell, by hypothesis."""

    # Probability of a malfunction, and of a strike by a hazard that destroys the robot, shape
    # (hypotheses,).
    malfunction: Floats
    strike: Floats
    # Log probabilities of no malfunction, and that a hazard neither strikes nor is used up.
    log_endured: Floats
    log_kept: Floats
    # Probability that a robot survives a strike that uses the hazard up; None if no hazard is
    # used up.
    spared: float | None
    # Log P(reading y | X = x), indexed [y, x, hypothesis], shape (2, 2, hypotheses).
    log_read: Floats
    # Log probability that a hazard beside the cell does not strike; None if no hazard reaches.
    log_spared_beside: Floats | None = None
    # Powers for visits and for readings, by their maximum.
    _powers: dict[int, Powers] = field(default_factory=dict)
    _read: dict[int, Floats] = field(default_factory=dict)

    @classmethod
    def of(
        cls, rates: Mapping[str, Any], false_negative: float, are_used_up: bool = False
    ) -> Effects:
        """Return the effects of a step, given the `RATES`, each of shape (hypotheses,)."""
        lethality, malfunction, *chances, reach = (
            np.atleast_1d(rates[name]) * 1.0 for name in RATES
        )
        strike = lethality * (1.0 - false_negative)
        positive = np.stack(chances[::-1])
        with np.errstate(divide='ignore'):
            endured = np.log1p(-malfunction)
            kept = np.log1p(-(lethality if are_used_up else strike))
            read = np.log(np.stack([1.0 - positive, positive]))
            beside = np.log1p(-strike * reach) if reach.any() else None
        spared = false_negative if are_used_up else None
        return cls(malfunction, strike, endured, kept, spared, read, beside)

    def powers(self, most: int) -> Powers:
        """Return the effects of up to `most` visits (:eq:`used-up-survival`)."""
        if most not in self._powers:
            visits = np.arange(most + 1)[:, None]
            log_kept = power(visits, self.log_kept)
            nothing = np.zeros_like(log_kept)
            endured = np.exp(power(visits, self.log_endured))
            kept, gone = np.exp(log_kept), 0.0 - np.expm1(log_kept)
            spared = gone * (self.spared or 0.0)
            self._powers[most] = Powers(
                np.stack([endured + nothing, endured * kept], axis=1),
                None if self.spared is None else endured * spared,
                np.stack([nothing, log_kept], axis=1),
                kept + spared,
                gone - spared,
            )
        return self._powers[most]

    def readings(self, most: int) -> Floats:
        """Return the powers of P(y | x), indexed [number, y, x, hypothesis]."""
        if most not in self._read:
            numbers = np.arange(most + 1)[:, None, None, None]
            self._read[most] = np.exp(power(numbers, self.log_read))
        return self._read[most]

    def at(self, some: slice) -> Effects:
        """Return the effects under some of the hypotheses."""
        arrays = (self.malfunction, self.strike, self.log_endured, self.log_kept, self.log_read)
        malfunction, strike, endured, kept, read = (each[..., some] for each in arrays)
        return Effects(malfunction, strike, endured, kept, self.spared, read)


@lru_cache(maxsize=64)
def known_effects(model: SensorModel, are_used_up: bool = False) -> Effects:
    """Return the effects of a step under a known sensor model."""
    return Effects.of(vars(model), model.false_negative, are_used_up)


class Likelihood(NamedTuple):
    """P(outcome, Z after | Z before) of each cell, up to a scale."""

    # Z stays as it is, shape (n, 2, hypotheses), and falls from 1 to 0, shape (n, hypotheses).
    same: Floats
    spared: Floats | None
    # Log of the scale, shape (n, hypotheses), or 0.
    log_scale: Floats = np.zeros((1, 1))


def condition(joint: Floats, evidence: Evidence, effects: Effects) -> tuple[Floats, Floats]:
    """
    Return the joints of the path's cells given an outcome, and the outcome's ln P.

    For a return, each joint is multiplied by the likelihoods of survival and of the readings, the
    product of arXiv:2305.06929, eq. 2, and normalised (Algorithm 1, lines 6-8; eq. 6-8).

    Parameters
    ----------
    joint : ndarray, shape (n, 2, 2, hypotheses)
        Joints of the cells of the path before the deployment.
    evidence : Evidence
        The outcome, counted by cell.
    effects : Effects
        Effects of a step.

    Returns
    -------
    joint : ndarray, shape (n, 2, 2, hypotheses)
        The joints after it, :eq:`returned`, :eq:`loss-exact`, :eq:`used-up-returned` and
        :eq:`used-up-lost`; those before it under hypotheses that make the outcome impossible.
    log_chance : ndarray, shape (hypotheses,)
        Log probability of the outcome, :eq:`bank-returned` and :eq:`bank-lost`; -inf if it is
        impossible.

    """
    counts = evidence.visits.counts
    if not counts.size:
        return joint, np.zeros(joint.shape[-1])
    hazard = joint[:, :, 0] + joint[:, :, 1]
    same, spared, log_scale = outcome_likelihood(hazard, evidence, effects)
    after = joint * same[:, :, None]
    if spared is not None:
        after[:, 0] += joint[:, 1] * spared[:, None]
    if evidence.has_readings:
        after *= reading_likelihood(evidence, effects)[:, None]
    total = after[:, 0, 0] + after[:, 0, 1] + after[:, 1, 0] + after[:, 1, 1]
    if total.min() > 0.0:
        after /= total[:, None, None]
        log_total = np.log(total)
    else:
        whole = total[:, None, None]
        after = np.divide(after, whole, out=joint.copy(), where=whole > 0.0)
        log_total = safe_log(total)
    return after, log_total[0] + log_scale[0] if evidence.is_lost else log_total.sum(axis=0)


def take_finding(joint: Floats, finding: Finding) -> tuple[Floats, Floats]:
    """
    Return the joints of a finding's cells given it, and its ln P.

    Parameters
    ----------
    joint : ndarray, shape (n, 2, 2, hypotheses) or (n, 3, 2, hypotheses)
        Joints of live hazards; the third row, if any, is P(dud | no live hazard, X).
    finding : Finding
        What a person knows of these cells.

    Returns
    -------
    joint : ndarray, as `joint`
        The joints after it, :eq:`finding` and :eq:`finding-changed`; those before it under
        hypotheses that make it impossible.
    log_chance : ndarray, shape (hypotheses,)
        Log probability of the finding, :eq:`finding-evidence`; 0 if the field was changed.

    """
    states = joint
    if joint.shape[1] > 2:
        rest, live, share = np.moveaxis(joint, 1, 0)
        states = np.stack([rest * (1.0 - share), live, rest * share], axis=1)
    count = states.shape[1]
    of_hazard, of_target = finding.of_hazard[:count, :count], finding.of_target
    after = np.einsum('zu,xv,nuvh->nzxh', of_hazard, of_target, states)
    total = after.sum(axis=(1, 2), keepdims=True)
    after = np.divide(after, total, out=states.copy(), where=total > 0.0)
    if count > 2:
        safe, live, duds = np.moveaxis(after, 1, 0)
        after = np.stack([safe + duds, live, ratio(duds, safe + duds)], axis=1)
    log_chance: Floats = safe_log(total[:, 0, 0]).sum(axis=0)
    return after, log_chance * (not finding.changed)


def outcome_likelihood(hazard: Floats, evidence: Evidence, effects: Effects) -> Likelihood:
    """Return P(outcome, Z after | Z before) of each cell, given P(Z) of all, (n, 2, h)."""
    if evidence.exposures is not None:
        return likelihood_in_reach(hazard, evidence, effects)
    if evidence.is_lost:
        return lost(hazard, evidence, effects)
    counts = evidence.visits.counts
    powers = effects.powers(int(counts.max()))
    spared = None if powers.spared is None else powers.spared[counts]
    return Likelihood(powers.same[counts], spared)


def reading_likelihood(evidence: Evidence, effects: Effects) -> Floats:
    """Return P(readings | X = x) of each cell, (n, 2, hypotheses) (:eq:`returned`)."""
    negative, positive = evidence.negative, evidence.positive
    powers = effects.readings(int(max(negative.max(), positive.max())))
    likelihood: Floats = powers[negative, 0] * powers[positive, 1]
    return likelihood


def hazards_used_up(
    belief: Belief, model: SensorModel, observation: Observation
) -> NDArray[np.float64]:
    """Return P(used up) of each cell's hazard (:eq:`used-up-returned`, :eq:`used-up-lost`)."""
    evidence, effects = Evidence.of(observation), known_effects(model, are_used_up=True)
    used_up, cells = np.zeros(belief.cells), evidence.visits.cells
    if not cells.size:
        return used_up
    joint = belief.joint[cells, ..., None]
    same, spared, _ = outcome_likelihood(joint.sum(axis=2), evidence, effects)
    if evidence.has_readings:
        joint = joint * reading_likelihood(evidence, effects)[:, None]
    before = joint.sum(axis=2)
    gone = before[:, 1] * spared
    used_up[cells] = ratio(gone, gone + (before * same).sum(axis=1))[:, 0]
    return used_up


def independent(joint: Floats) -> Floats:
    """Return the joints with the same hazards and targets, independent of each other."""
    product: Floats = joint.sum(axis=2)[:, :, None] * joint.sum(axis=1)[:, None]
    return product


def predict_outcome(joint: Floats, evidence: Evidence, effects: Effects) -> Floats:
    """Return ln P(return), and with each shift of readings' odds (:eq:`shifted-readings`)."""
    counts = evidence.visits.counts
    powers = effects.powers(int(counts.max(initial=0)))
    survived = powers.same[counts]
    if evidence.exposures is not None:
        survived = survived_in_reach(evidence.exposures, effects)
    elif powers.spared is not None:
        survived[:, 1] += powers.spared[counts]
    alive = joint[:, 0] * survived[:, :1] + joint[:, 1] * survived[:, 1:]
    looks = (evidence.negative + evidence.positive)[:, None, None]
    negative, positive = np.exp(effects.log_read)
    chances = [alive] + [
        alive * (negative + shift * positive) ** looks for shift in READING_SHIFTS
    ]
    log_chances: Floats = safe_log(np.stack(chances).sum(axis=2)).sum(axis=1)
    return log_chances


def log_kept_in_reach(exposures: Exposures, effects: Effects, steps: slice) -> Floats:
    """Return ln P(steps survived | hazard, no malfunction) of each cell, (n, hypotheses)."""
    kept = times_log(exposures.inside[steps].sum(axis=0)[:, None], effects.log_kept)
    if effects.log_spared_beside is not None:
        beside = exposures.beside[steps].sum(axis=0)[:, None]
        kept = kept + times_log(beside, effects.log_spared_beside)
    return kept


def survived_in_reach(exposures: Exposures, effects: Effects) -> Floats:
    """Return P(path survived | Z) of each cell, (n, 2, hypotheses) (:eq:`reach`)."""
    inside = exposures.inside.sum(axis=0)[:, None]
    endured = np.exp(times_log(inside, effects.log_endured))
    kept = np.exp(log_kept_in_reach(exposures, effects, slice(None)))
    return np.stack([endured, endured * kept], axis=1)


def likelihood_in_reach(hazard: Floats, evidence: Evidence, effects: Effects) -> Likelihood:
    """Return the likelihood of an outcome where hazards reach (:eq:`reach`)."""
    exposures, steps = evidence.exposures, evidence.visits.of_step.size
    assert exposures is not None
    if not evidence.is_lost:
        return Likelihood(survived_in_reach(exposures, effects), None)
    # A sum over the stretches of steps in which the weight of a loss is the same, or over steps if
    # the cause is known.
    weights, by_hazard = evidence.lost_in, evidence.by_hazard
    ends = np.append(np.flatnonzero(np.diff(weights)) + 1, steps).tolist()
    if by_hazard is not None:
        ends = [*range(1, steps + 1)]
    failed, _ = loss_causes(evidence, effects)
    # ln P(steps before the stretch survived | Z), and P(Z) given that they were.
    start, terms, reached = 0, [], np.zeros_like(hazard)
    for end in ends:
        log_kept = log_kept_in_reach(exposures, effects, slice(start, end))
        kept, loss = np.exp(log_kept), hazard[:, 1] * -np.expm1(log_kept)
        mean = hazard[:, 0] + hazard[:, 1] * kept
        # 1 - loss is inaccurate for losses near 1, the sum of survivals for losses near 0.
        log_mean = np.where(loss < 0.5, np.log1p(-np.minimum(loss, 0.5)), safe_log(mean))
        rest = others(log_mean) + times_log(end - start, effects.log_endured)
        survived = np.stack([rest, rest + log_kept], axis=1)
        if weights[start] > 0.0 and by_hazard is None:
            terms.append(reached + safe_log(-weights[start] * np.expm1(survived)))
        elif weights[start] > 0.0 and by_hazard:
            struck = -np.expm1(survived - effects.log_endured)
            terms.append(reached + effects.log_endured + safe_log(weights[start] * struck))
        elif weights[start] > 0.0:
            terms.append(reached + safe_log(weights[start] * failed))
        hazard = np.stack([ratio(hazard[:, 0], mean), ratio(hazard[:, 1] * kept, mean)], axis=1)
        start, reached = end, reached + survived
    stacked = np.stack(terms)
    scale = stacked.max(axis=(0, 1, 2))
    scale[scale == -np.inf] = 0.0
    return Likelihood(np.exp(stacked - scale).sum(axis=0), None, scale[None])


def lost(hazard: Floats, evidence: Evidence, effects: Effects) -> Likelihood:
    """Return a loss's likelihood: a sum over steps, which may telescope (:eq:`loss-universes`)."""
    if effects.spared is None and evidence.lost_at is None and evidence.by_hazard is None:
        return lost_after(evidence.first, hazard, evidence, effects)
    hypotheses = hazard.shape[-1]
    width = max(MAX_VALUES // evidence.made.size, 1)
    if width >= hypotheses:
        return lost_in_steps(hazard, evidence, effects)
    blocks = [slice(start, start + width) for start in range(0, hypotheses, width)]
    parts = [lost_in_steps(hazard[..., some], evidence, effects.at(some)) for some in blocks]
    return Likelihood(*(np.concatenate(each, axis=-1) for each in zip(*parts)))


def loss_causes(evidence: Evidence, effects: Effects) -> tuple[Floats, Floats]:
    """Return P(failure) and P(strike | hazard) in the step of a loss (:eq:`loss-cause`)."""
    failed, struck = effects.malfunction, (1.0 - effects.malfunction) * effects.strike
    if evidence.by_hazard is None:
        return failed, struck
    if evidence.by_hazard:
        return 0.0 * failed, struck
    # A failure that the model rules out says nothing of its numbers.
    return failed if failed.any() else np.ones_like(failed), 0.0 * struck


def log_survival(hazard: Floats, counts: NDArray[np.intp], powers: Powers) -> Floats:
    """Return ln P(so many visits survived, no malfunction), (..., n, hypotheses)."""
    loss = hazard[:, 1] * powers.lost[counts]
    # 1 - loss is inaccurate for losses near 1, the sum of survivals for losses near 0.
    log: Floats = np.log1p(-np.minimum(loss, 0.5))
    if loss.max() >= 0.5:
        survived = hazard[:, 0] + hazard[:, 1] * powers.survived[counts]
        log = np.where(loss < 0.5, log, safe_log(survived))
    return log


def others(logs: Floats) -> Floats:
    """Return, in place of each cell's value, the sum over all other cells, (..., n, h)."""
    before: Floats = np.zeros_like(logs)
    after = before.copy()
    np.cumsum(logs[..., :-1, :], axis=-2, out=before[..., 1:, :])
    np.cumsum(logs[..., :0:-1, :], axis=-2, out=after[..., -2::-1, :])
    before += after
    return before


def lost_after(first: int, hazard: Floats, evidence: Evidence, effects: Effects) -> Likelihood:
    """Return P(survived `first` steps, lost later | Z) (:eq:`loss-exact`, :eq:`loss-contact`)."""
    counts, steps = evidence.visits.counts, evidence.visits.of_step.size - first
    powers = effects.powers(int(counts.max()))
    if first:
        survived = evidence.made[first]
        counts, same = counts - survived, powers.same[survived]
        alive = (hazard * same).sum(axis=1)
        same = ratio(same, alive[:, None])
        hazard = hazard * same
    rest = others(log_survival(hazard, counts, powers)) + steps * effects.log_endured
    lost = -np.expm1(rest[:, None] + powers.log_kept[counts])
    if first:
        return Likelihood(same * lost, None, safe_log(alive).sum(axis=0)[None])
    return Likelihood(lost, None)


def lost_in_steps(hazard: Floats, evidence: Evidence, effects: Effects) -> Likelihood:
    """Return sum_k w_k P(lost in step k, Z after | Z before) (:eq:`located-exact`)."""
    of_step, made = evidence.visits.of_step, evidence.made[:-1]
    here = np.arange(of_step.size)
    powers = effects.powers(int(made.max()))
    kept = np.exp(powers.log_kept[:, 1])
    spared, kept = (powers.survived - kept)[made], kept[made]
    # In the step of the loss the robot failed, or a hazard struck it.
    failed, struck = loss_causes(evidence, effects)
    own_kept, own_spared = kept[here, of_step], spared[here, of_step]
    own_lost = own_kept * struck
    own_kept, own_spared = own_kept * failed, own_spared * failed
    if effects.spared is None:
        own_kept += own_lost
    else:
        own_spared += own_lost
    chance = log_survival(hazard, made, powers)
    chance[here, of_step] = safe_log(
        hazard[of_step, 0] * failed + hazard[of_step, 1] * (own_kept + own_spared)
    )
    log_weights = safe_log(evidence.lost_in)[:, None] + times_log(
        here[:, None], effects.log_endured
    )
    reached = others(chance) + log_weights[:, None]
    scale = reached.max(axis=0)
    scale[scale == -np.inf] = 0.0
    reached = np.exp(reached - scale)
    at_own = reached[here, of_step]
    reached[here, of_step] = 0.0
    is_in = (of_step == np.arange(evidence.visits.cells.size)[:, None]).astype(float)
    stays = reached.sum(axis=0) + is_in @ (at_own * failed)
    kept = (reached * kept).sum(axis=0) + is_in @ (at_own * own_kept)
    spared = (reached * spared).sum(axis=0) + is_in @ (at_own * own_spared)
    return Likelihood(np.stack([stays, kept], axis=1), spared, scale)
