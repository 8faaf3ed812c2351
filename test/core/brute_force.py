# SPDX-License-Identifier: Apache-2.0
"""
The model written out in full, for comparison: every state, every outcome, no shortcut.

Nothing here uses the code under test. A sensor model is read for its five numbers only, and a
belief is a plain array of joints, (cells, 2, 2) over [z, x]. Equation numbers are those of
Srivastava, Kontoudis, Sofge, Otte: Path-Based Sensors, arXiv:2305.06929.
"""

from functools import cache
from itertools import product
from math import comb, log, prod

import numpy as np


def step_survival(model):
    """Probability to survive one step into a cell, for no hazard and for a hazard."""
    intact = 1 - model.malfunction
    return intact, intact * (1 - model.lethality * (1 - model.false_negative))


def detection(model):
    """Probability of a positive reading, for no target and for a target."""
    return model.false_positive, model.true_positive


def random_joint(rng, cells, base):
    """Draw a belief, from nearly certain to even, with no hazard at the base."""
    joint = rng.dirichlet(np.full(4, rng.choice([0.2, 1.0, 5.0])), cells).reshape(-1, 2, 2)
    joint[base] = [[0.3, 0.7], [0.0, 0.0]]
    return joint


def random_sensors(rng):
    """Draw a sensor model's arguments: lethality 0.01 to 1, some parts perfect."""
    low, high = 10 ** rng.uniform(-2, 0), rng.uniform(0.01, 1)
    return {
        'lethality': float(rng.choice([0.01, 1.0, low, high])),
        'malfunction': float(rng.choice([0.0, 0.05, rng.uniform(0, 0.3)])),
        'false_negative': float(rng.choice([0.0, 0.05, rng.uniform(0, 0.3)])),
        'true_positive': float(rng.choice([0.95, rng.uniform(0.5, 1)])),
        'false_positive': float(rng.choice([0.05, rng.uniform(0, 0.5)])),
    }


def pairs(grid, states):
    """Count the pairs of adjacent hazards (sharing a side) in each state, (states, cells)."""
    maps = states.reshape(-1, grid.height, grid.width)
    down = (maps[:, 1:] * maps[:, :-1]).sum(axis=(1, 2))
    return down + (maps[..., 1:] * maps[..., :-1]).sum(axis=(1, 2))


@cache
def enumerate_hazards(grid):
    """
    Return all states of the hazards, grouped by their numbers of hazards and of pairs.

    Returns the states, the group of each state, and of each group its hazards, pairs and size.
    """
    states = np.array(list(product((0, 1), repeat=grid.cells)))
    states = states[(states[:, [grid.base, *grid.blocked]] == 0).all(axis=1)]
    counts = np.stack([states.sum(axis=1), pairs(grid, states)])
    (count, paired), alike, number = np.unique(
        counts, axis=1, return_inverse=True, return_counts=True
    )
    return states, alike.ravel(), count, paired, number


def clustered_prior(grid, coupling, density):
    """Return all states of the hazards, (states, cells), and their prior probabilities."""
    states, alike, count, paired, number = enumerate_hazards(grid)
    low, high = -40.0, 40.0
    for _ in range(100):
        field = (low + high) / 2
        weight = np.exp(field * count + coupling * paired - max(0.0, field) * grid.cells)
        weight /= weight @ number
        below = (weight * number) @ count < density * grid.may_be_hazardous.sum()
        low, high = (field, high) if below else (low, field)
    return states, weight[alike]


