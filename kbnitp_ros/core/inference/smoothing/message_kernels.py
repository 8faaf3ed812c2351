# SPDX-License-Identifier: Apache-2.0
"""
Belief propagation between lost paths and the hazards of their cells, as compiled kernels.

A lost path is a factor 1 - prod_i s_{z_i}^{n_i}, or where more is known of the loss the sum over
its steps k of lost_at[k] P(lost in step k | z); equal ones are copies of one factor, which send
the same messages. What a factor sends depends on its cells' log odds. A cell sends its factors
its log odds again when the chance that it destroys a robot has changed by more than a tolerance,
and only factors that received something send again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kbnitp_ros.core.field import compiled, inlined
import numpy as np
from numpy.typing import NDArray

# Below this a chance counts as this, so that its logarithm can be taken.
SMALLEST = 1e-300
# A change of a chance to destroy that is this small is never sent.
NEGLIGIBLE = 1e-15


class FactorGraph(NamedTuple):
    """
    Which factor has which cells; the entries of all stand one after another, a factor's together.

    Attributes
    ----------
    first : ndarray of int, shape (factors + 1,)
        Where the entries of each factor start.
    longest : int
        The most entries of a factor.
    copies : ndarray, shape (factors,)
        How often each path was lost, with as much known of where.
    node : ndarray of int, shape (entries,)
        The cell of each entry.
    factor : ndarray of int, shape (entries,)
        The factor of each entry.
    lost : ndarray, shape (entries, 2)
        1 - s_z^n of the path's n visits to the cell.
    first_step : ndarray of int, shape (factors + 1,)
        Where the steps of each factor start; it has none if they are all alike.
    place : ndarray of int, shape (steps,)
        Which of the factor's entries each step leads to, from 0.
    lost_at : ndarray, shape (steps,)
        How well a loss in each step fits what was observed.
    survived : ndarray, shape (factors, 2)
        s_z of one step of the robot that was lost.
    died : ndarray, shape (factors, 2)
        1 - s_z.
    newest : ndarray of int, shape (cells,)
        The last entry of each cell.
    older : ndarray of int, shape (entries,)
        The entry of the same cell before each; -1 if there is none.

    """

    first: NDArray[np.int32]
    longest: int
    copies: NDArray[np.float64]
    node: NDArray[np.int32]
    factor: NDArray[np.int32]
    lost: NDArray[np.float64]
    first_step: NDArray[np.int32]
    place: NDArray[np.int32]
    lost_at: NDArray[np.float64]
    survived: NDArray[np.float64]
    died: NDArray[np.float64]
    newest: NDArray[np.int32]
    older: NDArray[np.int32]


class MessageState(NamedTuple):
    """
    What cells and factors have sent each other; kernels change it.

    Attributes
    ----------
    sent_odds : ndarray, shape (cells,)
        The log odds that each cell has sent to its factors.
    messages : ndarray, shape (entries,)
        The messages from the factors to their cells, in log odds.
    message_sums : ndarray, shape (cells,)
        Their sums, each factor's as often as it has copies.
    terms : ndarray, shape (factors,)
        The share of a copy of each factor in the Bethe log evidence.
    evidence : ndarray, shape (1,)
        The sum of these, each as often as it has copies.

    """

    sent_odds: NDArray[np.float64]
    messages: NDArray[np.float64]
    message_sums: NDArray[np.float64]
    terms: NDArray[np.float64]
    evidence: NDArray[np.float64]


@compiled
def chance(log_odds: float) -> float:
    """Return the probability with these log odds, which may be infinite."""
    if log_odds >= 0.0:
        return 1.0 / (1.0 + math.exp(-log_odds))
    power = math.exp(log_odds)
    return power / (1.0 + power)


@inlined
def weigh_visits(
    graph: FactorGraph,
    state: MessageState,
    factor: int,
    before: NDArray[np.float64],
    loss: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> float:
    """
    Return the chance of a loss whose steps are all alike, and that given each of its hazards.

    Equation :eq:`loss-message`. Complements of the products are added up, for precision where
    nearly everybody survives.

    Parameters
    ----------
    graph : FactorGraph
        All factors.
    state : MessageState
        What was sent.
    factor : int
        Which one.
    before, loss : ndarray, shape (graph.longest + 1,)
        Room to work in: 1 - S_k of each cell, and 1 - prod S_k of those before it.
    likelihood : ndarray, shape (graph.longest + 1, 2)
        Takes the chances given z, of each of the factor's entries.

    """
    start, size = graph.first[factor], graph.first[factor + 1] - graph.first[factor]
    before[0] = 0.0
    for place in range(size):
        entry = start + place
        hazard = chance(state.sent_odds[graph.node[entry]] - state.messages[entry])
        safe, hazardous = graph.lost[entry, 0], graph.lost[entry, 1]
        loss[place] = safe + hazard * (hazardous - safe)
        before[place + 1] = before[place] + (1.0 - before[place]) * loss[place]
    after = 0.0
    for place in range(size - 1, -1, -1):
        entry = start + place
        others = before[place] + (1.0 - before[place]) * after
        likelihood[place, 0] = others + (1.0 - others) * graph.lost[entry, 0]
        likelihood[place, 1] = others + (1.0 - others) * graph.lost[entry, 1]
        after += (1.0 - after) * loss[place]
    return float(before[size])


@compiled
def weigh_steps(
    graph: FactorGraph, state: MessageState, factor: int, likelihood: NDArray[np.float64]
) -> float:
    """
    Do what `weigh_visits` does, of a loss of which it is known how well each step fits.

    Equation :eq:`located-exact`, with the cavity beliefs of the cells. Their chances to spare the
    robot in each step, given that they did so before, are found once. Forward sums hold the loss
    in the steps before the first visit to a cell, backward sums that in the steps after its last.
    """
    start, size = graph.first[factor], graph.first[factor + 1] - graph.first[factor]
    begin, end = graph.first_step[factor], graph.first_step[factor + 1]
    steps, lost_at = graph.place[begin:end], graph.lost_at[begin:end]
    survived, died = graph.survived[factor], graph.died[factor]
    chances = np.empty((size, 2))
    first, last = np.full(size, steps.size), np.zeros(size, dtype=np.int64)
    for place in range(size):
        entry = start + place
        log_odds = state.sent_odds[graph.node[entry]] - state.messages[entry]
        chances[place, 0], chances[place, 1] = chance(-log_odds), chance(log_odds)
    lost, spared = np.empty(steps.size), np.empty(steps.size)
    before, reached = np.zeros(steps.size + 1), np.ones(steps.size + 1)
    for step in range(steps.size):
        place = steps[step]
        own = chances[place]
        lost[step] = own[0] * died[0] + own[1] * died[1]
        spared[step] = own[0] * survived[0] + own[1] * survived[1]
        if spared[step] > 0.0:
            own[0] *= survived[0] / spared[step]
            own[1] *= survived[1] / spared[step]
        before[step + 1] = before[step] + reached[step] * lost_at[step] * lost[step]
        reached[step + 1] = reached[step] * spared[step]
        first[place], last[place] = min(first[place], step), step
    after = np.zeros(steps.size + 1)
    for step in range(steps.size - 1, -1, -1):
        after[step] = lost_at[step] * lost[step] + spared[step] * after[step + 1]
    for place in range(size):
        for hazard in range(2):
            rest = after[last[place] + 1]
            for step in range(last[place], first[place] - 1, -1):
                if steps[step] == place:
                    rest = lost_at[step] * died[hazard] + survived[hazard] * rest
                else:
                    rest = lost_at[step] * lost[step] + spared[step] * rest
            likelihood[place, hazard] = before[first[place]] + reached[first[place]] * rest
    return float(before[steps.size])


@inlined
def send(
    graph: FactorGraph,
    state: MessageState,
    factor: int,
    before: NDArray[np.float64],
    loss: NDArray[np.float64],
    likelihood: NDArray[np.float64],
) -> None:
    r"""
    Send the messages of one factor again.

    Equations :eq:`loss-message` and :eq:`loss-evidence`. The message to cell i, in log odds, is

    .. math::

        \mu_{a \to i} = \ln \Bigl( 1 - s_1^{n_{ai}} \prod_{k \ne i} S_{k \setminus a} \Bigr)
        - \ln \Bigl( 1 - s_0^{n_{ai}} \prod_{k \ne i} S_{k \setminus a} \Bigr),

    over the other cells k of the factor, with the survival :math:`S_{k \setminus a}` from the log
    odds that cell k sent less the message of this factor. Where it is known how well each step
    fits, the chances of the loss are those of `weigh_steps`.

    Parameters
    ----------
    graph : FactorGraph
        All factors.
    state : MessageState
        What was sent; changed.
    factor : int
        Which one sends.
    before, loss, likelihood : ndarray
        Room to work in, as in `weigh_visits`.

    """
    start, size = graph.first[factor], graph.first[factor + 1] - graph.first[factor]
    if graph.first_step[factor] == graph.first_step[factor + 1]:
        total = weigh_visits(graph, state, factor, before, loss, likelihood)
    else:
        total = weigh_steps(graph, state, factor, likelihood)
    log_lost = math.log(max(total, SMALLEST))
    term = log_lost
    for place in range(size - 1, -1, -1):
        entry = start + place
        safe = math.log(max(likelihood[place, 0], SMALLEST))
        hazardous = math.log(max(likelihood[place, 1], SMALLEST))
        message = hazardous - safe
        state.message_sums[graph.node[entry]] += graph.copies[factor] * (
            message - state.messages[entry]
        )
        state.messages[entry] = message
        # The mean over Z_i of exp(Z_i * message), without the factor's own message.
        term -= log_lost - safe
    state.evidence[0] += graph.copies[factor] * (term - state.terms[factor])
    state.terms[factor] = term


@compiled
def propagate(
    graph: FactorGraph,
    state: MessageState,
    first_silent: int,
    odds: NDArray[np.float64],
    destroyed: NDArray[np.float64],
    tolerance: float,
    rounds: int,
) -> int:
    """
    Send messages in rounds until no cell has anything new to tell its factors.

    A cell moves what it sends all the way to its log odds, and half as far each time it has to
    turn back: all the way would swing between two answers for good where many losses share cells.

    Parameters
    ----------
    graph : FactorGraph
        All factors.
    state : MessageState
        What was sent before; changed.
    first_silent : int
        The first factor that has sent nothing yet.
    odds : ndarray, shape (cells,)
        Log odds of each hazard without the losses; may be infinite.
    destroyed : ndarray, shape (2,)
        1 - s_z of one visit, by which it is judged what is worth telling.
    tolerance : float
        The relative change of a cell's chance to destroy in one visit that is sent.
    rounds : int
        At most so many.

    Returns
    -------
    int
        How many times a factor sent.

    """
    cells, factors = len(odds), len(graph.copies)
    before, loss = np.empty(graph.longest + 1), np.empty(graph.longest + 1)
    likelihood = np.empty((graph.longest + 1, 2))
    step, direction = np.ones(cells), np.zeros(cells)
    queue, is_queued = np.empty(factors, dtype=np.int64), np.zeros(factors, dtype=np.bool_)
    for factor in range(first_silent, factors):
        send(graph, state, factor, before, loss, likelihood)
    times = factors - first_silent
    for _ in range(rounds):
        queued = 0
        for cell in range(cells):
            total = odds[cell] + state.message_sums[cell]
            if total == state.sent_odds[cell]:
                continue
            now = destroyed[0] + chance(total) * (destroyed[1] - destroyed[0])
            known = destroyed[0] + chance(state.sent_odds[cell]) * (destroyed[1] - destroyed[0])
            if math.isinf(total):
                state.sent_odds[cell] = total
            elif abs(now - known) > max(tolerance * max(now, known), NEGLIGIBLE):
                ahead = total - state.sent_odds[cell]
                if ahead * direction[cell] < 0.0:
                    step[cell] *= 0.5
                direction[cell] = 1.0 if ahead > 0.0 else -1.0
                state.sent_odds[cell] += step[cell] * ahead
            else:
                continue
            entry = graph.newest[cell]
            while entry >= 0:
                factor = graph.factor[entry]
                if not is_queued[factor]:
                    is_queued[factor] = True
                    queue[queued] = factor
                    queued += 1
                entry = graph.older[entry]
        if queued == 0:
            break
        for place in range(queued):
            is_queued[queue[place]] = False
            send(graph, state, queue[place], before, loss, likelihood)
        times += queued
    return times
