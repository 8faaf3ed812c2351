# SPDX-License-Identifier: Apache-2.0
"""Kernels of the Gibbs chains: draws of fields and numbers."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.field.compiled import compiled, inlined
import numpy as np
from numpy.typing import NDArray

# Lower limit of the likelihood of a located loss, so that a chain can leave states in which the
# loss is impossible. It is below LEAST: unlike 1 - survival, the sum has no rounding error.
LEAST_FIT = 1e-100
# Upper limit of products, within the range of floating point.
LARGE = 1e300


class LocatedGraph(NamedTuple):
    """Losses for which the likelihood of each step is known."""

    # The losses through cell i are ``loss[first_entry[i]:first_entry[i + 1]]``; shape (cells +
    # 1,).
    first_entry: NDArray[np.int32]
    # Index of a loss, and of its first and last steps into the cell, shape (entries,).
    loss: NDArray[np.int32]
    first: NDArray[np.int32]
    last: NDArray[np.int32]
    # The steps of loss a are ``first_step[a]`` to ``first_step[a + 1] - 1``; shape (losses + 1,).
    first_step: NDArray[np.int32]
    # Robot type of each loss, shape (losses,).
    robot_type: NDArray[np.int32]
    # The cell of each step, shape (steps,).
    cell: NDArray[np.int32]
    # Likelihood of a loss in each step, shape (steps,).
    lost_at: NDArray[np.float64]


class LocatedSums(NamedTuple):
    """Sums of one chain over the steps before and after each step of the located losses."""

    # Likelihood of the loss in earlier steps, shape (steps,).
    before: NDArray[np.float64]
    # Chance to survive all earlier steps, shape (steps,).
    reached: NDArray[np.float64]
    # Likelihood of the loss from this step on, given survival so far, shape (steps,).
    rest: NDArray[np.float64]
    # s_z of one step, by robot type, shape (types, 2).
    survival: NDArray[np.float64]


@compiled
def new_sums(located: LocatedGraph, robot_types: int) -> LocatedSums:
    """Allocate the sums of one chain."""
    steps = located.cell.size
    return LocatedSums(
        np.empty(steps), np.empty(steps), np.empty(steps), np.empty((robot_types, 2))
    )


@inlined
def sum_steps(
    sums: LocatedSums, located: LocatedGraph, hazardous: NDArray[np.int8], path: int
) -> None:
    """Compute the sums of a located loss for the hazards of a chain (:eq:`loss-located`)."""
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
    hazardous: NDArray[np.int8],
    endured: NDArray[np.float64],
    spared: NDArray[np.float64],
) -> None:
    """Compute the sums of all located losses for the hazards and rates of a chain."""
    sums.survival[:, 0] = endured
    sums.survival[:, 1] = endured * spared
    for path in range(located.robot_type.size):
        sum_steps(sums, located, hazardous, path)


@inlined
def located_chance(
    sums: LocatedSums,
    located: LocatedGraph,
    hazardous: NDArray[np.int8],
    entry: int,
    hazard: int,
) -> float:
    """Return the likelihood of a located loss if the entry's cell has this hazard, 0 or 1."""
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
    """Update the sums of the located losses through a cell."""
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
    """Multiply `ratio` by located losses' likelihood with `hazard` over that with 1 - `hazard`."""
    for entry in range(located.first_entry[cell], located.first_entry[cell + 1]):
        now = located_chance(sums, located, hazardous, entry, hazard)
        other = located_chance(sums, located, hazardous, entry, 1 - hazard)
        ratio = min(ratio * (now / other), LARGE)
    return ratio


