# SPDX-License-Identifier: Apache-2.0
"""Kernels over the readings of cells, the exposures of a path, and its exact value."""

from __future__ import annotations

from math import exp, expm1, inf, isnan, log, log1p, nan
from typing import NamedTuple

from kbnitp_ros.core.field.check import Floats, Places
from kbnitp_ros.core.field.compiled import compiled, inlined
from kbnitp_ros.core.planning.label_kernels import (
    Gains,
    LabelProblem,
    Labels,
    new_labels,
    surprisal,
    visit,
)
import numpy as np

# Number of readings of a cell, plus 1, whose information is kept for other paths.
MAX_KEPT = 8


class Readings(NamedTuple):
    """Readings of a cell; a state is the number of readings by each camera so far."""

    # P(n visits survived | Z = z), indexed [n, z], shape (most visits + 1, 2).
    survival: Floats
    # State after n more readings by the robot, shape (earlier states, most visits + 1).
    after: Places
    # Number of outcomes of each state, shape (states,).
    outcomes: Places
    # P(outcome | X = x), indexed [state, outcome, x], 0 beyond the outcomes of a state; shape
    # (states, most outcomes, 2).
    likelihood: Floats
    # Entropy of the outcome, nats, indexed [state, x], shape (states, 2).
    noise: Floats


@compiled
def predict_visits(
    readings: Readings,
    joint: Floats,
    earlier: Floats,
    log_step: tuple[float, float],
    log_survival: Floats,
    information: Floats,
) -> None:
    """
    Write log S of visits, and what their readings tell; rows are cells given an outcome.

    Equations :eq:`predicted-survival` and :eq:`reading-information`.
    """
    survival = readings.survival
    for row in range(joint.shape[0]):
        hazard = min(joint[row, 1, 0] + joint[row, 1, 1], 1.0)
        log_survival[row, 0] = information[row, 0] = 0.0
        for n in range(1, survival.shape[0]):
            lost = -(1.0 - hazard) * expm1(n * log_step[0]) - hazard * expm1(n * log_step[1])
            survived = (1.0 - hazard) * survival[n, 0] + hazard * survival[n, 1]
            # 1 - lost is inaccurate for losses near 1, the sum of survivals for losses near 0.
            if lost < 0.5:
                log_survival[row, n] = log1p(-lost)
            else:
                log_survival[row, n] = log(survived) if survived > 0.0 else -inf
            information[row, n] = 0.0
            without = joint[row, 0, 0] * survival[n, 0] + joint[row, 1, 0] * survival[n, 1]
            target = joint[row, 0, 1] * survival[n, 0] + joint[row, 1, 1] * survival[n, 1]
            if without + target == 0.0:
                continue
            target /= without + target
            for state in range(earlier.shape[1]):
                if earlier[row, state] > 0.0:
                    then, now = readings.after[state, n], readings.after[state, 0]
                    more = reading_information(target, then, readings)
                    more -= reading_information(target, now, readings)
                    information[row, n] += earlier[row, state] * more


@compiled
def write_gains(
    log_survival: Floats,
    information: Floats,
    hazard: Floats,
    interest: Floats,
    log_step: tuple[float, float],
    exponents: Floats,
    gains: Gains,
) -> None:
    """
    Write the gains of visits, given `predict_visits` by outcome, cell and number of visits.

    Equations :eq:`moment-power` and :eq:`moment-log`.
    """
    factor, term, powers, outcomes = gains.factor, gains.term, exponents.size, len(log_survival)
    visits = factor.shape[1]
    # s_z^(n a), indexed [z, n, a], and s_z^n ln s_z^n.
    power, p_log_p = np.ones((2, visits + 1, powers)), np.zeros((2, visits + 1))
    for z in range(2):
        for n in range(1, visits + 1):
            for k in range(powers):
                power[z, n, k] = exp(exponents[k] * n * log_step[z])
            if power[z, n, 0] > 0.0:
                p_log_p[z, n] = power[z, n, 0] * n * log_step[z]
    for cell in range(hazard.size):
        deadly, safe = hazard[cell], 1.0 - hazard[cell]
        spread = 0.0
        for n in range(visits):
            for k in range(powers):
                moment = safe * power[0, n, k] + deadly * power[1, n, k]
                after = safe * power[0, n + 1, k] + deadly * power[1, n + 1, k]
                factor[cell, n, k] = after / moment if moment > 0.0 else 0.0
            mean = safe * power[0, n + 1, 0] + deadly * power[1, n + 1, 0]
            after = safe * p_log_p[0, n + 1] + deadly * p_log_p[1, n + 1]
            after = after / mean if mean > 0.0 else 0.0
            term[cell, n, 0], spread = after - spread, after
            for outcome in range(outcomes):
                more = information[outcome, cell, n + 1] - information[outcome, cell, n]
                added, log_ratio = more * interest[cell], -inf
                if log_survival[outcome, cell, n + 1] > -inf:
                    log_ratio = log_survival[outcome, cell, n + 1] - log_survival[outcome, cell, n]
                    # Once survival is impossible, a visit changes nothing.
                    added -= log_ratio
                term[cell, n, 1 + outcome] = added
                factor[cell, n, powers + outcome] = exp(log_ratio)


