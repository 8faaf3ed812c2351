# SPDX-License-Identifier: Apache-2.0
"""Kernels over the readings of cells, the exposures of a path, and its exact value."""

from __future__ import annotations

from math import exp, expm1, isnan, log, nan
from typing import NamedTuple

from kbnitp_ros.core.field.compiled import compiled, inlined
from kbnitp_ros.core.planning.label_kernels import (
    Floats,
    Gains,
    LabelProblem,
    Labels,
    new_labels,
    Places,
    surprisal,
    visit,
)
import numpy as np


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
def new_readings(
    readings: Readings,
    joint: Floats,
    earlier: Floats,
    alpha: float,
    beta: float,
    information: Floats,
) -> None:
    """Compute readings' information (:eq:`reading-information`, :eq:`behavioral-information`)."""
    survival = readings.survival
    for cell in range(joint.shape[0]):
        for n in range(1, survival.shape[0]):
            without = joint[cell, 0, 0] * survival[n, 0] + joint[cell, 1, 0] * survival[n, 1]
            target = joint[cell, 0, 1] * survival[n, 0] + joint[cell, 1, 1] * survival[n, 1]
            if without + target == 0.0:
                continue
            target /= without + target
            for state in range(earlier.shape[1]):
                if earlier[cell, state] > 0.0:
                    then, now = readings.after[state, n], readings.after[state, 0]
                    more = reading_information(target, then, readings, alpha, beta)
                    more -= reading_information(target, now, readings, alpha, beta)
                    information[cell, n] += earlier[cell, state] * more


@inlined
def reading_information(
    target: float, state: int, readings: Readings, alpha: float, beta: float
) -> float:
    """Return the information of a state's readings about a target with P(X = 1) = `target`."""
    entropy = 0.0 if alpha == 1.0 else coin(target, 1.0 - target, alpha, beta)
    for outcome in range(readings.outcomes[state]):
        without = (1.0 - target) * readings.likelihood[state, outcome, 0]
        there = target * readings.likelihood[state, outcome, 1]
        p = without + there
        if p > 0.0 and alpha == 1.0:
            entropy -= p * log(p)
        elif p > 0.0:
            entropy -= p * coin(there / p, without / p, alpha, beta)
    if alpha == 1.0:
        entropy -= (1.0 - target) * readings.noise[state, 0] + target * readings.noise[state, 1]
    return entropy


@compiled
def open_entropies(
    steps: int, log_safe: float, log_deadly: float, alpha: float, beta: float
) -> Floats:
    """Return h(P(survive | c exposures)) by c (:eq:`exposures`, :eq:`behavioral-information`)."""
    entropy = np.zeros(steps + 1)
    for c in range(steps + 1):
        log_survival = 0.0
        if c < steps:
            log_survival += (steps - c) * log_safe
        if c > 0:
            log_survival += c * log_deadly
        survival, loss = exp(log_survival), -expm1(log_survival)
        if alpha != 1.0:
            entropy[c] = coin(survival, loss, alpha, beta)
        elif survival > 0.0 and loss > 0.0:
            entropy[c] = -(survival * log_survival + loss * log(loss))
    return entropy


@compiled
def left_open(steps: Places, hazard: Floats, entropies: Floats) -> float:
    """Return E_z[h(P(survive | z))], given `open_entropies` (:eq:`outcome-entropy`)."""
    visits = np.zeros(hazard.size, np.int64)
    for cell in steps:
        visits[cell] += 1
    # Probability of each number of exposures in the cells processed so far.
    chance = np.zeros(steps.size + 1)
    chance[0] = 1.0
    most = 0
    for cell in steps:
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
def examine(
    cells: Places, start: Places, count: int, neighbors: Places, is_closed: bool
) -> tuple[int, int]:
    """
    Return the first invalid path, or -1, and the maximum number of visits to a cell.

    Paths stand one after another in `cells`: path k begins at `start[k]`. Steps are examined if
    `neighbors` has a row for each of the `count` cells.
    """
    visits, most = np.zeros(count, np.int64), 0
    for k in range(start.size - 1):
        first, last = start[k], start[k + 1] - 1
        for place in range(first, last + 1):
            if cells[place] < 0 or cells[place] >= count:
                return k, most
        if is_closed and cells[first] != cells[last]:
            return k, most
        for place in range(first + 1, last + 1):
            is_near = neighbors.shape[0] == 0
            for column in range(neighbors.shape[1]):
                if not is_near and neighbors[cells[place - 1], column] == cells[place]:
                    is_near = True
            if not is_near:
                return k, most
            visits[cells[place]] += 1
            most = max(most, visits[cells[place]])
        for place in range(first + 1, last + 1):
            visits[cells[place]] = 0
    return -1, most


@compiled
def evaluate_paths(
    cells: Places,
    start: Places,
    joint: Floats,
    hazard: Floats,
    interest: Floats,
    readings: Readings,
    log_safe: float,
    log_deadly: float,
    alpha: float,
    beta: float,
    read: Floats,
    information: Floats,
    survival: Floats,
) -> None:
    """
    Compute the information and the survival of paths, given no other robots.

    Equations :eq:`information` and :eq:`behavioral-information`. `read` keeps the information of n
    readings of a cell, (cells, n), for paths with equal visits; it begins with NaN, and may have
    no row.
    """
    visits = np.zeros(hazard.size, np.int64)
    entropies: Floats = np.empty(0)
    for k in range(start.size - 1):
        path = cells[start[k] + 1 : start[k + 1]]
        for cell in path:
            visits[cell] += 1
        p, brought = 1.0, 0.0
        for cell in path:
            n = visits[cell]
            if n == 0:
                continue
            visits[cell] = 0
            z = hazard[cell]
            safe, deadly = readings.survival[n, 0], readings.survival[n, 1]
            p *= (1.0 - z) * safe + z * deadly
            known = read[cell, n] if read.shape[0] else nan
            if isnan(known):
                known = 0.0
                without = joint[cell, 0, 0] * safe + joint[cell, 1, 0] * deadly
                target = joint[cell, 0, 1] * safe + joint[cell, 1, 1] * deadly
                if without + target > 0.0:
                    target /= without + target
                    state = readings.after[0, n]
                    known = reading_information(target, state, readings, alpha, beta)
                if read.shape[0]:
                    read[cell, n] = known
            brought += interest[cell] * known
        if entropies.size != path.size + 1:
            entropies = open_entropies(path.size, log_safe, log_deadly, alpha, beta)
        entropy = surprisal(p) + surprisal(1.0 - p)
        if alpha != 1.0:
            entropy = coin(p, 1.0 - p, alpha, beta)
        information[k] = entropy + p * brought - left_open(path, hazard, entropies)
        survival[k] = p


@compiled
def coin(p: float, q: float, alpha: float, beta: float) -> float:
    """Return the behavioral entropy of p and q = 1 - p (:eq:`behavioral-entropy`)."""
    entropy = 0.0
    if p > 0.0 and p < 1.0:
        weighted = beta * (-log(p)) ** alpha
        entropy += weighted * exp(-weighted)
    if q > 0.0 and q < 1.0:
        weighted = beta * (-log(q)) ** alpha
        entropy += weighted * exp(-weighted)
    return entropy


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
            entropies = open_entropies(path.size - 1, log_safe, log_deadly, 1.0, 1.0)
        values[k] = value - left_open(path[1:], hazard, entropies)
    return values
