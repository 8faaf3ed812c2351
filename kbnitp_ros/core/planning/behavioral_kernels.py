# SPDX-License-Identifier: Apache-2.0
"""Loops over the readings of cells, and over the exposures of a path, for behavioral entropies."""

from __future__ import annotations

from math import exp, expm1, log
from typing import Any

from kbnitp_ros.core.field import compiled


@compiled
def coin(p: float, q: float, alpha: float, beta: float) -> float:
    """Return the behavioral entropy of a coin that falls with probability p, and q = 1 - p."""
    entropy = 0.0
    if p > 0.0 and p < 1.0:
        weighted = beta * (-log(p)) ** alpha
        entropy += weighted * exp(-weighted)
    if q > 0.0 and q < 1.0:
        weighted = beta * (-log(q)) ** alpha
        entropy += weighted * exp(-weighted)
    return entropy


@compiled
def fall(
    target: float,
    state: int,
    outcomes: Any,
    likelihood: Any,
    alpha: float,
    beta: float,
) -> float:
    """Return by how much the readings of a state are expected to lower the entropy."""
    fallen = coin(target, 1.0 - target, alpha, beta)
    for outcome in range(outcomes[state]):
        without = (1.0 - target) * likelihood[state, outcome, 0]
        there = target * likelihood[state, outcome, 1]
        p = without + there
        if p > 0.0:
            fallen -= p * coin(there / p, without / p, alpha, beta)
    return fallen


@compiled
def new_falls(
    joint: Any,
    earlier: Any,
    visits: Any,
    survival: Any,
    after: Any,
    outcomes: Any,
    likelihood: Any,
    alpha: float,
    beta: float,
    fallen: Any,
) -> None:
    """
    Find what the readings of a robot that survives n visits do on top of earlier readings.

    As `information_kernels.new_readings` does it, with the fall of the behavioral entropy of the
    target in place of the information.

    Parameters
    ----------
    joint, earlier, visits, survival, after, outcomes, likelihood
        As there.
    alpha, beta : float
        Of the Prelec weight.
    fallen : ndarray, shape (cells,)
        The result, nats; 0 where n visits cannot be survived.

    """
    for cell in range(joint.shape[0]):
        n = visits[cell]
        without = joint[cell, 0, 0] * survival[n, 0] + joint[cell, 1, 0] * survival[n, 1]
        target = joint[cell, 0, 1] * survival[n, 0] + joint[cell, 1, 1] * survival[n, 1]
        fallen[cell] = 0.0
        if without + target == 0.0:
            continue
        target /= without + target
        for state in range(earlier.shape[1]):
            if earlier[cell, state] > 0.0:
                more = fall(target, after[state, n], outcomes, likelihood, alpha, beta)
                more -= fall(target, after[state, 0], outcomes, likelihood, alpha, beta)
                fallen[cell] += earlier[cell, state] * more


@compiled
def fate_left_open(chance: Any, log_survival: Any, alpha: float, beta: float) -> float:
    """
    Return the behavioral entropy of a robot's fate that is expected once the hazards are known.

    Parameters
    ----------
    chance, log_survival
        As `information_kernels.exposed` returns them.
    alpha, beta : float
        Of the Prelec weight.

    """
    entropy = 0.0
    for c in range(chance.size):
        entropy += chance[c] * coin(exp(log_survival[c]), -expm1(log_survival[c]), alpha, beta)
    return entropy
