# SPDX-License-Identifier: Apache-2.0
"""Label search: extend the best partial paths, then rank the best closed paths."""

from __future__ import annotations

from functools import lru_cache
from math import inf

from kbnitp_ros.core.field.grid import Grid, longest
from kbnitp_ros.core.field.sensor import log_predicted_survival, powers, times_log
from kbnitp_ros.core.planning.information import Candidate, DECIMALS
from kbnitp_ros.core.planning.label_kernels import (
    exact_values,
    Floats,
    Gains,
    LabelProblem,
    moment_gains,
    Places,
    Reach,
    search,
    trace_closed,
)
from kbnitp_ros.core.planning.objective import (
    BEHAVIORAL_EXPONENTS,
    camera_rates,
    EXPONENTS,
    new_information,
    Objective,
    possible_readings,
    powers_weights,
)
from kbnitp_ros.core.planning.options import SearchOptions, SHANNON
import numpy as np
from numpy.typing import NDArray


# Cached, since a mission plans for the same few bases again and again.
@lru_cache(maxsize=8)
def find_reach(grid: Grid, max_steps: int, max_distance: float = 0.0) -> Reach:
    """Return the reach of paths within `max_steps` and `max_distance`."""
    cells = np.flatnonzero(grid.in_reach(max_steps, max_distance))
    distance = grid.steps_to_base[cells]
    order = np.argsort(distance, kind='stable')
    cells = cells[order]
    rank = np.full(grid.cells + 1, -1)
    rank[cells] = np.arange(cells.size)
    step = np.arange(max_steps + 1)
    within = np.searchsorted(distance[order], np.minimum(step, max_steps - step), 'right')
    start = np.append(0, np.cumsum(within))
    neighbors = rank[grid.neighbor_table[cells]]
    if not max_distance:
        # Without a limit all lengths are 0.
        lengths, home = np.zeros(9), np.zeros(cells.size)
        return Reach(cells, neighbors, within, start, lengths, home, 0.0)
    return Reach(
        cells,
        neighbors,
        within,
        start,
        grid.step_lengths.copy(),
        grid.distance_to_base[cells],
        longest(max_distance),
    )


def visit_gains(objective: Objective, cells: NDArray[np.intp], max_visits: int) -> Gains:
    """Return the gains of visits in `cells`, shape (n,)."""
    model, outcomes, alpha = objective.model, objective.outcomes, objective.alpha
    visits = np.arange(max_visits + 1)
    belief, hazard = objective.belief, objective.belief.hazard[cells]
    log_survival = log_predicted_survival(hazard[:, None], visits, model.log_survival)
    log_survival = log_survival[None].repeat(outcomes.probability.size, 0)
    readings = possible_readings(model, max_visits, outcomes.most_readings)
    nothing_read = np.zeros((cells.size, outcomes.states))
    nothing_read[:, 0] = 1.0
    read = np.zeros(log_survival.shape)
    read[..., 1:] = new_information(readings, belief.joint[cells], nothing_read, alpha)
    here, there = outcomes.find_places(cells)
    if here.size:
        joint = outcomes.joint[:, there]
        log_survival[:, here] = log_predicted_survival(
            joint[:, :, 1].sum(axis=-1).clip(max=1.0)[..., None], visits, model.log_survival
        )
        _, earlier = outcomes.of_cells(cells[here])
        read[:, here, 1:] = new_information(readings, joint, earlier, alpha)

    alive = log_survival[..., 1:] > -np.inf
    with np.errstate(invalid='ignore'):
        # Once survival is impossible, a visit changes nothing.
        log_ratio = np.where(alive, np.diff(log_survival), 0.0)
    added = np.diff(read) * objective.interest[cells, None]
    survival = (np.exp(log_ratio) * alive).transpose(1, 2, 0)
    of_model = _powers(*model.log_survival.tolist(), max_visits, alpha == SHANNON)
    moment, spread = moment_gains(hazard, *of_model)
    if alpha == SHANNON:
        added -= log_ratio
        factor = [moment, survival]
    else:
        spread = np.zeros_like(spread)
        powers = survival[..., None] ** BEHAVIORAL_EXPONENTS
        factor = [moment, powers.reshape(*survival.shape[:2], -1), survival]
    term = [spread[..., None], added.transpose(1, 2, 0)]
    return Gains(*(np.ascontiguousarray(np.concatenate(g, axis=-1)) for g in (factor, term)))