def adjacent(width, height, blocked=()):
    """List, for each cell, the cells one step away: the 8 around it and itself."""

    def step(a, b):
        return abs(a % width - b % width) <= 1 and abs(a // width - b // width) <= 1

    free = [cell for cell in range(width * height) if cell not in blocked]
    return {a: [b for b in free if step(a, b)] for a in free}


def random_path(rng, width, height, base, steps):
    """Walk at random, with stays and repeats, so that the last step is into the base."""
    around = adjacent(width, height)

    def steps_home(cell):
        return max(abs(cell % width - base % width), abs(cell // width - base // width))

    path = [base]
    for left in reversed(range(steps)):
        path.append(int(rng.choice([c for c in around[path[-1]] if steps_home(c) <= left])))
    return path


def random_case(rng, most_cells, most_steps):
    """Draw a small belief, sensors and a path over at most `cells` different cells."""
    width, height = rng.integers(1, 4, 2)
    base = int(rng.integers(width * height))
    while True:
        path = random_path(rng, width, height, base, int(rng.integers(1, most_steps + 1)))
        if len(set(path)) <= most_cells:
            return random_joint(rng, width * height, base), random_sensors(rng), path


def enumerate_states(joint, cells):
    """
    List all states of n cells.

    Returns the cells, the states (4^n, n, 2) of bits z, x and their prior probability (4^n,).
    """
    cells = sorted(set(cells))
    states = np.array(list(product(product((0, 1), repeat=2), repeat=len(cells))))
    prior = prod(joint[cell, states[:, i, 0], states[:, i, 1]] for i, cell in enumerate(cells))
    return cells, states, prior


def fates(model, cells, states, path, steps_survived=0, lost_at=None):
    """
    Return the probability to be lost after each number of steps, and to return, in each state.

    `lost_at` weighs the steps. A robot is lost on exactly one step, so no small number is
    subtracted from 1.
    """
    s0, s1 = step_survival(model)
    steps = [cells.index(cell) for cell in path[1:]]
    survive = np.where(states[:, steps, 0], s1, s0)
    die = np.where(states[:, steps, 0], 1 - s1, 1 - s0)
    alive = np.cumprod(survive, axis=1)
    reached = np.column_stack([np.ones(len(states)), alive[:, :-1]])
    weight = np.ones(len(steps)) if lost_at is None else np.asarray(lost_at)
    return (weight * reached * die)[:, steps_survived:].sum(axis=1), alive[:, -1]


def readings_likelihood(model, cells, states, path, readings):
    """Return the probability of the readings in each state, one a step, -1 without a look."""
    off, on = detection(model)
    steps = [cells.index(cell) for cell in path[1:]]
    positive = np.where(states[:, steps, 1], on, off)
    read = np.where(readings, positive, 1 - positive)
    return np.where(np.equal(readings, -1), 1.0, read).prod(axis=1)


def evidence_likelihood(model, cells, states, path, readings, steps_survived=0, lost_at=None):
    """Return the probability in each state to return with these readings; None: to be lost."""
    lost, returned = fates(model, cells, states, path, steps_survived, lost_at)
    if readings is None:
        return lost
    return returned * readings_likelihood(model, cells, states, path, readings)


def evidence_probability(joint, model, path, *outcome):
    """Return the predicted probability of an outcome: readings, steps survived, `lost_at`."""
    cells, states, prior = enumerate_states(joint, path[1:])
    return (prior * evidence_likelihood(model, cells, states, path, *outcome)).sum()


def weighed(joint, seen):
    """Return the probability of deployments with their models, and the posterior joints."""
    visited = {cell for _, path, *_ in seen for cell in path[1:]}
    cells, states, weight = enumerate_states(joint, visited)
    for model, *deployment in seen:
        weight = weight * evidence_likelihood(model, cells, states, *deployment)
    after = joint.copy()
    for i, cell in enumerate(cells):
        for z, x in product((0, 1), repeat=2):
            after[cell, z, x] = weight[(states[:, i] == (z, x)).all(axis=1)].sum() / weight.sum()
    return weight.sum(), after


def posterior(joint, model, *deployments):
    """Return the posterior joints after deployments: path, readings, steps survived, `lost_at`."""
    return weighed(joint, [(model, *deployment) for deployment in deployments])[1]


# The published update, equation by equation


def destruction(model):
    """P(Delta = delta | Z = z), indexed [delta][z]."""
    s0, s1 = step_survival(model)
    return [[s0, s1], [1 - s0, 1 - s1]]


def loss_weight(delta, marginals):
    """
    P(Theta = 1 | Delta = delta), eq. 5: lost on the one step j, after surviving those before.

    No step destroying the robot (j undefined) cannot trigger the sensor.
    """
    if sum(delta) != 1:
        return 0.0
    j = delta.index(1)
    return prod(marginals[k][delta[k]] for k in range(j + 1))


def published_loss(joint, model, path, lost_at=None):
    """
    Hazard, target and kappa of each cell of the path after a loss, eq. 9, 10 and 11.

    Sums over every delta in {0, 1}^steps; a repeated cell over each of its instances. `lost_at`,
    if given, multiplies the weight of a loss in a step.
    """
    fit = [1.0] * (len(path) - 1) if lost_at is None else lost_at
    p_delta = destruction(model)
    cells = path[1:]
    p_z = {c: [joint[c, z].sum() for z in (0, 1)] for c in cells}
    p_x = {
        c: [[joint[c, z, x] / p_z[c][z] if p_z[c][z] else 0.0 for x in (0, 1)] for z in (0, 1)]
        for c in cells
    }
    marginals = [[sum(p_delta[d][z] * p_z[c][z] for z in (0, 1)) for d in (0, 1)] for c in cells]
    every_delta = product((0, 1), repeat=len(cells))
    omega = [
        (delta, loss_weight(delta, marginals) * (fit[delta.index(1)] if any(delta) else 0.0))
        for delta in every_delta
    ]

    def term(cell, z, x):
        return sum(
            weight * p_delta[delta[step]][z] * p_x[cell][z][x] * p_z[cell][z]
            for step, visited in enumerate(cells)
            if visited == cell
            for delta, weight in omega
        )

    after = {}
    for cell in set(cells):
        z_terms = [sum(term(cell, z, x) for x in (0, 1)) for z in (0, 1)]  # eq. 9
        x_terms = [sum(term(cell, z, x) for z in (0, 1)) for x in (0, 1)]  # eq. 10
        kappa_terms = [term(cell, 1, x) for x in (0, 1)]  # eq. 11
        hazard = z_terms[1] / sum(z_terms)
        target = x_terms[1] / sum(x_terms)
        kappa = kappa_terms[1] / sum(kappa_terms) if sum(kappa_terms) else target
        after[cell] = hazard, target, kappa
    return after


def published_return(joint, model, path, readings):
    """Hazard, target and kappa of each cell after a return, eq. 6, 7 and 8 for each visit."""
    p_delta = destruction(model)
    off, on = detection(model)
    after = {}
    for cell in set(path[1:]):
        hazard = joint[cell, 1].sum()
        kappa = joint[cell, 1, 1] / hazard if hazard else 0.0
        q = joint[cell, 0, 1] / (1 - hazard)
        for visited, reading in zip(path[1:], readings):
            if visited != cell:
                continue
            p_y = [p if reading else 1 - p for p in (off, on)]
            p_z = [1 - hazard, hazard]
            p_x = [[1 - q, q], [1 - kappa, kappa]]
            table = [[p_x[z][x] * p_delta[0][z] * p_y[x] * p_z[z] for x in (0, 1)] for z in (0, 1)]
            total = sum(map(sum, table))
            hazard = sum(table[1]) / total  # eq. 6
            target = (table[0][1] + table[1][1]) / total  # eq. 7
            kappa = table[1][1] / sum(table[1]) if sum(table[1]) else target  # eq. 8
            q = table[0][1] / sum(table[0])
        after[cell] = hazard, target, kappa
    return after


# All closed paths of a small grid


def all_visit_counts(width, height, base, most_steps, blocked=()):
    """
    Count visits per cell of all closed paths of 1 to most_steps steps, without duplicates.

    The information of a path depends only on its visits per cell.
    """
    around = adjacent(width, height, blocked)
    ends = {(base, (0,) * (width * height))}
    closed = set()
    for _ in range(most_steps):
        ends = {
            (cell, tuple(n + (other == cell) for other, n in enumerate(visits)))
            for end, visits in ends
            for cell in around[end]
        }
        closed |= {visits for end, visits in ends if end == base}
    return np.array(sorted(closed))


def binary_entropy(p):
    """Entropy of a coin, nats, for an array of probabilities."""
    sides = np.clip([p, 1 - p], 0.0, 1.0)
    return -(sides * np.log(np.where(sides > 0, sides, 1.0))).sum(axis=0)


def repeated_reading_information(joint_cell, model, visits):
    """I(X; Y^visits | survived the visits) of one cell, by the number of positive readings."""
    s = step_survival(model)
    p_x = np.array([sum(joint_cell[z, x] * s[z] ** visits for z in (0, 1)) for x in (0, 1)])
    p_x /= p_x.sum()
    off, on = detection(model)
    likelihood = np.array(
        [
            [comb(visits, k) * p**k * (1 - p) ** (visits - k) for k in range(visits + 1)]
            for p in (off, on)
        ]
    )
    p_k = p_x @ likelihood
    return float(
        sum(
            p_x[x] * likelihood[x, k] * log(likelihood[x, k] / p_k[k])
            for x in (0, 1)
            for k in range(visits + 1)
            if p_x[x] * likelihood[x, k] > 0
        )
    )


def survival_of_visits(joint, model, visits):
    """Predicted probability to return, for each row of visits per cell."""
    s0, s1 = step_survival(model)
    hazard = joint[:, 1].sum(axis=1)
    return ((1 - hazard) * s0**visits + hazard * s1**visits).prod(axis=1)


def left_open_of_visits(joint, model, visits):
    """Return E_z[h(P(survive | z))], the fate's entropy given hazards, for each row of visits."""
    s0, s1 = step_survival(model)
    hazard = joint[:, 1].sum(axis=1)
    steps = visits.sum(axis=1)
    exposure = np.zeros((len(visits), steps.max() + 1))
    exposure[:, 0] = 1.0
    rows = np.arange(len(visits))[:, None]
    shift = np.arange(exposure.shape[1])[None, :] - visits.T[:, :, None]
    for cell, p in enumerate(hazard):
        moved = np.where(shift[cell] >= 0, exposure[rows, np.maximum(shift[cell], 0)], 0.0)
        exposure = (1 - p) * exposure + p * moved
    exposed = np.minimum(np.arange(exposure.shape[1]), steps[:, None])
    survive = s0 ** (steps[:, None] - exposed) * s1**exposed
    return (exposure * binary_entropy(survive)).sum(axis=1)


def information_of_visits(joint, model, visits):
    """
    Return the expected information of many paths, (paths,) nats, from their visits per cell.

    Fast enough for all paths; itself tested against `information`.
    """
    returns = survival_of_visits(joint, model, visits)
    fate = binary_entropy(returns) - left_open_of_visits(joint, model, visits)
    readings = np.array(
        [
            [repeated_reading_information(cell, model, n) for n in range(visits.max() + 1)]
            for cell in joint
        ]
    )
    return fate + returns * readings[np.arange(len(joint)), visits].sum(axis=1)


def joint_information(joint, models, paths):
    """Sum I(Z, X; all outcomes), nats, over all states and outcomes, each robot with its model."""
    cells, states, prior = enumerate_states(joint, [c for path in paths for c in path[1:]])
    likelihood = np.ones((len(states), 1))
    for model, path in zip(models, paths, strict=True):
        lost, returned = fates(model, cells, states, path)
        outcomes = np.column_stack(
            [lost]
            + [
                returned * readings_likelihood(model, cells, states, path, np.array(readings))
                for readings in product((False, True), repeat=len(path) - 1)
            ]
        )
        likelihood = (likelihood[:, :, None] * outcomes[:, None, :]).reshape(len(states), -1)
    together = prior[:, None] * likelihood
    apart = prior[:, None] * together.sum(axis=0)
    seen = together > 0
    return float((together[seen] * np.log(together[seen] / apart[seen])).sum())


def surprisal(p):
    """Return -p log p, nats, for an array; 0 at 0 and for negative rounding errors."""
    return -p * np.log(np.where(p > 0, p, 1.0))


def information_of_pairs(joint, model, visits):
    """
    Return I(Z, X; both outcomes) of all pairs of paths, (paths, paths) nats, exactly.

    `visits` has a row of visits per cell for each path. H(outcomes) - H(outcomes | Z, X): given
    who returns, a cell's readings count by their positives. When both robots return, the cells are
    independent. When one does, the probability of its readings is that with any fate of the other
    less that with both returned: two products over cells. Tested against `joint_information`.
    """
    cells, most = np.arange(len(joint)), 2 * visits.max()
    survive = np.array(step_survival(model)) ** np.arange(most + 1)[:, None]
    p_x = np.einsum('mz,czx->cmx', survive, joint)  # P(m visits to c survived, X_c = x)
    survived = p_x.sum(axis=2)
    noise = p_x @ binary_entropy(np.array(detection(model)))

    def of_one_order(n):
        """P(m visits to c survived, n readings in one order with k positive), [c, m, k]."""
        return sum(
            p_x[:, :, x, None] * np.array([p**k * (1 - p) ** (n - k) for k in range(n + 1)])
            for x, p in enumerate(detection(model))
        )

    orders = [of_one_order(n) for n in range(most + 1)]
    ways = [np.array([comb(n, k) for k in range(n + 1)]) for n in range(most + 1)]
    read = np.stack([surprisal(o) @ w for o, w in zip(orders, ways)], axis=2)  # [c, m, n]

    one = survived[cells, visits]
    both = visits[:, None] + visits
    each = survived[cells, both]
    returns = one.prod(axis=1)
    both_return = each.prod(axis=2)
    entropy = surprisal(1 - returns[:, None] - returns + both_return)
    for c in cells:
        entropy += np.delete(each, c, axis=2).prod(axis=2) * read[c, both[:, :, c], both[:, :, c]]
    for i, row in enumerate(visits):
        mine = np.flatnonzero(row)
        alone, together, orderings = np.ones(1), np.delete(each[i], mine, axis=1).prod(axis=1), 1
        together = together[:, None]
        for c in mine:
            order = orders[row[c]][c]
            alone = np.outer(alone, order[row[c]]).ravel()
            orderings = np.outer(orderings, ways[row[c]]).ravel()
            together = together[:, :, None] * order[row[c] + visits[:, c]][:, None, :]
            together = together.reshape(len(visits), -1)
        one_returns = surprisal(alone - together) @ orderings
        entropy[i] += one_returns
        entropy[:, i] += one_returns
    left_open = left_open_of_visits(joint, model, visits)
    for c in cells:
        rest = np.delete(one, c, axis=1).prod(axis=1)
        left_open += rest * visits[:, c] * noise[c, visits[:, c]]
    return entropy - left_open[:, None] - left_open
