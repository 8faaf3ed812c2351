# SPDX-License-Identifier: Apache-2.0
"""The moves of a Gibbs sampler over hazards, for many chains side by side."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.field import compiled
import numpy as np
from numpy.typing import NDArray

# A loss is never less likely than this, so that a chain finds out of states that explain it not
# at all; far above what rounding leaves of 1 - 1.
LEAST = 1e-30
# The same of a loss whose steps weigh by how well they fit, of which nothing is subtracted.
LEAST_FIT = 1e-100
# Products are divided before they leave the range of floating point.
SMALL, LARGE = 1e-200, 1e300
# How many losses may be multiplied up before that.
OFTEN = 6


class LossGraph(NamedTuple):
    """
    Which cells are on which lost paths, both ways round.

    Attributes
    ----------
    first_loss : ndarray of int, shape (cells + 1,)
        The lost paths through cell i are ``loss[first_loss[i]:first_loss[i + 1]]``.
    loss, visits : ndarray of int, shape (entries,)
        A lost path, and how often it enters the cell.
    first_cell : ndarray of int, shape (losses + 1,)
        The cells of lost path a that may be hazardous or safe are
        ``cell[first_cell[a]:first_cell[a + 1]]``; located losses come last.
    cell : ndarray of int

    """

    first_loss: NDArray[np.int32]
    loss: NDArray[np.int32]
    visits: NDArray[np.int32]
    first_cell: NDArray[np.int32]
    cell: NDArray[np.int32]


class LocatedGraph(NamedTuple):
    """
    The losses of which it is known how well each step fits.

    Attributes
    ----------
    first_entry : ndarray of int, shape (cells + 1,)
        Those through cell i are ``loss[first_entry[i]:first_entry[i + 1]]``.
    loss, first, last : ndarray of int, shape (entries,)
        A loss, and its first and last steps into the cell.
    first_step : ndarray of int, shape (losses + 1,)
        The steps of loss a are those from ``first_step[a]`` to ``first_step[a + 1] - 1``.
    robot_type : ndarray of int, shape (losses,)
        Of the robot.
    cell : ndarray of int, shape (steps,)
        The cell that each step leads to.
    lost_at : ndarray, shape (steps,)
        How well a loss in each step fits what was observed.

    """

    first_entry: NDArray[np.int32]
    loss: NDArray[np.int32]
    first: NDArray[np.int32]
    last: NDArray[np.int32]
    first_step: NDArray[np.int32]
    robot_type: NDArray[np.int32]
    cell: NDArray[np.int32]
    lost_at: NDArray[np.float64]


class LocatedSums(NamedTuple):
    """
    Of one chain, the parts of each located loss before and after each step; kernels change it.

    Attributes
    ----------
    before : ndarray, shape (steps,)
        Chance of the loss in the steps before this one, each by how well it fits.
    reached : ndarray, shape (steps,)
        Chance to survive the steps before this one.
    rest : ndarray, shape (steps,)
        Chance of the loss from this step on, of a robot that reaches it.
    survival : ndarray, shape (types, 2)
        s_z of one step, by robot type.

    """

    before: NDArray[np.float64]
    reached: NDArray[np.float64]
    rest: NDArray[np.float64]
    survival: NDArray[np.float64]


class HazardState(NamedTuple):
    """
    The hazards of each chain, and what follows from them; kernels change it.

    Attributes
    ----------
    hazardous : ndarray of int, shape (chains, cells)
        Z of each cell.
    exposures : ndarray of int, shape (chains, losses)
        How many steps of each lost path led into a hazard.
    malfunction, strike : ndarray of int, shape (chains,)
        Rows of `Factors.endured` and `Factors.spared`.

    """

    hazardous: NDArray[np.int8]
    exposures: NDArray[np.int32]
    malfunction: NDArray[np.intp]
    strike: NDArray[np.intp]


class Ties(NamedTuple):
    """
    What ties the hazards of neighbouring cells in the prior (equation :eq:`clustered-prior`).

    Attributes
    ----------
    neighbors : ndarray of int, shape (cells, 4)
        The cells that share a side with each, -1 for none; no rows if hazards are independent.
    strength : ndarray, shape (chains,)
        e^J.

    """

    neighbors: NDArray[np.intp]
    strength: NDArray[np.float64]


class Factors(NamedTuple):
    """
    The factors of the conditionals that hazards are drawn from.

    Attributes
    ----------
    odds : ndarray, shape (1 or chains, cells)
        Of each hazard without the losses; from `SMALL` to `LARGE`.
    length : ndarray of int, shape (losses,)
        Which of the lengths that lost paths have is that of each; of robots of different types
        they count as different.
    robot_type : ndarray of int, shape (lengths,)
        Of the robots whose paths have each length.
    endured : ndarray, shape (values, lengths)
        Chance of no malfunction in a path of each length.
    spared : ndarray, shape (values, types, most exposures + 1)
        Chance of no strike in that many exposures of a robot of each type.
    step_endured, step_spared : ndarray, shape (values, types)
        Chances of no malfunction and of no strike in one step.

    """

    odds: NDArray[np.float64]
    length: NDArray[np.intp]
    robot_type: NDArray[np.intp]
    endured: NDArray[np.float64]
    spared: NDArray[np.float64]
    step_endured: NDArray[np.float64]
    step_spared: NDArray[np.float64]


@compiled
def lost(survived: float) -> float:
    """
    Return the chance to be lost, from that to survive.

    Equation :eq:`loss-probability`.
    """
    return max(1.0 - survived, LEAST)


@compiled
def tabulate_losses(
    state: HazardState, factors: Factors, chain: int, table: NDArray[np.float64]
) -> None:
    """Fill `table`, (lengths, exposures), with the chance to be lost by the rates of a chain."""
    endured, spared = (
        factors.endured[state.malfunction[chain]],
        factors.spared[state.strike[chain]],
    )
    for length in range(endured.size):
        of_type = spared[factors.robot_type[length]]
        for exposures in range(of_type.size):
            table[length, exposures] = lost(endured[length] * of_type[exposures])


@compiled
def add_exposures(exposures: NDArray[np.int32], graph: LossGraph, cell: int, hazards: int) -> None:
    """Add the exposures of lost paths to hazards that come into a cell, or go if negative."""
    for entry in range(graph.first_loss[cell], graph.first_loss[cell + 1]):
        exposures[graph.loss[entry]] += hazards * graph.visits[entry]


@compiled
def loss_ratio(
    exposures: NDArray[np.int32],
    factors: Factors,
    graph: LossGraph,
    table: NDArray[np.float64],
    cell: int,
    hazards: int,
    ratio: float,
) -> float:
    """Do what `add_exposures` does, and return `ratio` times that of the losses' chances."""
    for entry in range(graph.first_loss[cell], graph.first_loss[cell + 1]):
        path = graph.loss[entry]
        chance = table[factors.length[path]]
        before = chance[exposures[path]]
        exposures[path] += hazards * graph.visits[entry]
        ratio = min(ratio * (chance[exposures[path]] / before), LARGE)
    return ratio


