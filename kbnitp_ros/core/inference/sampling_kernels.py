# SPDX-License-Identifier: Apache-2.0
"""Kernels of the Gibbs chains: draws of hazards and numbers given lost paths."""

from __future__ import annotations

from typing import NamedTuple

from kbnitp_ros.core.field.compiled import compiled, inlined
import numpy as np
from numpy.typing import NDArray

# Lower limit of the likelihood of a loss, so that a chain can leave states in which the loss is
# impossible; far above the rounding error of 1 - 1.
LEAST = 1e-30
# Limits of odds, within the range of floating point.
SMALL, LARGE = 1e-200, 1e300
# Number of losses multiplied between normalisations, so that products do not underflow.
OFTEN = 6


class Losses(NamedTuple):
    """Lost paths, each cut into blocks of steps with equal `lost_at` (:eq:`loss-located`)."""

    # The cells of loss a are ``cell[first_cell[a]:first_cell[a + 1]]``.
    first_cell: NDArray[np.int32]
    cell: NDArray[np.int32]
    # The losses through cell i are entries ``first_entry[i]`` to ``first_entry[i + 1] - 1``: the
    # blocks of the loss, and where in `visits` those to the cell begin, one number for each block.
    first_entry: NDArray[np.int32]
    first_block: NDArray[np.int32]
    end_block: NDArray[np.int32]
    row: NDArray[np.int32]
    visits: NDArray[np.int32]
    # Number of blocks of each loss; of each block, the likelihood of a loss in it, and places of
    # its steps and of no exposures in the tables of survival.
    blocks: NDArray[np.int32]
    weight: NDArray[np.float64]
    steps: NDArray[np.int32]
    unexposed: NDArray[np.int32]


class ChainStates(NamedTuple):
    """The hazards of each chain, the losses, and what determines the conditional of a hazard."""

    losses: Losses
    # Z of each cell, shape (chains, cells), and steps into hazards, shape (chains, blocks).
    hazardous: NDArray[np.int8]
    exposures: NDArray[np.int32]
    # Chance of no malfunction in a number of steps, and of surviving a number of exposures, for
    # each robot type, shape (values, types * numbers); and their rows, shape (chains,).
    endured: NDArray[np.float64]
    spared: NDArray[np.float64]
    malfunction: NDArray[np.intp]
    lethality: NDArray[np.intp]
    # Neighbours that share a side with each cell, -1 for none, shape (cells, 4), and e^J of each
    # chain; no rows if hazards are independent (:eq:`clustered-prior`).
    neighbors: NDArray[np.intp]
    coupling: NDArray[np.float64]


class Chain(NamedTuple):
    """One chain's rows of a `ChainStates`."""

    hazardous: NDArray[np.int8]
    exposures: NDArray[np.int32]
    endured: NDArray[np.float64]
    spared: NDArray[np.float64]
    coupling: float


@compiled
def hazards_around(neighbors: NDArray[np.intp], hazardous: NDArray[np.int8], cell: int) -> int:
    """Return the number of hazardous neighbours of a cell."""
    count = 0
    for side in range(neighbors.shape[1]):
        neighbor = neighbors[cell, side]
        if neighbor >= 0:
            count += hazardous[neighbor]
    return count


@inlined
def survival(losses: Losses, chain: Chain, block: int, exposures: int) -> float:
    """Return the chance to survive a block with a number of exposures."""
    endured = chain.endured[losses.steps[block]]
    return float(endured * chain.spared[losses.unexposed[block] + exposures])


@inlined
def conditional(
    losses: Losses, neighbors: NDArray[np.intp], chain: Chain, cell: int, odds: float
) -> float:
    """Return the odds of a hazard given all others (:eq:`hazard-conditional`)."""
    here, with_hazard, without = chain.hazardous[cell], 1.0, 1.0
    for entry in range(losses.first_entry[cell], losses.first_entry[cell + 1]):
        block, visits = losses.first_block[entry], losses.row[entry]
        others = chain.exposures[block] - here * losses.visits[visits]
        # The chance to reach the next block, and the likelihood of the loss so far
        # (:eq:`loss-probability`), each with the hazard and without.
        reached = survival(losses, chain, block, others + losses.visits[visits])
        reached_without = survival(losses, chain, block, others)
        likelihood = losses.weight[block] * (1.0 - reached)
        likelihood_without = losses.weight[block] * (1.0 - reached_without)
        for further in range(block + 1, losses.end_block[entry]):
            visits += 1
            others = chain.exposures[further] - here * losses.visits[visits]
            survived = survival(losses, chain, further, others + losses.visits[visits])
            likelihood += losses.weight[further] * reached * (1.0 - survived)
            reached *= survived
            survived = survival(losses, chain, further, others)
            likelihood_without += losses.weight[further] * reached_without * (1.0 - survived)
            reached_without *= survived
        with_hazard *= max(likelihood, LEAST)
        without *= max(likelihood_without, LEAST)
        if without < SMALL:
            odds = min(odds * (with_hazard / without), LARGE)
            with_hazard, without = 1.0, 1.0
    odds = min(odds * (with_hazard / without), LARGE)
    if neighbors.shape[0] > 0:
        for _ in range(hazards_around(neighbors, chain.hazardous, cell)):
            odds = min(odds * chain.coupling, LARGE)
    return odds


@inlined
def put(losses: Losses, chain: Chain, cell: int, hazard: int) -> None:
    """Set the hazard of a cell, and update the exposures of the lost paths through it."""
    more = hazard - chain.hazardous[cell]
    chain.hazardous[cell] = hazard
    for entry in range(losses.first_entry[cell], losses.first_entry[cell + 1]):
        visits = losses.row[entry]
        for block in range(losses.first_block[entry], losses.end_block[entry]):
            chain.exposures[block] += more * losses.visits[visits]
            visits += 1


