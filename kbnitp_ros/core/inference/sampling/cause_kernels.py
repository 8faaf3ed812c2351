# SPDX-License-Identifier: Apache-2.0
"""Sweeps over the causes of losses, with the hazards of all cells summed out in time."""

from __future__ import annotations

from math import inf, log
from typing import NamedTuple

from kbnitp_ros.core.field import compiled
import numpy as np
from numpy.typing import NDArray


class Flights(NamedTuple):
    """
    All deployments in their order, and what each did to the cells that may have a hazard.

    Attributes
    ----------
    first_entry : ndarray of int, shape (deployments + 1,)
        Deployment t visits the cells ``cell[first_entry[t]:first_entry[t + 1]]``.
    cell, time, visits : ndarray of int, shape (entries,)
        Such a cell, which deployment it is of, and its visits on the whole path.
    first_of_cell : ndarray of int, shape (cells + 1,)
        The entries of cell c are ``of_cell[first_of_cell[c]:first_of_cell[c + 1]]``, in order.
    of_cell : ndarray of int, shape (entries,)
    first_step : ndarray of int, shape (deployments + 1,)
        The steps of a lost robot are ``first_step[t]`` to ``first_step[t + 1]``; of one that
        returned there are none.
    entry : ndarray of int, shape (steps,)
        Which entry a step leads to, -1 where no hazard may be.
    weight : ndarray, shape (steps,)
        How well what is known fits a loss in the step, times the chance of no malfunction before.
    remains, spent : ndarray, shape (deployments,)
        Chances of a visit to a hazard without malfunction that the robot survives and the hazard
        stays, and that it survives and the hazard is gone.
    failed, struck : ndarray, shape (deployments,)
        Chances of a step that the robot fails, and that a hazard destroys it.
    lost : ndarray of int, shape (losses,)
        Which deployments ended with a loss.

    """

    first_entry: NDArray[np.intp]
    cell: NDArray[np.intp]
    time: NDArray[np.intp]
    visits: NDArray[np.intp]
    first_of_cell: NDArray[np.intp]
    of_cell: NDArray[np.intp]
    first_step: NDArray[np.intp]
    entry: NDArray[np.intp]
    weight: NDArray[np.float64]
    remains: NDArray[np.float64]
    spent: NDArray[np.float64]
    failed: NDArray[np.float64]
    struck: NDArray[np.float64]
    lost: NDArray[np.intp]


class Change(NamedTuple):
    """
    What becomes of a hazard.

    Attributes
    ----------
    appear, vanish : float
        Its rates between deployments.
    after_strike : int
        Whether it is there after it destroyed a robot, 0 or 1.

    """

    appear: float
    vanish: float
    after_strike: int


class Events(NamedTuple):
    """
    What happened in each entry by the causes of one chain; kernels change it.

    Attributes
    ----------
    made : ndarray of int, shape (entries,)
        The visits that the robot survived.
    hit : ndarray of int, shape (entries,)
        1 where the hazard then destroyed the robot, else 0.

    """

    made: NDArray[np.intp]
    hit: NDArray[np.int8]


class CauseRoom(NamedTuple):
    """
    Room to draw the cause of a loss in.

    Attributes
    ----------
    now : ndarray, shape (entries, 2)
        P(Z) before the step, given the past.
    chance : ndarray, shape (entries,)
        Of what comes after.
    share : ndarray, shape (2 * most steps,)
        Of each cause, up to a factor.

    """

    now: NDArray[np.float64]
    chance: NDArray[np.float64]
    share: NDArray[np.float64]


class CellRoom(NamedTuple):
    """
    Room to find the likelihood of cells in.

    Attributes
    ----------
    joint : ndarray, shape (2, 2)
        P(Z, X) of one.
    seen_in, search : ndarray of int, shapes (cells,) and (1,)
        The search that each was seen in last, and how many searches there were.

    """

    joint: NDArray[np.float64]
    seen_in: NDArray[np.intp]
    search: NDArray[np.intp]