@compiled
def new_sums(located: LocatedGraph, factors: Factors) -> LocatedSums:
    """Return the sums of one chain, not found yet."""
    steps = located.cell.size
    survival = np.empty((factors.step_endured.shape[1], 2))
    return LocatedSums(np.empty(steps), np.empty(steps), np.empty(steps), survival)


@compiled
def sum_steps(
    sums: LocatedSums, located: LocatedGraph, hazardous: NDArray[np.int8], path: int
) -> None:
    """
    Find the sums of a located loss by the hazards of a chain.

    Equation :eq:`loss-located`.
    """
    survival = sums.survival[located.robot_type[path]]
    first, end = located.first_step[path], located.first_step[path + 1]
    before, reached = 0.0, 1.0
    for step in range(first, end):
        survived = survival[hazardous[located.cell[step]]]
        sums.before[step], sums.reached[step] = before, reached
        before += reached * located.lost_at[step] * (1.0 - survived)
        reached *= survived
    rest = 0.0
    for step in range(end - 1, first - 1, -1):
        survived = survival[hazardous[located.cell[step]]]
        rest = located.lost_at[step] * (1.0 - survived) + survived * rest
        sums.rest[step] = rest


@compiled
def sum_all_steps(
    sums: LocatedSums,
    located: LocatedGraph,
    state: HazardState,
    factors: Factors,
    chain: int,
) -> None:
    """Find the sums of all located losses by the hazards and the rates of a chain."""
    for robot_type in range(sums.survival.shape[0]):
        endured = factors.step_endured[state.malfunction[chain], robot_type]
        sums.survival[robot_type, 0] = endured
        sums.survival[robot_type, 1] = (
            endured * factors.step_spared[state.strike[chain], robot_type]
        )
    for path in range(located.robot_type.size):
        sum_steps(sums, located, state.hazardous[chain], path)


