# SPDX-License-Identifier: Apache-2.0
"""
The model check: compares how well alternatives and the belief predict the evidence.

The ratio of an alternative's evidence to the belief's evidence is, if the belief's model is right,
a nonnegative martingale that starts at 1. So is the average of such ratios, which therefore
reaches 20 with a probability of at most .05 (Ville's inequality, :eq:`model-check`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import Floats
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import ANY_RATE, Beta, Dynamics, Unknowns
from kbnitp_ros.core.inference.bank import Bank
from kbnitp_ros.core.inference.filter import Evidence, READING_SHIFTS
from kbnitp_ros.core.inference.particles import log_sum, Series
from kbnitp_ros.core.inference.prior_maps import prior_maps
import numpy as np

# Average ratio at which the model is in doubt.
IN_DOUBT = 20.0

# Factors on the odds of a return in two of the alternatives.
RETURN_SHIFTS = (2.0, 0.5)

# Maximum number of particles of an alternative with an unknown number, and of particles times
# cells: the check of a large field is then as fast as the search, but less sensitive.
PARTICLES, MAX_CELLS = 64, 60_000

WORDS = {
    'static': 'static hazards',
    'used_up': 'hazards that are used up',
    'changing': 'hazards that come and go',
    'moving': 'hazards that move',
}
# Alternatives about targets, the detector, reach and duds, and what is believed in their place.
OTHERS = {
    'changing_targets': ('targets that change', 'still targets'),
    'detector': ('a detector with other rates', 'the given detector'),
    'reach': ('hazards that reach', 'hazards that do not reach'),
    'duds': ('hazards of which some never strike', 'hazards that can all strike'),
    'target_background': ('other shares of targets', 'the given shares of targets'),
}
# Priors of a detector's rates, the shares of targets and a reach in these alternatives.
DETECTOR = {'true_positive': Beta(9.0, 1.0), 'false_positive': Beta(1.0, 9.0)}
TARGETS = {'kappa': Beta(4.0, 1.5), 'target_background': Beta(1.5, 8.0)}
REACH = Beta(low=0.0, high=0.6)
# Alternatives that the evidence often hides, with the shares of missions of 60 robots in which the
# check found them: half of the hazards duds, and a lethality told half of what it is.
MISSED = {'duds': 'duds (found in 18 % of missions)', 'lethality': 'a wrong lethality (in 4 %)'}
# Alternatives that look alike in the evidence.
RIVALS = (
    {'changing_targets', 'detector'},
    {'reach', 'malfunction'},
    {'duds', 'target_background'},
)
SHIFTED = ('more returns', 'fewer returns', 'more positive readings', 'fewer positive readings')

# Weights of the alternatives in the average ratio, higher for more harmful errors; 1 for others.
WEIGHTS = {
    'used_up': 5,
    'reach': 5,
    'malfunction': 4,
    'lethality': 3,
    'static': 3,
    'changing': 2,
    'moving': 2,
}


@dataclass(frozen=True)
class ModelCheck:
    """
    Evidence for and against the assumptions of a belief.

    Attributes
    ----------
    is_in_doubt : bool
        Whether the average ratio has ever reached 20.
    alternatives : mapping of str to float
        For each alternative, the ratio of the probability of all evidence so far under the
        alternative to that under the belief.
    reason : str
        The assumption in doubt, the best explanation and its rivals, as a sentence.

    """

    is_in_doubt: bool
    alternatives: Mapping[str, float]
    reason: str

    @property
    def rivals(self) -> dict[str, float]:
        """Return the probabilities of the best alternative and its rivals, if one is right."""
        best = max(self.alternatives, key=lambda name: self.alternatives[name], default='')
        alike = next((names for names in RIVALS if best in names), {best})
        ratios = {name: each for name, each in self.alternatives.items() if name in alike}
        # A ratio may be infinite.
        shares = {
            name: ratio / ratios[best] if name != best else 1.0 for name, ratio in ratios.items()
        }
        return {name: share / sum(shares.values()) for name, share in shares.items()}


class Checker:
    """The check of a mission's evidence against alternatives to the belief's model."""

    def __init__(self, prior: Callable[[], Alternatives]) -> None:
        self._prior = prior
        # The prior, and after the first check what the last two checks ended with: evidence mostly
        # goes on from the last, or from the one before where a late report came in between.
        self._ends: list[Alternatives] = []

    def check(
        self,
        evidence: Sequence[tuple[Observation | Finding, RobotType]],
        predicted: Sequence[Floats] | None,
    ) -> ModelCheck:
        """Return the check of all evidence, given the belief's prediction of each part of it."""
        # Studies never check, so the banks are made here.
        self._ends = self._ends or [self._prior()]
        begun = [each for each in self._ends if each.begin(evidence)]
        end = begun[-1]
        for place in range(len(end.evidence), len(evidence)):
            end = end.after(*evidence[place], None if predicted is None else predicted[place])
        self._ends = [*dict.fromkeys([self._ends[0], begun[-1], end])]
        return end.result


