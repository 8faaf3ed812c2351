# SPDX-License-Identifier: Apache-2.0
"""
Hazards that change or are used up, written out in full: every state, step by step.

Nothing here uses the code under test: sensor models and dynamics are read for their numbers only.
"""

from itertools import product

import numpy as np


def enumerate_hazards(cells):
    """Return all states of the hazards of some cells, (2^cells, cells)."""
    return np.array(list(product((0, 1), repeat=cells)))


def changed(weight, states, possible, appear, vanish):
    """Apply one change of each possible cell to the weights, (..., states), of all states."""
    for cell in np.flatnonzero(possible):
        bit = 1 << (states.shape[1] - 1 - cell)
        there = states[:, cell] == 1
        other = weight[..., np.arange(len(states)) ^ bit]
        stays = np.where(there, 1 - vanish, 1 - appear)
        comes = np.where(there, appear, vanish)
        weight = weight * stays + other * comes
    return weight


def deployed(weight, states, model, used_up, path, is_lost, lost_at, by_hazard=None):
    """Deploy a robot on a path; return the weights of the states after its outcome."""
    failed, set_off = model.malfunction, model.lethality
    dead = np.zeros_like(weight)
    for step, cell in enumerate(path[1:]):
        there = states[:, cell] == 1
        gone = np.arange(len(states)) & ~(1 << (states.shape[1] - 1 - cell))
        fails = weight * failed
        struck = weight * np.where(there, (1 - failed) * set_off, 0.0)
        spared = weight * (1 - failed) * np.where(there, 1 - set_off, 1.0)
        lost, alive = struck * (1 - model.false_negative), struck * model.false_negative
        if used_up:
            lost, alive = (moved_to(each, gone, there) for each in (lost, alive))
        dead += lost_at[step] * ((by_hazard is not True) * fails + (by_hazard is not False) * lost)
        weight = spared + alive
    return dead if is_lost else weight


def moved_to(weight, target, where):
    """Move weights of states to other states."""
    moved = np.zeros_like(weight)
    # Each of these states has another target.
    moved[..., target[where]] = weight[..., where]
    return moved


def chance(joint, dynamics, model, path, readings, lost_at):
    """Return the probability of one outcome in a field that has not changed yet."""
    weight = weights(joint, dynamics, [(model, path, readings, lost_at)])
    return weight[0].sum()


def posterior(joint, dynamics, *deployments, possible=None):
    """Fold deployments (sensor model, path, readings, `lost_at`, cause: None if not given)."""
    weight = weights(joint, dynamics, deployments, possible)
    if not weight.any():
        return None
    cells = len(joint)
    states = enumerate_hazards(cells)
    after = np.empty_like(joint)
    for cell, z in product(range(cells), (0, 1)):
        after[cell, z] = weight[cell][:, states[:, cell] == z].sum(axis=1)
    return after / after.sum(axis=(1, 2), keepdims=True)


def weights(joint, dynamics, deployments, possible=None):
    """Return the weights of all states for each cell and its target, (cells, 2, states)."""
    cells = len(joint)
    states = enumerate_hazards(cells)
    read = np.ones((cells, 2))
    for model, path, readings, *_ in deployments:
        for cell, reading in zip(path[1:], [] if readings is None else readings):
            for x, positive in enumerate((model.false_positive, model.true_positive)):
                read[cell, x] *= 1.0 if reading == -1 else positive if reading else 1 - positive
    seen = joint * read[:, None, :]
    each = seen.sum(axis=2)[np.arange(cells), states]
    weight = np.empty((cells, 2, len(states)))
    for cell, x in product(range(cells), (0, 1)):
        rest = np.delete(each, cell, axis=1).prod(axis=1)
        weight[cell, x] = rest * seen[cell, states[:, cell], x]
    possible = joint[:, 1].sum(axis=1) > 0 if possible is None else possible
    for number, (model, path, readings, lost_at, *cause) in enumerate(deployments):
        if number and dynamics.kind == 'changing':
            weight = changed(weight, states, possible, dynamics.appear, dynamics.vanish)
        lost_at = np.ones(len(path) - 1) if lost_at is None else lost_at
        used_up = dynamics.kind == 'used_up'
        is_lost = readings is None
        weight = deployed(weight, states, model, used_up, path, is_lost, lost_at, *cause)
        if number < len(deployments) - 1 and weight.any():
            weight = weight / weight.sum()
    return weight