@compiled
def located_chance(
    sums: LocatedSums,
    located: LocatedGraph,
    hazardous: NDArray[np.int8],
    entry: int,
    hazard: int,
) -> float:
    """Return the chance of a located loss if the cell of an entry had this hazard."""
    path, first, last = located.loss[entry], located.first[entry], located.last[entry]
    survival, cell = sums.survival[located.robot_type[path]], located.cell[first]
    rest = sums.rest[last + 1] if last + 1 < located.first_step[path + 1] else 0.0
    for step in range(last, first - 1, -1):
        visited = located.cell[step]
        survived = survival[hazard if visited == cell else hazardous[visited]]
        rest = located.lost_at[step] * (1.0 - survived) + survived * rest
    return float(max(sums.before[first] + sums.reached[first] * rest, LEAST_FIT))


@compiled
def sum_through(
    sums: LocatedSums, located: LocatedGraph, hazardous: NDArray[np.int8], cell: int
) -> None:
    """Find the sums of the located losses through a cell again."""
    for entry in range(located.first_entry[cell], located.first_entry[cell + 1]):
        sum_steps(sums, located, hazardous, located.loss[entry])


@compiled
def located_ratio(
    sums: LocatedSums,
    located: LocatedGraph,
    hazardous: NDArray[np.int8],
    cell: int,
    hazard: int,
    ratio: float,
) -> float:
    """Return `ratio` times that of the chances with this hazard in a cell and with the other."""
    for entry in range(located.first_entry[cell], located.first_entry[cell + 1]):
        now = located_chance(sums, located, hazardous, entry, hazard)
        other = located_chance(sums, located, hazardous, entry, 1 - hazard)
        ratio = min(ratio * (now / other), LARGE)
    return ratio


@compiled
def hazards_around(ties: Ties, hazardous: NDArray[np.int8], cell: int) -> int:
    """Return how many of a cell's neighbours are hazardous."""
    count = 0
    for side in range(ties.neighbors.shape[1]):
        neighbor = ties.neighbors[cell, side]
        if neighbor >= 0:
            count += hazardous[neighbor]
    return count


@compiled
def count_tied(ties: Ties, hazardous: NDArray[np.int8], pairs: NDArray[np.int64]) -> None:
    """Count the pairs of neighbouring hazards in each chain."""
    for chain in range(hazardous.shape[0]):
        count = 0
        for cell in range(hazardous.shape[1]):
            if hazardous[chain, cell]:
                count += hazards_around(ties, hazardous[chain], cell)
        pairs[chain] = count // 2


@compiled
def nth_cell(cells: NDArray[np.int32], hazardous: NDArray[np.int8], hazard: int, n: int) -> int:
    """Return the cell number n, from 0, of those that have this hazard."""
    for cell in cells:
        if hazardous[cell] == hazard:
            if n == 0:
                return int(cell)
            n -= 1
    return -1