@compiled
def weigh_by_located(
    hazardous: NDArray[np.int8],
    located: LocatedGraph,
    safe: NDArray[np.float64],
    exposed: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> None:
    """Multiply `likelihood`, (chains, values), by that of located losses (:eq:`loss-located`)."""
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


# Number of losses multiplied between normalisations, so that products do not underflow.
OFTEN = 6


@compiled
def draw_values(
    weights: NDArray[np.float64], uniform: NDArray[np.float64], place: NDArray[np.intp]
) -> None:
    """Draw a value for each chain by `weights`, (chains, values); normalise the weights."""
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
    fixed: NDArray[np.float64],
    row: NDArray[np.int32],
    by_rate: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> None:
    """Multiply `likelihood`, (chains, values), by that of all losses (:eq:`rate-conditional`)."""
    # The chance to survive a path is `fixed` (chains, losses), which the rate does not change,
    # times the path's `row` of `by_rate` (rows, values).
    for chain in range(likelihood.shape[0]):
        own = likelihood[chain]
        for path in range(fixed.shape[1]):
            known, of_values = fixed[chain, path], by_rate[row[chain, path]]
            for value in range(own.size):
                own[value] *= lost(known * of_values[value])
            if path % OFTEN == OFTEN - 1:
                largest = 0.0
                for value in range(own.size):
                    largest = max(largest, own[value])
                for value in range(own.size):
                    own[value] /= largest


@compiled
def sum_of_cells(
    chosen: NDArray[np.bool_], table: NDArray[np.float64], total: NDArray[np.float64]
) -> None:
    """Add the rows of chosen cells to `total`, (chains, values) (:eq:`map-conditional`)."""
    for chain in range(chosen.shape[0]):
        for cell in range(chosen.shape[1]):
            if chosen[chain, cell]:
                for value in range(table.shape[1]):
                    total[chain, value] += table[cell, value]


# Lower limit of the likelihood of a loss, so that a chain can leave states in which the loss is
# impossible; far above the rounding error of 1 - 1.
LEAST = 1e-30
# Limit below which products are divided, within the range of floating point.
SMALL = 1e-200


class LossGraph(NamedTuple):
    """The lost paths through each cell, and the cells of each lost path."""

    # The lost paths through cell i are ``loss[first_loss[i]:first_loss[i + 1]]``; shape (cells +
    # 1,).
    first_loss: NDArray[np.int32]
    # Index of a lost path, and its number of visits to the cell, shape (entries,).
    loss: NDArray[np.int32]
    visits: NDArray[np.int32]
    # The undecided cells of lost path a are ``cell[first_cell[a]:first_cell[a + 1]]``; paths of
    # located losses come last; shape (losses + 1,).
    first_cell: NDArray[np.int32]
    cell: NDArray[np.int32]


class HazardState(NamedTuple):
    """The hazards of each chain, and quantities derived from them; kernels change all in place."""

    # Z of each cell, shape (chains, cells).
    hazardous: NDArray[np.int8]
    # Number of steps of each lost path into hazards, shape (chains, losses).
    exposures: NDArray[np.int32]
    # Rows of `Factors.endured` and `Factors.spared`, shape (chains,).
    malfunction: NDArray[np.intp]
    strike: NDArray[np.intp]


class Factors(NamedTuple):
    """The factors of the conditional probabilities from which hazards are drawn."""

    # Odds of each hazard without the losses, at most `LARGE`, shape (1 or chains, cells).
    odds: NDArray[np.float64]
    # Index of each lost path's pair of length and robot type, shape (losses,).
    length: NDArray[np.intp]
    # Robot type of each pair, shape (lengths,).
    robot_type: NDArray[np.intp]
    # Chance of no malfunction in a path of each pair, shape (values, lengths).
    endured: NDArray[np.float64]
    # Chance to survive the strikes of each number of exposures, shape (values, types, most
    # exposures + 1).
    spared: NDArray[np.float64]
    # Chances, in one step, of no malfunction and of surviving a hazard's strike, shape (values,
    # types).
    step_endured: NDArray[np.float64]
    step_spared: NDArray[np.float64]
    # The lost paths.
    graph: LossGraph
    # The located losses.
    located: LocatedGraph
    # Neighbours that share a side with each cell, -1 for none, shape (cells, 4); no rows if
    # hazards are independent (equation :eq:`clustered-prior`).
    neighbors: NDArray[np.intp]
    # e^J of the coupling J of neighbouring hazards, shape (chains,).
    coupling: NDArray[np.float64]


@compiled
def lost(survived: float) -> float:
    """Return the chance of a loss for a chance of survival (:eq:`loss-probability`)."""
    return max(1.0 - survived, LEAST)


@compiled
def tabulate_losses(
    endured: NDArray[np.float64],
    spared: NDArray[np.float64],
    robot_type: NDArray[np.intp],
    table: NDArray[np.float64],
) -> None:
    """Fill `table`, (lengths, exposures), with a chain's likelihoods of losses."""
    for length in range(endured.size):
        of_type = spared[robot_type[length]]
        for exposures in range(of_type.size):
            table[length, exposures] = lost(endured[length] * of_type[exposures])


@compiled
def add_exposures(exposures: NDArray[np.int32], graph: LossGraph, cell: int, hazards: int) -> None:
    """Update the exposures of lost paths as a cell gains (`hazards` 1) or loses (-1) a hazard."""
    for entry in range(graph.first_loss[cell], graph.first_loss[cell + 1]):
        exposures[graph.loss[entry]] += hazards * graph.visits[entry]


@compiled
def loss_ratio(
    exposures: NDArray[np.int32],
    length: NDArray[np.intp],
    table: NDArray[np.float64],
    graph: LossGraph,
    cell: int,
    hazards: int,
    ratio: float,
) -> float:
    """Apply `add_exposures`; return `ratio` times the losses' likelihood ratio, new to old."""
    for entry in range(graph.first_loss[cell], graph.first_loss[cell + 1]):
        path = graph.loss[entry]
        chance = table[length[path]]
        before = chance[exposures[path]]
        exposures[path] += hazards * graph.visits[entry]
        ratio = min(ratio * (chance[exposures[path]] / before), LARGE)
    return ratio


@compiled
def hazards_around(neighbors: NDArray[np.intp], hazardous: NDArray[np.int8], cell: int) -> int:
    """Return the number of hazardous neighbours of a cell."""
    count = 0
    for side in range(neighbors.shape[1]):
        neighbor = neighbors[cell, side]
        if neighbor >= 0:
            count += hazardous[neighbor]
    return count


@compiled
def count_coupled(
    neighbors: NDArray[np.intp], hazardous: NDArray[np.int8], pairs: NDArray[np.int64]
) -> None:
    """Count the pairs of neighbouring hazards in each chain."""
    for chain in range(hazardous.shape[0]):
        count = 0
        for cell in range(hazardous.shape[1]):
            if hazardous[chain, cell]:
                count += hazards_around(neighbors, hazardous[chain], cell)
        pairs[chain] = count // 2


@compiled
def nth_cell(cells: NDArray[np.int32], hazardous: NDArray[np.int8], hazard: int, n: int) -> int:
    """Return the n-th cell, from 0, among cells with this hazard."""
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
    cells: NDArray[np.intp],
    uniform: NDArray[np.float64],
    drawn_with: NDArray[np.float64],
) -> None:
    """Draw each cell given all others (:eq:`hazard-conditional`, :eq:`loss-located`)."""
    graph, located, neighbors = factors.graph, factors.located, factors.neighbors
    # Calls are skipped if no loss is located, since passing so many arrays takes long.
    any_located, any_coupled = located.cell.size > 0, neighbors.shape[0] > 0
    table = np.empty((factors.endured.shape[1], factors.spared.shape[2]))
    sums = new_sums(located, factors.step_endured.shape[1])
    # Weights by number of hazardous neighbours: a power for each cell would take most of the time.
    weight_around = np.empty(5)
    for chain in range(state.hazardous.shape[0]):
        malfunction, strike = state.malfunction[chain], state.strike[chain]
        endured, spared = factors.endured[malfunction], factors.spared[strike]
        hazardous, exposures = state.hazardous[chain], state.exposures[chain]
        tabulate_losses(endured, spared, factors.robot_type, table)
        if any_located:
            endured, alive = factors.step_endured[malfunction], factors.step_spared[strike]
            sum_all_steps(sums, located, hazardous, endured, alive)
        if any_coupled:
            for around in range(weight_around.size):
                weight_around[around] = factors.coupling[chain] ** around
        odds = factors.odds[chain % factors.odds.shape[0]]
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
            if any_coupled:
                around = hazards_around(neighbors, hazardous, cell)
                ratio = min(ratio * weight_around[around], LARGE)
            drawn_with[chain, cell] = ratio
            drawn = 1 if uniform[chain, cell] < ratio / (1.0 + ratio) else 0
            if drawn != here:
                hazardous[cell] = drawn
                add_exposures(exposures, graph, cell, drawn - here)
                if any_located:
                    sum_through(sums, located, hazardous, cell)


