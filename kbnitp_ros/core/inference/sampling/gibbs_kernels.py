# SPDX-License-Identifier: Apache-2.0
"""The moves of a Gibbs sampler over hazards, for many chains side by side."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.field import compiled
from kbnitp_ros.core.inference.sampling.located_kernels import (
    LARGE,
    located_ratio,
    LocatedGraph,
    new_sums,
    sum_all_steps,
    sum_through,
)
import numpy as np
from numpy.typing import NDArray

# A loss is never less likely than this, so that a chain finds out of states that explain it not
# at all; far above what rounding leaves of 1 - 1.
LEAST = 1e-30
# Products are divided before they leave the range of floating point.
SMALL = 1e-200


class LossGraph(NamedTuple):
    """Which cells are on which lost paths, both ways round."""

    # Shape (cells + 1,). The lost paths through cell i are ``loss[first_loss[i]:first_loss[i +
    # 1]]``.
    first_loss: NDArray[np.int32]
    # Shape (entries,). A lost path, and how often it enters the cell.
    loss: NDArray[np.int32]
    visits: NDArray[np.int32]
    # Shape (losses + 1,). The cells of lost path a that may be hazardous or safe are
    # ``cell[first_cell[a]:first_cell[a + 1]]``; located losses come last.
    first_cell: NDArray[np.int32]
    cell: NDArray[np.int32]


class HazardState(NamedTuple):
    """The hazards of each chain, and what follows from them; kernels change it."""

    # Shape (chains, cells). Z of each cell.
    hazardous: NDArray[np.int8]
    # Shape (chains, losses). How many steps of each lost path led into a hazard.
    exposures: NDArray[np.int32]
    # Shape (chains,). Rows of `Factors.endured` and `Factors.spared`.
    malfunction: NDArray[np.intp]
    strike: NDArray[np.intp]


class Coupling(NamedTuple):
    """Coupling of neighbouring hazards in the prior (equation :eq:`clustered-prior`)."""

    # Shape (cells, 4). The cells that share a side with each, -1 for none; no rows if hazards are
    # independent.
    neighbors: NDArray[np.intp]
    # Shape (chains,). e^J.
    strength: NDArray[np.float64]


class Factors(NamedTuple):
    """The factors of the conditionals that hazards are drawn from."""

    # Shape (1 or chains, cells). Of each hazard without the losses; from `SMALL` to `LARGE`.
    odds: NDArray[np.float64]
    # Shape (losses,). Which of the lengths that lost paths have is that of each; of robots of
    # different types they count as different.
    length: NDArray[np.intp]
    # Shape (lengths,). Of the robots whose paths have each length.
    robot_type: NDArray[np.intp]
    # Shape (values, lengths). Chance of no malfunction in a path of each length.
    endured: NDArray[np.float64]
    # Shape (values, types, most exposures + 1). Chance of no strike in that many exposures of a
    # robot of each type.
    spared: NDArray[np.float64]
    # Shape (values, types). Chances of no malfunction and of no strike in one step.
    step_endured: NDArray[np.float64]
    step_spared: NDArray[np.float64]
    # The lost paths.
    graph: LossGraph
    # The losses of which it is known how well each step fits.
    located: LocatedGraph
    # Of neighbouring hazards.
    coupling: Coupling


class LossTable(NamedTuple):
    """The losses of one chain by how many of their steps led into a hazard; kernels change it."""

    # Shape (losses,). As of `HazardState`.
    exposures: NDArray[np.int32]
    # Shape (losses,). As of `Factors`.
    length: NDArray[np.intp]
    # Shape (lengths, most exposures + 1). Of a loss, by the rates of the chain.
    chance: NDArray[np.float64]


class FieldOdds(NamedTuple):
    """The odds of hazards and targets, each of shape (1 or chains, cells)."""

    # Of a hazard.
    hazard: NDArray[np.float64]
    # Of a target without and with one.
    target_if_safe: NDArray[np.float64]
    target_if_hazardous: NDArray[np.float64]


@compiled
def lost(survived: float) -> float:
    """Return the chance to be lost, from that to survive (equation :eq:`loss-probability`)."""
    return max(1.0 - survived, LEAST)


@compiled
def tabulate_losses(
    endured: NDArray[np.float64],
    spared: NDArray[np.float64],
    robot_type: NDArray[np.intp],
    table: NDArray[np.float64],
) -> None:
    """Fill `table`, (lengths, exposures), with the chance to be lost by the rates of a chain."""
    for length in range(endured.size):
        of_type = spared[robot_type[length]]
        for exposures in range(of_type.size):
            table[length, exposures] = lost(endured[length] * of_type[exposures])


@compiled
def add_exposures(exposures: NDArray[np.int32], graph: LossGraph, cell: int, hazards: int) -> None:
    """Add the exposures of lost paths to hazards that come into a cell, or go if negative."""
    for entry in range(graph.first_loss[cell], graph.first_loss[cell + 1]):
        exposures[graph.loss[entry]] += hazards * graph.visits[entry]


@compiled
def loss_ratio(
    losses: LossTable, graph: LossGraph, cell: int, hazards: int, ratio: float
) -> float:
    """Do what `add_exposures` does, and return `ratio` times that of the losses' chances."""
    exposures = losses.exposures
    for entry in range(graph.first_loss[cell], graph.first_loss[cell + 1]):
        path = graph.loss[entry]
        chance = losses.chance[losses.length[path]]
        before = chance[exposures[path]]
        exposures[path] += hazards * graph.visits[entry]
        ratio = min(ratio * (chance[exposures[path]] / before), LARGE)
    return ratio