@compiled
def draw_hazards(
    state: HazardState,
    factors: Factors,
    graph: LossGraph,
    located: LocatedGraph,
    ties: Ties,
    cells: NDArray[np.intp],
    uniform: NDArray[np.float64],
    drawn_with: NDArray[np.float64],
) -> None:
    r"""
    Draw each of `cells` in turn given all others, by equation :eq:`hazard-conditional`.

    The odds of a hazard in cell i are

    .. math:: e^{o_i} \prod_{a \ni i} \frac{F(T_a, E_a' + n_{ai})}{F(T_a, E_a')},

    where :math:`e^{o_i}` are the odds without the losses, :math:`F` is the chance of a loss, and
    :math:`E_a'` are the exposures of path a in its other cells. Of located losses the ratio is
    that of equation :eq:`loss-located`. Where hazards cluster, each hazardous neighbour multiplies
    the odds by :math:`e^J`.

    `uniform` has a number in [0, 1) for each of the chains' cells. `drawn_with`, of the same
    shape, takes the conditional odds of a hazard that each was drawn with.
    """
    table = np.empty((factors.endured.shape[1], factors.spared.shape[2]))
    sums = new_sums(located, factors)
    # Handing so many arrays to a function takes longer than what it does without such losses.
    any_located = located.cell.size > 0
    any_tied = ties.neighbors.shape[0] > 0
    # By the number of hazardous neighbours: a power takes longer than all else of most cells.
    tied = np.empty(5)
    for chain in range(state.hazardous.shape[0]):
        odds = factors.odds[chain % factors.odds.shape[0]]
        hazardous, exposures = state.hazardous[chain], state.exposures[chain]
        tabulate_losses(state, factors, chain, table)
        if any_located:
            sum_all_steps(sums, located, state, factors, chain)
        if any_tied:
            for around in range(tied.size):
                tied[around] = ties.strength[chain] ** around
        for cell in cells:
            start, end = graph.first_loss[cell], graph.first_loss[cell + 1]
            here = hazardous[cell]
            ratio = odds[cell]
            with_hazard, without = 1.0, 1.0
            for entry in range(start, end):
                path, visits = graph.loss[entry], graph.visits[entry]
                others = exposures[path] - here * visits
                length = factors.length[path]
                with_hazard *= table[length, others + visits]
                without *= table[length, others]
                if without < SMALL:
                    ratio = min(ratio * (with_hazard / without), LARGE)
                    with_hazard, without = 1.0, 1.0
            ratio = min(ratio * (with_hazard / without), LARGE)
            if any_located:
                ratio = located_ratio(sums, located, hazardous, cell, 1, ratio)
            if any_tied:
                ratio = min(ratio * tied[hazards_around(ties, hazardous, cell)], LARGE)
            drawn_with[chain, cell] = ratio
            drawn = 1 if uniform[chain, cell] < ratio / (1.0 + ratio) else 0
            if drawn != here:
                hazardous[cell] = drawn
                add_exposures(exposures, graph, cell, drawn - here)
                if any_located:
                    sum_through(sums, located, hazardous, cell)