@lru_cache(maxsize=64)
def _powers(
    safe: float, deadly: float, max_visits: int, is_shannon: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the powers of s_z^n, (2, max_visits + 1, powers), and s_z^n log s_z^n."""
    log_power, _, _ = powers(safe, deadly, max_visits)
    exponents = EXPONENTS if is_shannon else BEHAVIORAL_EXPONENTS
    power = np.exp(times_log(exponents, log_power[..., None]))
    # The first exponent is 1: power[..., 0] is s_z^n.
    return power, times_log(power[..., 0], log_power)


# Minimum number of closed paths ranked by exact value; twice `width` if that is more.
MIN_RANKED = 8

# Maximum bytes of a search.
MAX_MEMORY = 1 << 30


def best_paths(
    grid: Grid, objective: Objective, options: SearchOptions, width: int
) -> list[Candidate]:
    """Search for closed paths of high value; return them best first."""
    labels = LabelSearch(grid, objective, options, width)
    values, paths, steps = labels.ranked(*labels.closed(max(2 * width, MIN_RANKED)))
    return [
        Candidate(value, labels.reach.cells[path[: count + 1]])
        for value, path, count in zip(values.tolist(), paths, steps)
    ]


class LabelSearch:
    """A label search; arguments as in `best_paths`."""

    def __init__(
        self, grid: Grid, objective: Objective, options: SearchOptions, width: int
    ) -> None:
        max_steps = options.max_steps
        max_visits = min(options.max_visits, max_steps)
        self._objective, self._width = objective, max(1, width // 4)
        outcomes = objective.outcomes.probability
        self.reach = find_reach(grid, max_steps, options.max_distance)
        earlier = objective.outcomes.states
        # Number of states of readings after one more robot's visits.
        own = dict(objective.outcomes.most_readings).get(camera_rates(objective.model), 0) + 1
        further = earlier // own * (own + max_visits)
        weights = powers_weights(objective.alpha, outcomes)
        powers = weights.size
        check_memory(self.reach, options, width, outcomes.size, earlier, further, powers)
        gains = visit_gains(objective, self.reach.cells, max_visits)
        self.problem = LabelProblem(
            self.reach,
            scattered(self.reach.cells.size, 62 - max_steps.bit_length()),
            gains,
            weights,
            outcomes,
            objective.loss_cost,
            10.0**DECIMALS,
            # Only a search that keeps several labels of a cell drops labels by this bound.
            unread_after(gains, powers, max_steps) if self._width > 1 else np.zeros(max_steps + 1),
        )

    def closed(self, count: int) -> tuple[Places, Places]:
        """Return the best `count` paths and steps; a beam adds the best path of width 1."""
        problem, rows = self.problem, self.reach.start[-1]
        completions = np.empty((rows if self._width > 1 else 0, problem.weight.size + 5))
        paths, steps = self._traced(*search(problem, 1, 0, -inf, completions), count)
        if self._width == 1:
            return paths, steps
        # The bound on continuations of a label does not apply to behavioral entropies.
        least = -inf
        if self._objective.alpha == SHANNON:
            least = self.exact(paths[:1], steps[:1])[0] * problem.units - 1.0
        found = search(problem, self._width, self._width // 2, least, completions)
        more, more_steps = self._traced(*found, count)
        return np.concatenate([more, paths[:1]]), np.concatenate([more_steps, steps[:1]])

    def _traced(
        self, origins: NDArray[np.int32], values: Floats, count: int
    ) -> tuple[Places, Places]:
        """Return the paths and steps of the best `count` labels that end at the base."""
        best = np.argsort(-values, axis=None, kind='stable')[:count]
        steps, slots = np.divmod(best[values.flat[best] > -inf], values.shape[1])
        paths = np.zeros((steps.size, self.reach.within.size), dtype=np.intp)
        trace_closed(self.reach, origins, steps, slots, paths)
        return paths, steps

    def ranked(self, paths: Places, steps: Places) -> tuple[Floats, Places, Places]:
        """Return values, paths and steps, best first, with one path for equal visits."""
        is_visit = np.arange(paths.shape[1]) <= steps[:, None]
        is_visit[:, 0] = False
        marks = (self.problem.marks[paths] * is_visit).sum(axis=1).tolist()
        first = sorted({mark: row for row, mark in reversed([*enumerate(marks)])}.values())
        paths, steps = paths[first], steps[first]
        values = self.exact(paths, steps)
        order = np.lexsort((steps, -values))
        return values[order], paths[order], steps[order]

    def exact(self, paths: Places, steps: Places) -> Floats:
        """Return the exact values of closed paths, rounded."""
        objective, cells = self._objective, self.reach.cells
        if objective.alpha != SHANNON:
            each = (cells[path[: count + 1]] for path, count in zip(paths, steps))
            return np.array([Candidate.along(path, objective).value for path in each])
        values = exact_values(
            self.problem,
            paths,
            steps,
            objective.belief.hazard[cells],
            *objective.model.log_survival,
        )
        return values.round(DECIMALS)


def unread_after(gains: Gains, powers: int, max_steps: int) -> Floats:
    """Return an upper bound on readings' information in the remaining steps (:eq:`unread`)."""
    survival = gains.factor[..., powers:]
    with np.errstate(divide='ignore', invalid='ignore'):
        risk = -np.log(survival)
        read = np.where(survival > 0.0, gains.term[..., 1:] - risk, 0.0)
    read, risk = read.max(axis=-1).ravel(), risk.min(axis=-1).ravel()
    read, risk = read[read > 0.0], risk[read > 0.0].clip(min=1e-300)
    order = np.argsort(-read / risk)
    survived = np.exp(-np.append(0.0, risk[order].cumsum()[:-1]))[: read.size]
    by_ratio = read[order].cumsum()
    by_size = np.append(0.0, np.sort(read)[::-1].cumsum())
    left = np.minimum(np.arange(max_steps, -1, -1), read.size)
    bounds = [(np.minimum(by_ratio, most) * survived).max(initial=0.0) for most in by_size[left]]
    return np.array(bounds)


def check_memory(
    reach: Reach,
    options: SearchOptions,
    width: int,
    outcomes: int,
    earlier: int,
    further: int,
    powers: int,
) -> None:
    """Check that a search fits in memory."""
    number = 8
    max_steps, max_visits = options.max_steps, options.max_visits
    visits, rows = min(max_visits, max_steps), max(1, width // 4)
    labels, cells = int(reach.start[-1]), reach.cells.size
    factors_and_terms = powers + 1 + 2 * outcomes
    estimate = (
        # The origin of each label, and the completions if labels are kept by a heuristic.
        labels * (4 * rows + (number * (powers + 5) if rows > 1 else 0))
        # The labels of two steps, with their hashes and the visits to neighbours.
        + 2 * int(reach.within.max()) * rows * (number * (factors_and_terms + 2) + 4 * 9)
        # The gains and the likelihoods of readings during their computation.
        + 3 * number * cells * visits * factors_and_terms
        + 10 * number * further**2
        # The joint outcomes of robots sent before.
        + 2 * number * outcomes * cells * (earlier + 4)
    )
    if estimate > MAX_MEMORY:
        raise ValueError(
            f'planning with max_steps = {max_steps}, a beam width of {width} and max_visits = '
            f'{max_visits} takes about {estimate / 1e9:.1f} GB, and {MAX_MEMORY / 1e9:.1f} GB '
            'are allowed: lower one of them'
        )


@lru_cache(maxsize=8)
def scattered(cells: int, bits: int) -> NDArray[np.int64]:
    """Return a random hash for each cell, whose sums identify visits (splitmix)."""
    x = np.arange(1, cells + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((x ^ (x >> np.uint64(31))) >> np.uint64(64 - bits)).astype(np.int64)