class Alternatives:
    """The alternatives to a belief's model, and their evidence after some deployments."""

    def __init__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics,
        targets: Dynamics,
        correlated: bool,
        predicts: bool,
    ) -> None:
        count = min(PARTICLES, max(2, MAX_CELLS // belief.cells))

        def bank(unknowns: Unknowns, dynamics: Dynamics) -> Bank:
            return Bank(belief, model, unknowns, seed, dynamics, count=count, targets=targets)

        self._own: Bank | None = None
        if not predicts:
            self._own = bank(unknowns, dynamics)
        self._believed = WORDS.get(dynamics.kind, 'any kind of hazards')
        self._alternatives: dict[str, Bank | None] = {}
        if dynamics.kind != 'learn':
            for other in Dynamics('learn').kinds:
                can_be = other.kind != 'moving' or belief.grid is not None
                if other.kind == 'used_up' and (model.reach or unknowns.reach is not None):
                    can_be = False
                if other.kind != dynamics.effect and can_be:
                    self._alternatives[other.kind] = bank(unknowns, other)
        for name, most in (('malfunction', 0.5), ('lethality', 1.0)):
            makes_a_difference = name == 'malfunction' or model.false_negative < 1.0
            if getattr(unknowns, name) is None and makes_a_difference:
                self._alternatives[name] = bank(replace(unknowns, **{name: (0.0, most)}), dynamics)
        self._alternatives |= self._others(
            belief, model, unknowns, seed, dynamics, targets, correlated, count
        )
        self._model = model
        weights = np.array([WEIGHTS.get(name, 1) for name in (*self._alternatives, *SHIFTED)])
        self._log_weights: Floats = np.log(weights / weights.sum())
        self._log_ratios: Floats = np.zeros(weights.size)
        self.evidence = Series[Observation | Finding]()
        self._turned_at: int | None = None

    @staticmethod
    def _others(
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics,
        targets: Dynamics,
        correlated: bool,
        count: int,
    ) -> dict[str, Bank]:
        """Return banks of changing targets and another detector, of reach, of duds and targets."""
        found = {}

        def add(name: str, changed: Unknowns, targets: Dynamics) -> None:
            found[name] = Bank(
                belief, model, changed, seed, dynamics, count=count, targets=targets
            )

        # Both learn the rates of the detector: else a poor detector is taken for motion.
        seeing = replace(unknowns, **{**DETECTOR, **unknowns.priors})
        if targets.effect == 'static' and belief.target.max() > 0.0:
            add('changing_targets', seeing, Dynamics('changing', vanish=ANY_RATE))
        if seeing != unknowns:
            add('detector', seeing, targets)
        is_static = dynamics.kind not in ('used_up', 'learn') and belief.grid is not None
        if is_static and unknowns.reach is None and not model.reach:
            add('reach', replace(unknowns, reach=REACH), targets)
        if correlated:
            # Both learn the shares of targets: else many targets are taken for duds.
            maps = prior_maps(belief, model, ())
            open_to = {name: prior for name, prior in TARGETS.items() if maps[name][1].any()}
            seeing = replace(unknowns, **{**open_to, **unknowns.priors})
            if seeing != unknowns:
                add('target_background', seeing, targets)
            is_static = dynamics.effect == targets.effect == 'static'
            if is_static and unknowns.duds is None and not model.duds and open_to:
                add('duds', replace(seeing, duds=Beta()), targets)
        return found

    def begin(self, evidence: Sequence[tuple[Observation | Finding, RobotType]]) -> bool:
        """Return whether evidence starts with the evidence so far."""
        return len(self.evidence) <= len(evidence) and all(
            ours is theirs for ours, (theirs, _) in zip(self.evidence, evidence)
        )

    def after(
        self,
        observation: Observation | Finding,
        robot_type: RobotType,
        predicted: Floats | None,
    ) -> Alternatives:
        """Return the alternatives after more evidence, given the belief's prediction of it."""
        other = copy(self)
        evidence = (
            observation
            if isinstance(observation, Finding)
            else Evidence.of(observation, robot_type)
        )
        other.evidence = self.evidence.plus(observation)
        if self._own is not None:
            other._own = self._own.copy()
            other._own.take(evidence)
            predicted = other._own.predicted[-1]
        assert predicted is not None
        other._alternatives, ratios = {}, []
        for name, bank in self._alternatives.items():
            # An alternative is None once the evidence is impossible under it.
            after = None if bank is None else bank.copy()
            try:
                if after is not None:
                    after.take(evidence, is_predicted=False)
            except ValueError:
                after = None
            other._alternatives[name] = after
            ratios.append(-np.inf if after is None else after.predicted[-1][0] - predicted[0])
        if isinstance(observation, Finding):
            # Other odds of returns and readings leave findings as they are.
            ratios += [0.0] * len(SHIFTED)
        else:
            ratios += shifted(observation, predicted)
        other._log_ratios = self._log_ratios + ratios
        average = log_sum(other._log_ratios + self._log_weights)
        if self._turned_at is None and average >= np.log(IN_DOUBT):
            other._turned_at = sum(isinstance(each, Observation) for each in other.evidence)
        return other

    @property
    def result(self) -> ModelCheck:
        """Return the check after the deployments so far."""
        names = (*self._alternatives, *SHIFTED)
        with np.errstate(over='ignore'):
            ratios = dict(zip(names, np.exp(self._log_ratios).tolist()))
        best = max(ratios, key=lambda name: ratios[name])
        explained, believed = self._words(best)
        fits = f'the evidence fits {explained} {ratios[best]:.3g} times better than {believed}'
        rivals = ModelCheck(False, ratios, '').rivals
        if len(rivals) > 1:
            odds = (f'{self._words(name)[0]} with {share:.2f}' for name, share in rivals.items())
            fits += f' ({", ".join(odds)})'
        if self._turned_at is not None:
            reason = f'the model is in doubt since deployment {self._turned_at}: {fits}'
        elif ratios[best] > 1.0:
            average = np.exp(log_sum(self._log_ratios + self._log_weights))
            reason = (
                f'no reason for doubt: {fits}, but all other explanations together '
                f'{average:.2g} times as well; doubt begins at {IN_DOUBT:.0f}'
            )
        else:
            reason = 'no reason for doubt: nothing fits the evidence better than what is believed'
        hidden = [words for name, words in MISSED.items() if name in self._alternatives]
        if hidden and self._turned_at is None:
            reason += f'; the check can miss {" and ".join(hidden)}'
        return ModelCheck(self._turned_at is not None, ratios, reason)

    def _words(self, name: str) -> tuple[str, str]:
        """Return an alternative, and what is believed in its place, in words."""
        bank = self._alternatives.get(name)
        if name in OTHERS:
            return OTHERS[name]
        if bank is not None and name not in WORDS:
            mean = bank.parameters[name].mean
            return f'a {name} of about {mean:.2f}', f'one of {getattr(self._model, name):g}'
        if name in SHIFTED:
            return f'{name} than predicted', 'the prediction'
        return WORDS.get(name, f'a {name}'), self._believed


def shifted(observation: Observation, predicted: Floats) -> list[float]:
    """Return the log ratio of each of `SHIFTED` for an outcome, given the belief's prediction."""
    log_return, *log_shifted = predicted[1:].tolist()
    ratios = []
    for shift in RETURN_SHIFTS:
        gain = np.log(shift) if observation.survived else 0.0
        ratios.append(gain - np.log1p((shift - 1.0) * np.exp(log_return)))
    _, readings = observation.evidence
    positive = 0 if readings is None else np.count_nonzero(readings == 1)
    for shift, log_total in zip(READING_SHIFTS, log_shifted):
        ratios.append(positive * np.log(shift) + log_return - log_total)
    return ratios