@compiled
def swap_hazards(
    state: HazardState,
    factors: Factors,
    graph: LossGraph,
    located: LocatedGraph,
    ties: Ties,
    uniform: NDArray[np.float64],
) -> None:
    r"""
    Propose that a hazardous and a safe cell of a lost path change places (Metropolis).

    The swap of hazard i with safe cell j, from z to z', is accepted with the probability of
    equation :eq:`swap`,

    .. math:: \min \Bigl( 1, e^{o_j - o_i} \prod_a \frac{F(T_a, E_a(z'))}{F(T_a, E_a(z))} \Bigr).

    One proposal takes four numbers of `uniform`, shape (chains, proposals, 4): for the path, its
    hazardous cell, its safe cell and the acceptance. There are as many of each after a swap
    as before, so proposals are symmetric. Where hazards cluster, the ratio has :math:`e^{J k}` as
    well, with the k neighbouring pairs of hazards that the swap brings.
    """
    table = np.empty((factors.endured.shape[1], factors.spared.shape[2]))
    sums = new_sums(located, factors)
    # Handing so many arrays to a function takes longer than what it does without such losses.
    any_located = located.cell.size > 0
    any_tied = ties.neighbors.shape[0] > 0
    for chain in range(state.hazardous.shape[0]):
        odds = factors.odds[chain % factors.odds.shape[0]]
        hazardous, exposures = state.hazardous[chain], state.exposures[chain]
        tabulate_losses(state, factors, chain, table)
        if any_located:
            sum_all_steps(sums, located, state, factors, chain)
        for proposal in range(uniform.shape[1]):
            numbers = uniform[chain, proposal]
            path = int(numbers[0] * (graph.first_cell.size - 1))
            first, end = graph.first_cell[path], graph.first_cell[path + 1]
            cells = graph.cell[first:end]
            hazards = 0
            for cell in cells:
                hazards += hazardous[cell]
            if hazards == 0 or hazards == cells.size:
                continue
            old = nth_cell(cells, hazardous, 1, int(numbers[1] * hazards))
            new = nth_cell(cells, hazardous, 0, int(numbers[2] * (cells.size - hazards)))
            ratio = odds[new] / odds[old]
            if any_tied:
                # Neither is a neighbour of the other's hazard.
                hazardous[old] = 0
                more = hazards_around(ties, hazardous, new) - hazards_around(ties, hazardous, old)
                hazardous[old] = 1
                ratio = min(ratio * ties.strength[chain] ** more, LARGE)
            # The new hazard comes first, so that no loss is left unexplained in between.
            ratio = loss_ratio(exposures, factors, graph, table, new, 1, ratio)
            if any_located:
                ratio = located_ratio(sums, located, hazardous, new, 1, ratio)
                hazardous[new] = 1
                sum_through(sums, located, hazardous, new)
            ratio = loss_ratio(exposures, factors, graph, table, old, -1, ratio)
            if any_located:
                ratio = located_ratio(sums, located, hazardous, old, 0, ratio)
            changed = old if numbers[3] < ratio else new
            hazardous[new], hazardous[old] = 1, 1
            hazardous[changed] = 0
            if changed == new:
                add_exposures(exposures, graph, new, -1)
                add_exposures(exposures, graph, old, 1)
            if any_located:
                sum_through(sums, located, hazardous, changed)


@compiled
def count_exposures(state: HazardState, graph: LossGraph) -> None:
    """Add up the exposures of each lost path, which are 0."""
    for chain in range(state.hazardous.shape[0]):
        hazardous, exposures = state.hazardous[chain], state.exposures[chain]
        for cell in range(hazardous.size):
            if hazardous[cell]:
                add_exposures(exposures, graph, cell, 1)