@compiled
def swap_hazards(state: HazardState, factors: Factors, uniform: NDArray[np.float64]) -> None:
    """Propose to swap a hazardous and a safe cell of a lost path (:eq:`swap`)."""
    graph, located, neighbors = factors.graph, factors.located, factors.neighbors
    # Calls are skipped if no loss is located, since passing so many arrays takes long.
    any_located, any_coupled = located.cell.size > 0, neighbors.shape[0] > 0
    table = np.empty((factors.endured.shape[1], factors.spared.shape[2]))
    sums = new_sums(located, factors.step_endured.shape[1])
    for chain in range(state.hazardous.shape[0]):
        malfunction, strike = state.malfunction[chain], state.strike[chain]
        endured, spared = factors.endured[malfunction], factors.spared[strike]
        hazardous, exposures = state.hazardous[chain], state.exposures[chain]
        tabulate_losses(endured, spared, factors.robot_type, table)
        if any_located:
            endured, alive = factors.step_endured[malfunction], factors.step_spared[strike]
            sum_all_steps(sums, located, hazardous, endured, alive)
        odds = factors.odds[chain % factors.odds.shape[0]]
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
            if any_coupled:
                # Count without the old hazard, which is no neighbour of the new cell after a swap.
                hazardous[old] = 0
                more = hazards_around(neighbors, hazardous, new)
                more -= hazards_around(neighbors, hazardous, old)
                hazardous[old] = 1
                ratio = min(ratio * factors.coupling[chain] ** more, LARGE)
            # Add the new hazard before removing the old, so that every loss stays possible.
            ratio = loss_ratio(exposures, factors.length, table, graph, new, 1, ratio)
            if any_located:
                ratio = located_ratio(sums, located, hazardous, new, 1, ratio)
                hazardous[new] = 1
                sum_through(sums, located, hazardous, new)
            ratio = loss_ratio(exposures, factors.length, table, graph, old, -1, ratio)
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
    """Add up the exposures of each lost path in each chain."""
    for chain in range(state.hazardous.shape[0]):
        hazardous, exposures = state.hazardous[chain], state.exposures[chain]
        for cell in range(hazardous.size):
            if hazardous[cell]:
                add_exposures(exposures, graph, cell, 1)


@compiled
def add_joints(
    hazard_odds: NDArray[np.float64],
    target_if_safe: NDArray[np.float64],
    target_if_hazardous: NDArray[np.float64],
    joints: NDArray[np.float64],
) -> None:
    """Add the joints' averages over each group of chains (:eq:`averaged-belief`)."""
    # The odds of targets have the shape (1 or chains, cells).
    chains, cells = hazard_odds.shape
    size = chains // joints.shape[0]
    for chain in range(chains):
        if_safe = target_if_safe[chain % target_if_safe.shape[0]]
        if_hazardous = target_if_hazardous[chain % target_if_hazardous.shape[0]]
        group = joints[chain // size]
        for cell in range(cells):
            safe = 1.0 / (1.0 + hazard_odds[chain, cell]) / size
            hazard = hazard_odds[chain, cell] * safe
            safe /= 1.0 + if_safe[cell]
            hazard /= 1.0 + if_hazardous[cell]
            group[cell, 0, 0] += safe
            group[cell, 0, 1] += safe * if_safe[cell]
            group[cell, 1, 0] += hazard
            group[cell, 1, 1] += hazard * if_hazardous[cell]
