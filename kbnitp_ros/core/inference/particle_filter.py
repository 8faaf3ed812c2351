# SPDX-License-Identifier: Apache-2.0
"""One-pass filters, vectorised over particles; their evidence is counted by cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from kbnitp_ros.core.field.observation import Observation, Visits
from kbnitp_ros.core.field.sensor import RobotType
from kbnitp_ros.core.inference.filters import loss_weights, RATES, ratio, safe_log
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


# Factors on the odds of a positive reading in alternatives of the model check.
READING_SHIFTS = (2.0, 0.5)


@dataclass(frozen=True, eq=False)
class Evidence:
    """The outcome of one deployment, counted by cell."""

    # Visits to the cells of the path.
    visits: Visits
    # Numbers of readings of each cell, shape (n,); 0 for a lost robot.
    positive: NDArray[np.intp]
    negative: NDArray[np.intp]
    # Number of earlier visits to the cell of each step, shape (steps,).
    before: NDArray[np.intp]
    # 1 if a cell was visited k times before a step, and the step enters it (`inside`) or another
    # cell (`elsewhere`); indexed [(cell, k), step], shape (n * (most visits + 1), steps).
    inside: Floats
    elsewhere: Floats
    # Likelihood of a loss in each step, shape (steps,); None for a return.
    lost_in: Floats | None
    # Type of the robot.
    robot_type: RobotType

    @classmethod
    def of(cls, observation: Observation, robot_type: RobotType) -> Evidence:
        """Count an outcome by cell."""
        path, readings = observation.evidence
        visits, steps = Visits.of(path), path.size - 1
        read = np.full(steps, -1) if readings is None else readings
        cells = visits.cells.size
        positive, negative = (
            np.bincount(visits.of_step[read == reading], minlength=cells) for reading in (1, 0)
        )
        entered = visits.of_step[:, None] == np.arange(cells)
        made = entered.cumsum(axis=0) - entered
        at = np.eye(visits.counts.max(initial=0) + 1)[made]
        size = steps, cells * at.shape[-1]
        inside, elsewhere = (
            (at * where[..., None]).reshape(size).T for where in (entered, ~entered)
        )
        lost_in = None if observation.survived else loss_weights(observation)
        return cls(
            visits, positive, negative, made[entered], inside, elsewhere, lost_in, robot_type
        )


@dataclass(frozen=True, eq=False)
class Steps:
    """Effects of a step into a cell, by particle."""

    # P(survived or lost, hazard y after it | hazard z before it), indexed [z, y, particle], shape
    # (2, 2, particles).
    survive: Floats
    lose: Floats
    # P(reading y | X = x), indexed [y, x, particle], shape (2, 2, particles).
    read: Floats
    # Cached effects of 0, 1, 2, ... survived visits.
    visits: list[Floats] = field(default_factory=list)

    @classmethod
    def of(cls, rates: Mapping[str, Floats], false_negative: float, are_used_up: bool) -> Steps:
        """Return the effects of a step, given the `RATES`, each of shape (particles,)."""
        lethality, malfunction, true_positive, false_positive = (rates[name] for name in RATES)
        endured, none = 1.0 - malfunction, np.zeros_like(malfunction)
        spared, deadly = lethality * false_negative, lethality * (1.0 - false_negative)
        survive = [endured, none, none, endured * (1.0 - deadly)]
        lose = [malfunction, none, none, malfunction + endured * deadly]
        if are_used_up:
            survive = [endured, none, endured * spared, endured * (1.0 - lethality)]
            lose = [malfunction, none, endured * deadly, malfunction]
        read = [1.0 - false_positive, 1.0 - true_positive, false_positive, true_positive]
        survival, loss, reading = (
            np.stack(each).reshape(2, 2, -1) for each in (survive, lose, read)
        )
        return cls(survival, loss, reading)

    def survived(self, most: int) -> list[Floats]:
        """Return the effects of 0 to `most` survived visits, each in the form of `survive`."""
        if not self.visits:
            self.visits.append(np.eye(2)[..., None] + np.zeros_like(self.survive))
        while len(self.visits) <= most:
            self.visits.append(then(self.visits[-1], self.survive))
        return self.visits[: most + 1]


def assimilated(
    joint: Floats, steps: Steps, evidence: Evidence, correlated: bool, is_predicted: bool
) -> tuple[Floats, Floats]:
    """Return joints and ln P (:eq:`bank-returned`, :eq:`bank-lost`, :eq:`shifted-readings`)."""
    hazard = joint.sum(axis=2)
    if not correlated:
        joint = hazard[:, :, None] * joint.sum(axis=1)[:, None]
    counts, cell, before = evidence.visits.counts, evidence.visits.of_step, evidence.before
    powers = steps.survived(counts.max(initial=0))
    if evidence.lost_in is None:
        negative, positive = (
            np.cumprod([np.ones_like(read), *[read] * number.max(initial=0)], axis=0)[number]
            for read, number in zip(steps.read, (evidence.negative, evidence.positive))
        )
        alive = moved_by(np.array(powers)[counts], joint)
        moved, target = alive * (negative * positive)[:, None], alive.sum(axis=1)
        chances = [moved.sum(axis=(1, 2))]
        if is_predicted:
            looks = (evidence.negative + evidence.positive)[:, None, None]
            chances += [target.sum(axis=1)] + [
                (target * (steps.read[0] + shift * steps.read[1]) ** looks).sum(axis=1)
                for shift in READING_SHIFTS
            ]
        return normalised(moved, joint), safe_log(np.stack(chances)).sum(axis=1)
    # P(number of visits survived, hazard after them), (n, visits, 2, particles).
    spared = np.stack(
        [hazard[:, 0, None] * each[0] + hazard[:, 1, None] * each[1] for each in powers], 1
    )
    alive, fatal = spared.sum(axis=2), (spared * steps.lose.sum(axis=1)).sum(axis=2)
    here = alive[cell, before]
    goes_on = ratio(alive[cell, before + 1], here)
    reached = np.cumprod(np.concatenate([np.ones_like(here[:1]), goes_on[:-1]]), axis=0)
    # Probability of a loss in each step, without and with the factor of the cell entered.
    fits = ratio(reached * evidence.lost_in[:, None], here)
    lost = fits * fatal[cell, before]
    elsewhere = ratio((evidence.elsewhere @ lost).reshape(alive.shape), alive)
    inside = (evidence.inside @ fits).reshape(alive.shape)
    after = np.zeros((counts.size, *steps.survive.shape))
    for count, power in enumerate(powers):
        after += elsewhere[:, count, None, None] * power
        after += inside[:, count, None, None] * then(power, steps.lose)
    log_chances = [safe_log(lost.sum(axis=0))]
    if is_predicted:
        log_return = safe_log(alive[np.arange(counts.size), counts]).sum(axis=0)
        log_chances += [log_return] * (1 + len(READING_SHIFTS))
    return normalised(moved_by(after, joint), joint), np.stack(log_chances)


def then(first: Floats, second: Floats) -> Floats:
    """Compose two changes of a hazard, each (z, y, particles)."""
    both: Floats = first[:, 0, None] * second[0] + first[:, 1, None] * second[1]
    return both


def moved_by(moves: Floats, joint: Floats) -> Floats:
    """Apply changes of hazards, (n, z, y, particles), to joints, (n, z, x, particles)."""
    safe, hazardous = moves[:, 0, :, None], moves[:, 1, :, None]
    moved: Floats = safe * joint[:, 0, None] + hazardous * joint[:, 1, None]
    return moved


def normalised(moved: Floats, joint: Floats) -> Floats:
    """Return `moved` normalised; `joint` where the outcome is impossible."""
    total = moved.sum(axis=(1, 2), keepdims=True)
    posterior: Floats = np.divide(moved, total, out=joint.copy(), where=total > 0.0)
    return posterior