@compiled
def add_joints(
    odds: NDArray[np.float64],
    target_if_safe: NDArray[np.float64],
    target_if_hazardous: NDArray[np.float64],
    joints: NDArray[np.float64],
) -> None:
    r"""
    Add the joints of hazard and target, averaged over each group of chains.

    Equation :eq:`averaged-belief`: each chain adds its conditional probabilities,

    .. math:: P(z_i \mid z_{-i}, \theta) \, P(x_i \mid z_i, \theta).

    Parameters
    ----------
    odds : ndarray, shape (chains, cells)
        Of a hazard.
    target_if_safe, target_if_hazardous : ndarray, shape (1 or chains, cells)
        Odds of a target.
    joints : ndarray, shape (groups, cells, 2, 2)
        What to add to, indexed [group, cell, z, x]. The chains of a group follow each other.

    """
    size = odds.shape[0] // joints.shape[0]
    for chain in range(odds.shape[0]):
        if_safe = target_if_safe[chain % target_if_safe.shape[0]]
        if_hazardous = target_if_hazardous[chain % target_if_hazardous.shape[0]]
        group = joints[chain // size]
        for cell in range(odds.shape[1]):
            safe = 1.0 / (1.0 + odds[chain, cell]) / size
            hazard = odds[chain, cell] * safe
            safe /= 1.0 + if_safe[cell]
            hazard /= 1.0 + if_hazardous[cell]
            group[cell, 0, 0] += safe
            group[cell, 0, 1] += safe * if_safe[cell]
            group[cell, 1, 0] += hazard
            group[cell, 1, 1] += hazard * if_hazardous[cell]


@compiled
def draw_values(
    weights: NDArray[np.float64], uniform: NDArray[np.float64], place: NDArray[np.intp]
) -> None:
    """Draw the place of each chain by its `weights`, (chains, values), and normalise these."""
    for chain in range(weights.shape[0]):
        own = weights[chain]
        total = 0.0
        for value in range(own.size):
            total += own[value]
        sought, below, drawn = uniform[chain] * total, 0.0, 0
        for value in range(own.size):
            below += own[value]
            if below <= sought:
                drawn = value + 1
            own[value] /= total
        place[chain] = min(drawn, own.size - 1)


@compiled
def weigh_by_losses(
    kept: NDArray[np.float64],
    place: NDArray[np.int32],
    rest: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> None:
    r"""
    Multiply `likelihood`, (chains, values), by that of all losses, for each value of a rate.

    The product of equation :eq:`rate-conditional`,

    .. math:: \prod_a F(T_a, E_a) = \prod_a \bigl( 1 - (1 - m)^{T_a} (1 - \lambda)^{E_a} \bigr).

    Parameters
    ----------
    kept, place : ndarray, shape (chains, losses)
        The part of the chance to survive each lost path that the rate has nothing to do with,
        and the row of the other part.
    rest : ndarray, shape (places, values)
        The other part, for each value of the rate.
    likelihood : ndarray, shape (chains, values)
        Divided by whatever keeps it in range: only the ratios of a chain's values tell anything.

    """
    for chain in range(likelihood.shape[0]):
        own = likelihood[chain]
        for path in range(kept.shape[1]):
            chance, row = kept[chain, path], rest[place[chain, path]]
            for value in range(own.size):
                own[value] *= lost(chance * row[value])
            if path % OFTEN == OFTEN - 1:
                largest = 0.0
                for value in range(own.size):
                    largest = max(largest, own[value])
                for value in range(own.size):
                    own[value] /= largest


@compiled
def weigh_by_located(
    hazardous: NDArray[np.int8],
    located: LocatedGraph,
    safe: NDArray[np.float64],
    exposed: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> None:
    """
    Do what `weigh_by_losses` does, of the located losses, by equation :eq:`loss-located`.

    Parameters
    ----------
    hazardous : ndarray of int, shape (chains, cells)
        Z of each cell.
    located : LocatedGraph
        The losses.
    safe, exposed : ndarray, shape (chains, types, values)
        Chance to survive a step into a safe cell and into a hazard, for each value of the rate.
    likelihood : ndarray, shape (chains, values)
        Divided by whatever keeps it in range.

    """
    rest = np.empty(likelihood.shape[1])
    for chain in range(likelihood.shape[0]):
        own = likelihood[chain]
        for path in range(located.robot_type.size):
            robot_type = located.robot_type[path]
            rest[:] = 0.0
            for step in range(located.first_step[path + 1] - 1, located.first_step[path] - 1, -1):
                if hazardous[chain, located.cell[step]]:
                    survived = exposed[chain, robot_type]
                else:
                    survived = safe[chain, robot_type]
                weight = located.lost_at[step]
                for value in range(rest.size):
                    alive = survived[value]
                    rest[value] = weight * (1.0 - alive) + alive * rest[value]
            largest = 0.0
            for value in range(rest.size):
                own[value] *= max(rest[value], LEAST_FIT)
                largest = max(largest, own[value])
            for value in range(rest.size):
                own[value] /= largest


@compiled
def sum_of_cells(
    chosen: NDArray[np.bool_], table: NDArray[np.float64], total: NDArray[np.float64]
) -> None:
    """
    Add to `total`, (chains, values), the rows of `table`, (cells, values), of those chosen.

    The sum over cells of the logarithm of equation :eq:`map-conditional`.
    """
    for chain in range(chosen.shape[0]):
        for cell in range(chosen.shape[1]):
            if chosen[chain, cell]:
                for value in range(table.shape[1]):
                    total[chain, value] += table[cell, value]
