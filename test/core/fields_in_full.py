# SPDX-License-Identifier: Apache-2.0
"""
Fields whose hazards reach, are duds or whose targets change, by all states of all cells.

Nothing here uses the code under test: sensor models, dynamics and findings are read for their
numbers only.
A state of a cell is a pair of its hazard (0 none, 1 live, 2 dud) and its target.
"""

from itertools import product

import numpy as np


def enumerate_states(cells, kinds):
    """Return all states, shape (states, cells, 2) of z and x."""
    each = np.array(list(product(range(kinds), range(2))))
    places = np.indices([len(each)] * cells).reshape(cells, -1).T
    return each[places]


def changed(weight, cells, kinds, part, matrix, possible):
    """Apply a Markov matrix [from, to] to the hazard (0) or target (1) of each possible cell."""
    weight = weight.reshape([kinds, 2] * cells)
    for cell in np.flatnonzero(possible):
        axis = 2 * cell + part
        weight = np.moveaxis(np.tensordot(weight, matrix, ([axis], [0])), -1, axis)
    return weight.ravel()


def rates(dynamics):
    """Return the Markov matrix of appearing and vanishing."""
    return np.array(
        [[1 - dynamics.appear, dynamics.appear], [dynamics.vanish, 1 - dynamics.vanish]]
    )


def step_survival(model, states, cell, around):
    """Return the chance to survive a step into a cell in each state."""
    strike, live = model.lethality * (1 - model.false_negative), states[:, :, 0] == 1
    survives = (1 - model.malfunction) * (1 - live[:, cell] * strike)
    for other in around[cell]:
        survives = survives * (1 - live[:, other] * getattr(model, 'reach', 0.0) * strike)
    return survives


def found(weight, states, finding):
    """Return the weights of all states given a finding, or after the change that it tells of."""
    for cell in finding.cells.tolist():
        for part, told in enumerate((finding.hazard, finding.target)):
            if told is None:
                continue
            there = states[:, cell, part]
            if not finding.changed:
                weight = weight * np.where((there > 0) == told, 1.0, 1.0 - finding.confidence)
                continue
            # With the confidence the state is the one that is told, whatever it was.
            kinds = states[:, :, part].max() + 1
            matrix = (1.0 - finding.confidence) * np.eye(kinds)
            matrix[:, int(told)] += finding.confidence
            where = np.arange(states.shape[1]) == cell
            weight = changed(weight, where.size, states[:, :, 0].max() + 1, part, matrix, where)
        weight = weight * np.where(states[:, cell, 0] == 1, 1.0 - finding.walked, 1.0)
    return weight


def likelihood(model, states, outcome, around):
    """Return the probability of an outcome in each state."""
    cells = outcome.path[1:].tolist()
    survives = [step_survival(model, states, cell, around) for cell in cells]
    if outcome.survived:
        chance = np.prod(survives, axis=0)
        for cell, reading in zip(cells, outcome.readings.tolist()):
            positive = np.where(states[:, cell, 1] == 1, model.true_positive, model.false_positive)
            if reading != -1:
                chance = chance * (positive if reading else 1 - positive)
        return chance
    lost_at = outcome.lost_at
    if lost_at is None:
        lost_at = np.arange(len(cells)) >= outcome.steps_survived
    alive, chance = np.ones(len(states)), np.zeros(len(states))
    # A failure that the model rules out is no evidence of its numbers.
    failed = model.malfunction or 1.0
    for weight, survived in zip(lost_at, survives):
        died = {None: 1 - survived, True: 1 - model.malfunction - survived, False: failed}
        chance = chance + weight * alive * died[outcome.by_hazard]
        alive = alive * survived
    return chance


def posterior(joint, model, outcomes, targets=None, hazards=None, duds=0.0, around=None):
    """
    Return the joints of all cells, (cells, kinds, 2), and the probability of all evidence.

    Outcomes may have findings between them. After each outcome cells are taken as independent, as
    one-pass methods do; without losses they are.
    """
    kinds, around = 3 if duds else 2, around or [()] * len(joint)
    may_have = joint[:, 1].sum(axis=1) > 0, joint[:, :, 1].sum(axis=1) > 0
    states, chance = enumerate_states(len(joint), kinds), 1.0
    if duds:
        joint = np.stack([joint[:, 0], joint[:, 1] * (1 - duds), joint[:, 1] * duds], axis=1)
    number = 0
    for outcome in outcomes:
        weight, is_finding = independent_weights(joint, states), hasattr(outcome, 'walked')
        if is_finding:
            weight = found(weight, states, outcome)
        elif number and hazards is not None and hazards.kind == 'changing':
            weight = changed(weight, len(joint), kinds, 0, rates(hazards), may_have[0])
        if number and targets is not None and not is_finding:
            weight = changed(weight, len(joint), kinds, 1, rates(targets), may_have[1])
        if not is_finding:
            number, weight = number + 1, weight * likelihood(model, states, outcome, around)
        joint, total = np.empty_like(joint), weight.sum()
        if total == 0.0:
            return joint, 0.0
        for cell, z, x in product(range(len(joint)), range(kinds), range(2)):
            joint[cell, z, x] = weight[(states[:, cell] == [z, x]).all(axis=1)].sum() / total
        chance *= total
    return joint, chance


def independent_weights(joint, states):
    """Return the probability of each state of independent cells."""
    weight = np.ones(len(states))
    for cell, of_cell in enumerate(joint):
        weight = weight * of_cell[states[:, cell, 0], states[:, cell, 1]]
    return weight