@compiled
def hazards_around(coupling: Coupling, hazardous: NDArray[np.int8], cell: int) -> int:
    """Return how many of a cell's neighbours are hazardous."""
    count = 0
    for side in range(coupling.neighbors.shape[1]):
        neighbor = coupling.neighbors[cell, side]
        if neighbor >= 0:
            count += hazardous[neighbor]
    return count


@compiled
def count_coupled(
    coupling: Coupling, hazardous: NDArray[np.int8], pairs: NDArray[np.int64]
) -> None:
    """Count the pairs of neighbouring hazards in each chain."""
    for chain in range(hazardous.shape[0]):
        count = 0
        for cell in range(hazardous.shape[1]):
            if hazardous[chain, cell]:
                count += hazards_around(coupling, hazardous[chain], cell)
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
    cells: NDArray[np.intp],
    uniform: NDArray[np.float64],
    drawn_with: NDArray[np.float64],
) -> None:
    r"""
    Draw each of `cells` in turn given all others, by equation :eq:`hazard-conditional`.

    Equation :eq:`loss-located`.
    """
    graph, located, coupling = factors.graph, factors.located, factors.coupling
    # Handing so many arrays to a function takes longer than what it does without such losses.
    any_located, any_coupled = located.cell.size > 0, coupling.neighbors.shape[0] > 0
    table = np.empty((factors.endured.shape[1], factors.spared.shape[2]))
    sums = new_sums(located, factors.step_endured.shape[1])
    # By the number of hazardous neighbours: a power takes longer than all else of most cells.
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
                weight_around[around] = coupling.strength[chain] ** around
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
                around = hazards_around(coupling, hazardous, cell)
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
    r"""
    Propose that a hazardous and a safe cell of a lost path change places (Metropolis).

    Equation :eq:`swap`.
    """
    graph, located, coupling = factors.graph, factors.located, factors.coupling
    # Handing so many arrays to a function takes longer than what it does without such losses.
    any_located, any_coupled = located.cell.size > 0, coupling.neighbors.shape[0] > 0
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
        losses = LossTable(exposures, factors.length, table)
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
                # Neither is a neighbour of the other's hazard.
                hazardous[old] = 0
                more = hazards_around(coupling, hazardous, new)
                more -= hazards_around(coupling, hazardous, old)
                hazardous[old] = 1
                ratio = min(ratio * coupling.strength[chain] ** more, LARGE)
            # The new hazard comes first, so that no loss is left unexplained in between.
            ratio = loss_ratio(losses, graph, new, 1, ratio)
            if any_located:
                ratio = located_ratio(sums, located, hazardous, new, 1, ratio)
                hazardous[new] = 1
                sum_through(sums, located, hazardous, new)
            ratio = loss_ratio(losses, graph, old, -1, ratio)
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
def add_joints(odds: FieldOdds, joints: NDArray[np.float64]) -> None:
    r"""
    Add the joints of hazard and target, averaged over each group of chains.

    Equation :eq:`averaged-belief`.
    """
    chains, cells = odds.hazard.shape
    size = chains // joints.shape[0]
    for chain in range(chains):
        if_safe = odds.target_if_safe[chain % odds.target_if_safe.shape[0]]
        if_hazardous = odds.target_if_hazardous[chain % odds.target_if_hazardous.shape[0]]
        group = joints[chain // size]
        for cell in range(cells):
            safe = 1.0 / (1.0 + odds.hazard[chain, cell]) / size
            hazard = odds.hazard[chain, cell] * safe
            safe /= 1.0 + if_safe[cell]
            hazard /= 1.0 + if_hazardous[cell]
            group[cell, 0, 0] += safe
            group[cell, 0, 1] += safe * if_safe[cell]
            group[cell, 1, 0] += hazard
            group[cell, 1, 1] += hazard * if_hazardous[cell]