@inlined
def reading_information(target: float, state: int, readings: Readings) -> float:
    """Return the information of a state's readings about a target with P(X = 1) = `target`."""
    entropy: float = 0.0
    for outcome in range(readings.outcomes[state]):
        without = (1.0 - target) * readings.likelihood[state, outcome, 0]
        there = target * readings.likelihood[state, outcome, 1]
        p = without + there
        if p > 0.0:
            entropy -= p * log(p)
    entropy -= (1.0 - target) * readings.noise[state, 0] + target * readings.noise[state, 1]
    return entropy


@compiled
def open_entropies(steps: int, log_safe: float, log_deadly: float) -> Floats:
    """Return h(P(survive | c exposures)) by c (:eq:`exposures`)."""
    entropy = np.zeros(steps + 1)
    for c in range(steps + 1):
        log_survival = 0.0
        if c < steps:
            log_survival += (steps - c) * log_safe
        if c > 0:
            log_survival += c * log_deadly
        survival, loss = exp(log_survival), -expm1(log_survival)
        if survival > 0.0 and loss > 0.0:
            entropy[c] = -(survival * log_survival + loss * log(loss))
    return entropy


@compiled
def left_open(path: Places, hazard: Floats, entropies: Floats) -> float:
    """Return E_z[h(P(survive | z))] (:eq:`outcome-entropy`), given `open_entropies`."""
    visits = np.zeros(hazard.size, np.int64)
    for cell in path:
        visits[cell] += 1
    # Probability of each number of exposures in the cells processed so far (:eq:`exposures`).
    chance = np.zeros(path.size + 1)
    chance[0] = 1.0
    most = 0
    for cell in path:
        z, n = hazard[cell], visits[cell]
        if n == 0:
            continue
        visits[cell] = 0
        most += n
        for c in range(most, n - 1, -1):
            chance[c] = (1.0 - z) * chance[c] + z * chance[c - n]
        for c in range(n):
            chance[c] *= 1.0 - z
    entropy = 0.0
    for c in range(chance.size):
        entropy += chance[c] * entropies[c]
    return entropy


@compiled
def readings_information(target: float, readings: int, camera: tuple[float, float]) -> float:
    """Return the information of readings about a target (:eq:`reading-information`)."""
    true_positive, false_positive = camera
    # P(k positive readings | X = x) (:eq:`reading-counts`).
    there, without = np.zeros(readings + 1), np.zeros(readings + 1)
    there[0] = without[0] = 1.0
    for n in range(1, readings + 1):
        for k in range(n, 0, -1):
            there[k] = (1.0 - true_positive) * there[k] + true_positive * there[k - 1]
            without[k] = (1.0 - false_positive) * without[k] + false_positive * without[k - 1]
        there[0] *= 1.0 - true_positive
        without[0] *= 1.0 - false_positive
    entropy = 0.0
    for k in range(readings + 1):
        none, one = (1.0 - target) * without[k], target * there[k]
        entropy += surprisal(none + one)
        entropy -= (1.0 - target) * surprisal(without[k]) + target * surprisal(there[k])
    return entropy