@compiled
def draw_hazards(
    field: ChainStates,
    cells: NDArray[np.intp],
    odds: NDArray[np.float64],
    uniform: NDArray[np.float64],
    drawn_with: NDArray[np.float64],
) -> None:
    """Draw the hazard of each of `cells` given all others; write its odds into `drawn_with`."""
    losses, neighbors = field.losses, field.neighbors
    for number in range(field.hazardous.shape[0]):
        chain = Chain(
            field.hazardous[number],
            field.exposures[number],
            field.endured[field.malfunction[number]],
            field.spared[field.lethality[number]],
            field.coupling[number],
        )
        for place in range(cells.size):
            cell = cells[place]
            ratio = conditional(losses, neighbors, chain, cell, odds[number, cell])
            drawn_with[number, cell] = ratio
            hazard = 1 if uniform[number, place] < ratio / (1.0 + ratio) else 0
            if hazard != chain.hazardous[cell]:
                put(losses, chain, cell, hazard)


@inlined
def nth_cell(losses: Losses, chain: Chain, loss: int, hazard: int, n: int) -> int:
    """Return the n-th cell, from 0, of a lost path among its cells with this hazard."""
    for entry in range(losses.first_cell[loss], losses.first_cell[loss + 1]):
        cell = losses.cell[entry]
        if chain.hazardous[cell] == hazard:
            if n == 0:
                return int(cell)
            n -= 1
    return -1


@compiled
def swap_hazards(
    field: ChainStates,
    is_drawn: NDArray[np.bool_],
    odds: NDArray[np.float64],
    uniform: NDArray[np.float64],
) -> None:
    """Propose to swap a hazardous and a safe cell of a lost path (:eq:`swap`)."""
    losses, neighbors = field.losses, field.neighbors
    for number in range(field.hazardous.shape[0]):
        chain = Chain(
            field.hazardous[number],
            field.exposures[number],
            field.endured[field.malfunction[number]],
            field.spared[field.lethality[number]],
            field.coupling[number],
        )
        for proposal in range(uniform.shape[1]):
            numbers = uniform[number, proposal]
            loss = int(numbers[0] * (losses.first_cell.size - 1))
            cells, hazards = losses.first_cell[loss + 1] - losses.first_cell[loss], 0
            for entry in range(losses.first_cell[loss], losses.first_cell[loss + 1]):
                hazards += chain.hazardous[losses.cell[entry]]
            if hazards == 0 or hazards == cells:
                continue
            old = nth_cell(losses, chain, loss, 1, int(numbers[1] * hazards))
            new = nth_cell(losses, chain, loss, 0, int(numbers[2] * (cells - hazards)))
            if is_drawn[old] and is_drawn[new]:
                # Add the new hazard before removing the old, so that every loss stays possible.
                ratio = conditional(losses, neighbors, chain, new, odds[number, new])
                put(losses, chain, new, 1)
                ratio /= conditional(losses, neighbors, chain, old, odds[number, old])
                put(losses, chain, old if numbers[3] < ratio else new, 0)


@compiled
def count_exposures(field: ChainStates) -> None:
    """Add up the exposures of all blocks in each chain."""
    losses = field.losses
    for chain in range(field.hazardous.shape[0]):
        for cell in range(field.hazardous.shape[1]):
            if field.hazardous[chain, cell]:
                for entry in range(losses.first_entry[cell], losses.first_entry[cell + 1]):
                    first = losses.first_block[entry]
                    for block in range(first, losses.end_block[entry]):
                        visits = losses.visits[losses.row[entry] + block - first]
                        field.exposures[chain, block] += visits


@compiled
def count_coupled(field: ChainStates, pairs: NDArray[np.int64]) -> None:
    """Count the pairs of neighbouring hazards in each chain."""
    for chain in range(field.hazardous.shape[0]):
        pairs[chain] = 0
        for cell in range(field.hazardous.shape[1]):
            if field.hazardous[chain, cell]:
                pairs[chain] += hazards_around(field.neighbors, field.hazardous[chain], cell)
        pairs[chain] //= 2


@compiled
def weigh_by_losses(
    losses: Losses,
    known: NDArray[np.float64],
    row: NDArray[np.int32],
    of_rate: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> None:
    """Multiply `likelihood`, (chains, values), by that of all losses (:eq:`rate-conditional`)."""
    # The chance to survive a block is `known`, (chains, blocks), which the rate does not change,
    # times the block's `row` of `of_rate`, (rows, values).
    values = likelihood.shape[1]
    fits, reached = np.empty(values), np.empty(values)
    for chain in range(likelihood.shape[0]):
        own = likelihood[chain]
        end = 0
        for loss in range(losses.blocks.size):
            first, end = end, end + losses.blocks[loss]
            survives, rates = known[chain, first], of_rate[row[chain, first]]
            if end - first == 1:
                for value in range(values):
                    own[value] *= max(1.0 - survives * rates[value], LEAST)
            else:
                fits[:], reached[:] = 0.0, 1.0
                for block in range(first, end):
                    weight, survives = losses.weight[block], known[chain, block]
                    rates = of_rate[row[chain, block]]
                    for value in range(values):
                        survived = survives * rates[value]
                        fits[value] += weight * reached[value] * (1.0 - survived)
                        reached[value] *= survived
                for value in range(values):
                    own[value] *= max(fits[value], LEAST)
            if loss % OFTEN == OFTEN - 1:
                largest = SMALL
                for value in range(values):
                    largest = max(largest, own[value])
                for value in range(values):
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
