# SPDX-License-Identifier: Apache-2.0
"""Loops over the readings of cells, and over the exposures of a path."""

from __future__ import annotations

from math import exp, expm1, log
from typing import Any

from kbnitp_ros.core.field import compiled
import numpy as np


@compiled
def new_readings(
    joint: Any,
    earlier: Any,
    visits: Any,
    survival: Any,
    after: Any,
    outcomes: Any,
    likelihood: Any,
    noise: Any,
    information: Any,
) -> None:
    """
    Find what a robot that survives n visits reads of cells on top of earlier robots' readings.

    The sum over states e of P(e) * (I(X; Y in e and n more) - I(X; Y in e)), given the n visits
    survived. A state is how many readings each camera has brought; readings enter through their
    counts of positives, which are sufficient.

    Parameters
    ----------
    joint : ndarray, shape (cells, 2, 2)
        P(Z = z, X = x), indexed [cell, z, x].
    earlier : ndarray, shape (cells, earlier states)
        P(earlier readings).
    visits : ndarray of int, shape (cells,)
        n of each cell.
    survival : ndarray, shape (most visits + 1, 2)
        P(n visits survived | Z = z), indexed [n, z].
    after : ndarray of int, shape (earlier states, most visits + 1)
        The state after n readings more.
    outcomes : ndarray of int, shape (states,)
        How many each has.
    likelihood : ndarray, shape (states, most outcomes, 2)
        P(outcome | X = x), indexed [state, outcome, x].
    noise : ndarray, shape (states, 2)
        Entropy of the outcome, indexed [state, x].
    information : ndarray, shape (cells,)
        The result, nats; 0 where n visits cannot be survived.

    """
    for cell in range(joint.shape[0]):
        n = visits[cell]
        without = joint[cell, 0, 0] * survival[n, 0] + joint[cell, 1, 0] * survival[n, 1]
        target = joint[cell, 0, 1] * survival[n, 0] + joint[cell, 1, 1] * survival[n, 1]
        information[cell] = 0.0
        if without + target == 0.0:
            continue
        target /= without + target
        for state in range(earlier.shape[1]):
            if earlier[cell, state] > 0.0:
                more = reading_information(target, after[state, n], outcomes, likelihood, noise)
                more -= reading_information(target, after[state, 0], outcomes, likelihood, noise)
                information[cell] += earlier[cell, state] * more


@compiled
def reading_information(
    target: float, state: int, outcomes: Any, likelihood: Any, noise: Any
) -> Any:
    """Return I(X; Y) of a state for P(X = 1) = `target`, nats; arguments as of `new_readings`."""
    entropy = 0.0
    for outcome in range(outcomes[state]):
        p = (1.0 - target) * likelihood[state, outcome, 0]
        p += target * likelihood[state, outcome, 1]
        if p > 0.0:
            entropy -= p * log(p)
    entropy -= (1.0 - target) * noise[state, 0] + target * noise[state, 1]
    return entropy


@compiled
def exposed(steps: Any, hazard: Any, log_safe: float, log_deadly: float) -> Any:
    """
    Find how often a robot may be exposed to hazards on a path, and what becomes of it then.

    The hazards decide the number of exposures c, and with it P(survive | z) = s0^(steps - c) s1^c.

    Parameters
    ----------
    steps : ndarray of int, shape (steps,)
        The cell that each step leads to.
    hazard : ndarray, shape (cells,)
        P(Z = 1).
    log_safe, log_deadly : float
        log s0 and log s1, in [-inf, 0].

    Returns
    -------
    chance, log_survival : ndarray, shape (steps + 1,)
        P(c), a Poisson-binomial distribution, and log P(survive | z) for each c.

    """
    visits = np.zeros(hazard.size, np.int64)
    for cell in steps:
        visits[cell] += 1
    # Of the cells so far.
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
    log_survival = np.zeros(steps.size + 1)
    for c in range(most + 1):
        if c < most:
            log_survival[c] += (most - c) * log_safe
        if c > 0:
            log_survival[c] += c * log_deadly
    return chance, log_survival


@compiled
def left_open(chance: Any, log_survival: Any) -> float:
    """Return E_z[h(P(survive | z))] of a path, nats; arguments as `exposed` returns them."""
    entropy = 0.0
    for c in range(chance.size):
        survival, loss = exp(log_survival[c]), -expm1(log_survival[c])
        if survival > 0.0 and loss > 0.0:
            entropy -= chance[c] * (survival * log_survival[c] + loss * log(loss))
    return entropy