@compiled
def set_cause(flights: Flights, loss: int, cause: int, events: Events) -> None:
    """Note the visits that a lost robot made, and where it was struck, for one cause."""
    t = flights.lost[loss]
    for e in range(flights.first_entry[t], flights.first_entry[t + 1]):
        events.made[e] = 0
        events.hit[e] = 0
    if cause < 0:
        return
    start = flights.first_step[t]
    for step in range(start, start + cause // 2):
        if flights.entry[step] >= 0:
            events.made[flights.entry[step]] += 1
    if cause % 2 == 1:
        events.hit[flights.entry[start + cause // 2]] = 1


@compiled
def move_on(change: Change, times: int, state: NDArray[np.float64]) -> None:
    """Have P(Z, X) of a cell, shape (2, 2), change so many times."""
    if change.appear == 0.0 and change.vanish == 0.0:
        return
    for _ in range(times):
        for x in range(2):
            there, free = state[1, x], state[0, x]
            state[1, x] = there * (1.0 - change.vanish) + free * change.appear
            state[0, x] = free * (1.0 - change.appear) + there * change.vanish


@compiled
def visit(
    flights: Flights, change: Change, events: Events, e: int, state: NDArray[np.float64]
) -> float:
    """Have visits move P(Z, X) of a cell, shape (2, 2), and return their chance."""
    t = flights.time[e]
    total = 0.0
    for x in range(2):
        for _ in range(events.made[e]):
            state[0, x] += state[1, x] * flights.spent[t]
            state[1, x] *= flights.remains[t]
        if events.hit[e] == 1:
            struck = state[1, x]
            state[0, x] = 0.0
            state[1, x] = 0.0
            state[change.after_strike, x] = struck
        total += state[0, x] + state[1, x]
    if total > 0.0:
        for x in range(2):
            state[0, x] /= total
            state[1, x] /= total
    return total


@compiled
def look_back(
    flights: Flights,
    change: Change,
    last: int,
    events: Events,
    ahead: NDArray[np.float64],
    later: NDArray[np.float64],
    since: NDArray[np.intp],
) -> None:
    """Find what comes after each entry makes of Z, `ahead` of shape (entries, 2)."""
    later[:] = 1.0
    since[:] = last
    for e in range(flights.cell.size - 1, -1, -1):
        c, t = flights.cell[e], flights.time[e]
        b = later[c]
        if change.appear > 0.0 or change.vanish > 0.0:
            for _ in range(since[c] - t):
                free = (1.0 - change.appear) * b[0] + change.appear * b[1]
                b[1] = change.vanish * b[0] + (1.0 - change.vanish) * b[1]
                b[0] = free
        since[c] = t
        ahead[e, 0] = b[0]
        ahead[e, 1] = b[1]
        if events.hit[e] == 1:
            b[1] = b[change.after_strike]
            b[0] = 0.0
        for _ in range(events.made[e]):
            b[1] = flights.spent[t] * b[0] + flights.remains[t] * b[1]
        most = max(b[0], b[1])
        if most > 0.0:
            b[0] /= most
            b[1] /= most


@compiled
def draw_cause(
    flights: Flights,
    change: Change,
    t: int,
    state: NDArray[np.float64],
    ahead: NDArray[np.float64],
    uniform: float,
    room: CauseRoom,
) -> int:
    """Draw the cause of a loss given all others; -1 if none explains it."""
    now, chance, share = room.now, room.chance, room.share
    # Of the chances above 0, to what it was before the first step; and how many chances are 0.
    product, impossible = 1.0, 0
    for e in range(flights.first_entry[t], flights.first_entry[t + 1]):
        c = flights.cell[e]
        now[e, 0] = state[c, 0, 0] + state[c, 0, 1]
        now[e, 1] = state[c, 1, 0] + state[c, 1, 1]
        chance[e] = now[e, 0] * ahead[e, 0] + now[e, 1] * ahead[e, 1]
        if chance[e] <= 0.0:
            impossible += 1
    start = flights.first_step[t]
    steps = flights.first_step[t + 1] - start
    whole = 0.0
    for k in range(steps):
        e, weight = flights.entry[start + k], flights.weight[start + k]
        share[2 * k] = weight * flights.failed[t] * product if impossible == 0 else 0.0
        share[2 * k + 1] = 0.0
        if e >= 0:
            if chance[e] > 0.0:
                product /= chance[e]
            else:
                impossible -= 1
            if impossible == 0:
                struck = now[e, 1] * ahead[e, change.after_strike] * flights.struck[t]
                share[2 * k + 1] = weight * struck * product
            now[e, 0] += now[e, 1] * flights.spent[t]
            now[e, 1] *= flights.remains[t]
            chance[e] = now[e, 0] * ahead[e, 0] + now[e, 1] * ahead[e, 1]
            if chance[e] > 0.0:
                product *= chance[e]
            else:
                impossible += 1
        whole += share[2 * k] + share[2 * k + 1]
        if whole == 0.0:
            # On a long path the product would be 0 before the first step that can be the cause.
            product = 1.0
    drawn, below, cause = uniform * whole, 0.0, -1
    for each in range(2 * steps):
        if share[each] > 0.0:
            cause = each
            below += share[each]
            if drawn < below:
                break
    return cause


@compiled
def cell_log_likelihood(
    flights: Flights,
    change: Change,
    c: int,
    events: Events,
    before: NDArray[np.float64],
    joint: NDArray[np.float64],
) -> float:
    """Return the log likelihood of all that happened in a cell; `joint` is room, (2, 2)."""
    for z in range(2):
        for x in range(2):
            joint[z, x] = before[c, z, x]
    since, total = 0, 0.0
    for place in range(flights.first_of_cell[c], flights.first_of_cell[c + 1]):
        e = flights.of_cell[place]
        move_on(change, flights.time[e] - since, joint)
        since = flights.time[e]
        chance = visit(flights, change, events, e, joint)
        if chance <= 0.0:
            return -inf
        total += log(chance)
    return total


@compiled
def steps_log_likelihood(
    flights: Flights,
    change: Change,
    spans: tuple[tuple[int, int], tuple[int, int]],
    events: Events,
    before: NDArray[np.float64],
    room: CellRoom,
) -> float:
    """Return the log likelihood of all cells that the steps of two spans lead to."""
    room.search[0] += 1
    total = 0.0
    for start, end in spans:
        for step in range(start, end):
            if flights.entry[step] < 0:
                continue
            c = flights.cell[flights.entry[step]]
            if room.seen_in[c] != room.search[0]:
                room.seen_in[c] = room.search[0]
                total += cell_log_likelihood(flights, change, c, events, before, room.joint)
                if total == -inf:
                    return total
    return total


@compiled
def step_into(flights: Flights, loss: int, c: int, uniform: float) -> tuple[int, int]:
    """Draw a step of a lost robot into a cell; return it and how many there are."""
    t = flights.lost[loss]
    start, end = flights.first_step[t], flights.first_step[t + 1]
    count = 0
    for step in range(start, end):
        e = flights.entry[step]
        if e >= 0 and flights.cell[e] == c and flights.weight[step] > 0.0:
            count += 1
    if count == 0:
        return -1, 0
    which = min(int(uniform * count), count - 1)
    for step in range(start, end):
        e = flights.entry[step]
        if e >= 0 and flights.cell[e] == c and flights.weight[step] > 0.0:
            if which == 0:
                return step - start, count
            which -= 1
    return -1, 0


@compiled
def exchange(
    flights: Flights,
    change: Change,
    causes: NDArray[np.intp],
    uniforms: NDArray[np.float64],
    events: Events,
    before: NDArray[np.float64],
    room: CellRoom,
) -> None:
    """Propose that two losses exchange the hazards that caused them (Metropolis-Hastings)."""
    losses = flights.lost.size
    one = min(int(uniforms[0] * losses), losses - 1)
    other = min(int(uniforms[1] * losses), losses - 1)
    if one == other or causes[one] % 2 != 1 or causes[other] % 2 != 1:
        return
    first = flights.first_step[flights.lost[one]]
    second = flights.first_step[flights.lost[other]]
    here = flights.cell[flights.entry[first + causes[one] // 2]]
    there = flights.cell[flights.entry[second + causes[other] // 2]]
    if here == there:
        return
    to, ways_to = step_into(flights, one, there, uniforms[2])
    back, ways_back = step_into(flights, other, here, uniforms[3])
    if ways_to == 0 or ways_back == 0:
        return
    _, from_here = step_into(flights, one, here, 0.0)
    _, from_there = step_into(flights, other, there, 0.0)
    was, was_other = causes[one], causes[other]
    # Before and after the two steps of each loss, its cause changes nothing in the cells.
    step, step_other = was // 2, was_other // 2
    spans = (
        (first + min(step, to), first + max(step, to) + 1),
        (second + min(step_other, back), second + max(step_other, back) + 1),
    )
    old = steps_log_likelihood(flights, change, spans, events, before, room)
    set_cause(flights, one, 2 * to + 1, events)
    set_cause(flights, other, 2 * back + 1, events)
    new = steps_log_likelihood(flights, change, spans, events, before, room)
    is_taken = False
    if new > -inf:
        ratio = flights.weight[first + to] * flights.weight[second + back]
        ratio *= ways_to * ways_back
        by = flights.weight[first + step] * flights.weight[second + step_other]
        by *= from_here * from_there
        is_taken = log(1.0 - uniforms[4]) < new - old + log(ratio) - log(by)
    if is_taken:
        causes[one] = 2 * to + 1
        causes[other] = 2 * back + 1
    else:
        set_cause(flights, one, was, events)
        set_cause(flights, other, was_other, events)


@compiled
def sweep(
    flights: Flights,
    change: Change,
    before: NDArray[np.float64],
    causes: NDArray[np.intp],
    drawn_from: int,
    uniforms: NDArray[np.float64],
    exchanges: NDArray[np.float64],
    joints: NDArray[np.float64],
) -> bool:
    """
    Draw the causes of losses in all chains once, and add up the cells' joints.

    Parameters
    ----------
    flights, change
        The evidence, and what becomes of hazards.
    before : ndarray, shape (cells, 2, 2)
        The cells' joints before the first deployment, given all readings.
    causes : ndarray of int, shape (chains, losses)
        Twice the step of each loss, and 1 more if a hazard struck; -1: yet to be drawn. Changed.
    drawn_from : int
        The first deployment whose cause is drawn.
    uniforms : ndarray, shape (chains, losses)
        That they are drawn by.
    exchanges : ndarray, shape (chains, proposals, 5)
        That exchanges are proposed and taken by.
    joints : ndarray, shape (chains, cells, 2, 2)
        Added to.

    Returns
    -------
    bool
        Whether each chain explains each loss.

    """
    entries, cells, flown = flights.cell.size, before.shape[0], flights.failed.size
    longest = 1
    for t in range(flown):
        longest = max(longest, flights.first_step[t + 1] - flights.first_step[t])
    events = Events(flights.visits.copy(), np.zeros(entries, np.int8))
    of_cause = CauseRoom(np.empty((entries, 2)), np.empty(entries), np.empty(2 * longest))
    of_cells = CellRoom(np.empty((2, 2)), np.zeros(cells, np.intp), np.zeros(1, np.intp))
    ahead, later = np.empty((entries, 2)), np.empty((cells, 2))
    state, since = np.empty((cells, 2, 2)), np.empty(cells, np.intp)
    is_explained = True
    for chain in range(causes.shape[0]):
        for loss in range(flights.lost.size):
            set_cause(flights, loss, causes[chain, loss], events)
        look_back(flights, change, flown - 1, events, ahead, later, since)
        state[:] = before
        since[:] = 0
        loss = 0
        for t in range(flown):
            for e in range(flights.first_entry[t], flights.first_entry[t + 1]):
                c = flights.cell[e]
                move_on(change, t - since[c], state[c])
                since[c] = t
            if flights.first_step[t + 1] > flights.first_step[t]:
                if t >= drawn_from:
                    uniform = uniforms[chain, loss]
                    cause = draw_cause(flights, change, t, state, ahead, uniform, of_cause)
                    if cause < 0:
                        is_explained = False
                    else:
                        causes[chain, loss] = cause
                    set_cause(flights, loss, causes[chain, loss], events)
                loss += 1
            for e in range(flights.first_entry[t], flights.first_entry[t + 1]):
                visit(flights, change, events, e, state[flights.cell[e]])
        for c in range(cells):
            move_on(change, flown - 1 - since[c], state[c])
            total = 0.0
            for z in range(2):
                for x in range(2):
                    total += state[c, z, x]
            if total > 0.0:
                for z in range(2):
                    for x in range(2):
                        joints[chain, c, z, x] += state[c, z, x] / total
            else:
                is_explained = False
        if drawn_from == 0 and flights.lost.size > 1:
            for numbers in exchanges[chain]:
                exchange(flights, change, causes[chain], numbers, events, before, of_cells)
    return is_explained