@compiled
def evaluate_paths(
    cells: Places,
    start: Places,
    joint: Floats,
    hazard: Floats,
    interest: Floats,
    survival: tuple[float, float],
    log_survival: tuple[float, float],
    camera: tuple[float, float],
    information: Floats,
) -> Floats:
    """
    Compute the information of paths, given no other robots; return their survival.

    Equation :eq:`information`. Paths stand one after another in `cells`: path k begins at
    `start[k]`.
    """
    survived, visits = np.empty(information.size), np.zeros(hazard.size, np.int64)
    # Information of n readings of a cell, (cells, n), kept for other paths.
    kept = np.full((hazard.size if information.size > 1 else 0, MAX_KEPT), nan)
    entropies: Floats = np.empty(0)
    for k in range(information.size):
        first, end = start[k] + 1, start[k + 1]
        path, p, brought = cells[first:end], 1.0, 0.0
        if entropies.size != path.size + 1:
            entropies = open_entropies(path.size, log_survival[0], log_survival[1])
        for cell in path:
            visits[cell] += 1
        for cell in path:
            n, safe, deadly = visits[cell], 1.0, 1.0
            if n == 0:
                continue
            visits[cell] = 0
            for _ in range(n):
                safe *= survival[0]
                deadly *= survival[1]
            p *= (1.0 - hazard[cell]) * safe + hazard[cell] * deadly
            is_kept = kept.shape[0] > 0 and n < MAX_KEPT
            read = kept[cell, n] if is_kept else nan
            if isnan(read):
                without = joint[cell, 0, 0] * safe + joint[cell, 1, 0] * deadly
                target, read = joint[cell, 0, 1] * safe + joint[cell, 1, 1] * deadly, 0.0
                if without + target > 0.0:
                    target /= without + target
                    read = readings_information(target, n, camera)
                if is_kept:
                    kept[cell, n] = read
            brought += interest[cell] * read
        entropy = surprisal(p) + surprisal(1.0 - p)
        information[k] = entropy + p * brought - left_open(path, hazard, entropies)
        survived[k] = p
    return survived


@compiled
def first_invalid(cells: Places, start: Places, count: int, neighbors: Places) -> int:
    """
    Return the first path that is not closed or leaves the `count` cells, or -1.

    If `neighbors` has rows, steps are examined as well. Paths are as in `evaluate_paths`.
    """
    for k in range(start.size - 1):
        first, last = start[k], start[k + 1] - 1
        for place in range(first, last + 1):
            if cells[place] < 0 or cells[place] >= count:
                return k
        if cells[first] != cells[last]:
            return k
        for place in range(first, last if neighbors.shape[0] else first):
            is_near = False
            for neighbor in neighbors[cells[place]]:
                if neighbor == cells[place + 1]:
                    is_near = True
            if not is_near:
                return k
    return -1


@compiled
def take(path: Places, gains: Gains, visits: Places, to: Labels) -> None:
    """Write the label of a path of ranks from the base into row 0."""
    visits[:] = 0
    to.factor[0], to.term[0] = 1.0, 0.0
    for cell in path[1:]:
        visit(to, 0, gains, cell, visits[cell], to, 0)
        visits[cell] += 1


@compiled
def exact_values(
    problem: LabelProblem,
    paths: Places,
    steps: Places,
    hazard: Floats,
    log_safe: float,
    log_deadly: float,
) -> Floats:
    """Return the exact values of closed paths, nats (:eq:`objective-value`)."""
    chance, powers = problem.chance, problem.weight.size
    values = np.empty(steps.size)
    label, visits = new_labels(1, 1, problem.gains), np.empty(hazard.size, np.int64)
    entropies: Floats = np.empty(0)
    for k in range(steps.size):
        path = paths[k, : steps[k] + 1]
        take(path, problem.gains, visits, label)
        value = -problem.loss_cost
        for outcome in range(chance.size):
            survival = label.factor[0, powers + outcome]
            readings = label.term[0, 1 + outcome] + problem.loss_cost
            value += chance[outcome] * (survival * readings + surprisal(1.0 - survival))
        if entropies.size != path.size:
            entropies = open_entropies(path.size - 1, log_safe, log_deadly)
        values[k] = value - left_open(path[1:], hazard, entropies)
    return values
