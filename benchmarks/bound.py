# SPDX-License-Identifier: Apache-2.0
"""
Bound the value of every path, by a Lagrangian dual with cuts.

``python3 benchmarks/bound.py`` prints by how much any path may exceed a plan of ``beam`` on the
frozen beliefs of ``study benchmark``.

The derivation is in docs/mathematics: the value of a path, :eq:`bound-value`, is at most a
function of three sums over its cells, :eq:`bound-path`; Lagrangian multipliers cut off sums that
no closed walk has, :eq:`bound-cut`; the function is maximised over the remaining sums,
:eq:`bound-maximum`.

Cells are numbered by rank in `Reach`: the base has rank 0, and the cells within t steps of it come
first, for every t. The multipliers of equation :eq:`bound-cut` are one array of shape (cells +
2,): the price of a visit to each cell, then lambda and mu. A point is a survival P = exp(-r) and
the ratio r2 / r, in [1, 2].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, inf, log
from typing import Any, NamedTuple

from kbnitp_ros.core import Belief, Candidate, Grid, plan, SearchOptions, SensorModel
from kbnitp_ros.core.field.compiled import compiled
from kbnitp_ros.core.field.sensor import log_predicted_survival, times_log
from kbnitp_ros.core.planning.label_kernels import Floats, Places, surprisal
from kbnitp_ros.core.planning.labels import find_reach
from kbnitp_ros.core.planning.objective import Objective
import numpy as np

# Maximum number of cuts, in addition to one for each number of steps, and maximum number of
# successive cuts that lower the bound by less than the tolerance.
MAX_CUTS = 60
MAX_STALLED = 6

# Tolerance of the bound: relative to the value, and at least this many nats.
TOLERANCE = 2e-4
MIN_TOLERANCE = 1e-6

# Margins for rounding: absolute in nats, and relative to the loss cost.
ROUNDING = 1e-9
ROUNDING_OF_COST = 1e-13

# Below this survival a path's information rounds to 0.
MIN_SURVIVAL = 1e-100

# Maximum number of boxes halved; at the limit the bound is valid but less tight.
MAX_BOXES = 20_000


class Walks(NamedTuple):
    """Closed walks from the base and their possible visits."""

    # Ranks of the cells one step away, -1 for none, shape (cells, 9).
    neighbors: Any
    # Number of cells within min(t, max_steps - t) steps of the base, shape (max_steps + 1,).
    within: Any
    # W, r and r2 by number of visits, shape (cells, visits + 1, 3).
    added: Any
    # Maximum visits of each cell, shape (cells,).
    most: Any


@compiled
def best_walk(
    walks: Walks, steps: int, multipliers: Any, value: Any, origin: Any, gradient: Any
) -> float:
    """Return the highest price of a closed walk, and write its visits (:eq:`bound-cut`)."""
    before = 1
    value[0, 0] = 0.0
    for t in range(1, steps + 1):
        now = walks.within[min(t, steps - t)]
        here, there = t % 2, (t - 1) % 2
        for cell in range(now):
            best, column = -inf, 0
            for k in range(9):
                via = walks.neighbors[cell, k]
                if 0 <= via < before and value[there, via] > best:
                    best, column = value[there, via], k
            value[here, cell] = best + multipliers[cell]
            origin[t, cell] = column
        before = now
    gradient[:] = 0.0
    cell = 0
    for t in range(steps, 0, -1):
        gradient[cell] += 1.0
        cell = walks.neighbors[cell, origin[t, cell]]
    greatest: float = value[steps % 2, 0]
    return greatest


@compiled
def best_visits(walks: Walks, multipliers: Any, gradient: Any) -> float:
    """Return the second maximum in :eq:`bound-cut`; subtract its visits from the gradient."""
    total, cells = 0.0, walks.most.size
    for cell in range(cells):
        best, count = -inf, 0
        for n in range(walks.most[cell] + 1):
            gain = walks.added[cell, n, 0] - n * multipliers[cell]
            gain -= multipliers[cells] * walks.added[cell, n, 1]
            gain -= multipliers[cells + 1] * walks.added[cell, n, 2]
            if gain > best:
                best, count = gain, n
        total += best
        gradient[cell] -= count
        gradient[cells] -= walks.added[cell, count, 1]
        gradient[cells + 1] -= walks.added[cell, count, 2]
    return total


@compiled
def minimise(
    walks: Walks, steps: int, multipliers: Any, r: float, r2: float, enough: float
) -> Any:
    """Lower the cut at (r, r2) by deflected subgradients; write the multipliers, return D."""
    cells = walks.most.size
    tried, direction = multipliers.copy(), np.zeros(cells + 2)
    walked, origin = np.empty((2, cells)), np.zeros((steps + 1, cells), np.int8)
    gradient = np.empty(cells + 2)
    best, reference, span, stalled = inf, inf, 0.0, 0
    for round_ in range(400):
        value = best_walk(walks, steps, tried, walked, origin, gradient)
        value += best_visits(walks, tried, gradient)
        value += tried[cells] * r + tried[cells + 1] * r2
        gradient[cells] += r
        gradient[cells + 1] += r2
        if round_ == 0:
            span = max(0.5 * (value - enough), 1e-3)
        if value < best:
            best = value
            multipliers[:] = tried
        if best <= enough:
            break
        stalled += 1
        if best < reference - 0.5 * span:
            reference, stalled = best, 0
        elif stalled > 12:
            span *= 0.5
            if span < 1e-5:
                break
            reference, stalled = best, 0
            tried[:] = multipliers
            direction[:] = 0.0
            continue
        along, old = 0.0, 0.0
        for k in range(cells + 2):
            along += gradient[k] * direction[k]
            old += direction[k] * direction[k]
        deflection = -1.5 * along / old if along < 0.0 else 0.0
        norm = 0.0
        for k in range(cells + 2):
            direction[k] = gradient[k] + deflection * direction[k]
            norm += direction[k] * direction[k]
        if norm == 0.0:
            break
        step = (value - max(enough, best - span)) / norm
        for k in range(cells + 2):
            tried[k] -= step * direction[k]
    return best - multipliers[cells] * r - multipliers[cells + 1] * r2


class Region(NamedTuple):
    """Limits on the sums W, r and r2 of paths with one number of steps (:eq:`bound-cut`)."""

    # Highest possible survival of these paths, q = s0^steps, and lowest allowed survival.
    safest: float
    least: float
    # Cost of a lost robot, nats.
    loss_cost: float
    # D, lambda and mu of equation :eq:`bound-cut`, shape (cuts, 3).
    cuts: Any


@compiled
def power(p: float, exponent: float) -> float:
    """Return p^exponent."""
    return exp(exponent * log(p)) if p > 0.0 else 0.0


@compiled
def greatest_sum(region: Region, survival: float, ratio: float) -> float:
    """Return the largest sum of W that the cuts allow at a point."""
    r, least = -log(survival), inf
    for k in range(region.cuts.shape[0]):
        slope = region.cuts[k, 1] + region.cuts[k, 2] * ratio
        least = min(least, region.cuts[k, 0] + slope * r)
    return least


@compiled
def touching_point(region: Region, survival: float, square: float) -> float:
    """Return p0 of equation :eq:`bound-touching`, at most 0.98 q; 0 if q < .01 or P >= q."""
    if region.safest < 0.01 or survival >= region.safest:
        return 0.0
    p0 = (region.safest * survival - square) / (region.safest - survival)
    return min(max(p0, 0.0), 0.98 * region.safest)


@compiled
def parabola(q: float, p0: float) -> Any:
    """Return the coefficients of 1, p and p^2 of equation :eq:`bound-parabola`."""
    if p0 == 0.0 and q < 0.01:
        # Series of the curvature for small q.
        return 0.0, -1.0, 0.5 + q * (1.0 / 6.0 + q * (1.0 / 12.0 + q * (1.0 / 20.0 + q / 29.0)))
    at, slope = -surprisal(1.0 - p0), -1.0 - log(1.0 - p0)
    curvature = -surprisal(1.0 - q) - at - slope * (q - p0)
    curvature /= (q - p0) * (q - p0)
    return at - (slope - curvature * p0) * p0, slope - 2.0 * curvature * p0, curvature


@compiled
def coin_entropy(p: float) -> float:
    """Return h(p)."""
    return surprisal(p) + surprisal(1.0 - p)


@compiled
def value_at(region: Region, survival: float, ratio: float) -> float:
    """Return the right side of equation :eq:`bound-path` for the largest sum of W at a point."""
    square = power(survival, ratio)
    c0, c1, c2 = parabola(region.safest, touching_point(region, survival, square))
    linear = greatest_sum(region, survival, ratio) + c1 + region.loss_cost
    value: float = coin_entropy(survival) + survival * linear + c0 + c2 * square
    return value - region.loss_cost


@compiled
def next_cut(region: Region, survival: float, ratio: float, total: float, value: float) -> Any:
    """Return lambda and mu of :eq:`bound-slopes`, and the sum of W at which `value` is reached."""
    square = power(survival, ratio)
    c0, c1, c2 = parabola(region.safest, touching_point(region, survival, square))
    of_r = log((1.0 - survival) / survival) + total + c1 + region.loss_cost
    of_r2 = c2 * square / survival
    rest = coin_entropy(survival) + c0 + c2 * square - region.loss_cost
    return of_r, of_r2, (value - rest) / survival - c1 - region.loss_cost


@compiled
def bound_of_box(
    region: Region, low: float, high: float, least: float, most: float, enough: float
) -> float:
    """Return the lowest of the cuts' bounds on `value_at` in a box (:eq:`bound-box`)."""
    middle = 0.5 * (low + high)
    lost, lost_slope = surprisal(1.0 - middle), log(1.0 - middle) + 1.0
    kept, kept_slope = surprisal(middle), -log(middle) - 1.0
    square = power(middle, 0.5 * (least + most))
    c0, c1, c2 = parabola(region.safest, touching_point(region, middle, square))
    bound = inf
    for k in range(region.cuts.shape[0]):
        of_cut = -inf
        for ratio in (least, most):
            factor = 1.0 + region.cuts[k, 1] + region.cuts[k, 2] * ratio
            for p in (low, high):
                if factor >= 0.0:
                    value = factor * (kept + kept_slope * (p - middle))
                else:
                    value = factor * surprisal(p)
                value += lost + lost_slope * (p - middle)
                value += (region.cuts[k, 0] + c1 + region.loss_cost) * p
                value += c0 + c2 * power(p, ratio) - region.loss_cost
                of_cut = max(of_cut, value)
        bound = min(bound, of_cut)
        if bound <= enough:
            break
    return bound


@compiled
def maximum(region: Region, known: float, tolerance: float, at: Any) -> float:
    """Return a bound of `value_at` over all points, by halving boxes (:eq:`bound-maximum`)."""
    boxes = np.empty((128, 4))
    boxes[0] = region.least, region.safest, 1.0, 2.0
    held, opened, found, bound = 1, 0, known, known
    while held > 0:
        held -= 1
        low, high, least, most = boxes[held]
        # E[p^2] <= q E[p]
        if 0.0 < low < 1.0 and (most - 1.0) * log(low) > log(region.safest) + 1e-12:
            continue
        opened += 1
        middle, ratio = 0.5 * (low + high), 0.5 * (least + most)
        value = value_at(region, middle, ratio)
        if value > found:
            found = value
            at[0], at[1] = middle, ratio
        of_box = bound_of_box(region, low, high, least, most, found + tolerance)
        small = high - low < 1e-12 * region.safest or held > boxes.shape[0] - 3
        if of_box <= found + tolerance or small or opened > MAX_BOXES:
            bound = max(bound, of_box)
        elif (high - low) / region.safest >= most - least:
            boxes[held] = low, middle, least, most
            boxes[held + 1] = middle, high, least, most
            held += 2
        else:
            boxes[held] = low, high, least, ratio
            boxes[held + 1] = low, high, ratio, most
            held += 2
    return bound


@dataclass(eq=False)
class Cuts:
    """The cuts of paths with one number of steps."""

    # Number of steps of each path.
    steps: int
    # Survival, ratio r2 / r and sum of W that the next cut excludes.
    point: tuple[float, float, float]
    # Multipliers of the last cut, shape (cells + 2,).
    multipliers: Floats
    # D, lambda and mu of each cut, as in `Region`, shape (cuts, 3).
    rows: Floats = field(default_factory=lambda: np.empty((0, 3)))
    # Upper bound on the value of each path, nats.
    bound: float = inf


def upper_bound(
    grid: Grid, belief: Belief, model: SensorModel, options: SearchOptions, path: Places
) -> float:
    """Return an upper bound on the value of any path, nats; the search starts at `path`."""
    if options.objective != 'information':
        raise ValueError(f'objective is {options.objective}: only information has a bound')
    objective = Objective.of(belief, model, options)
    loss_cost, value = objective.loss_cost, Candidate.along(path, objective).value
    tolerance = max(MIN_TOLERANCE, TOLERANCE * abs(value))
    slack = ROUNDING + ROUNDING_OF_COST * loss_cost
    log_safe = float(model.log_survival[0])
    if exp(log_safe) == 0.0:
        return value + slack
    reach, max_steps = find_reach(grid, options.max_steps, options.max_distance), options.max_steps
    visits = min(options.max_visits, max_steps)
    added, survivable = visit_sums(belief, model, reach.cells, visits)
    counts = np.bincount(path[1:], minlength=grid.cells)[reach.cells]
    w, r, r2 = added[np.arange(counts.size), counts].sum(axis=0)
    start = (inside(exp(-r)), r2 / r if r > 0.0 else 1.5, w)
    none = np.zeros(reach.cells.size + 2)
    lengths = [Cuts(steps, start, none.copy()) for steps in range(1, max_steps + 1)]

    def cut(paths: Cuts) -> None:
        """Add the lowest cut at the point, and bound the value over the remaining sums."""
        steps, (survival, ratio, total) = paths.steps, paths.point
        longest_stay = (steps - 2 * grid.steps_to_base[reach.cells] + 1).clip(min=0)
        longest_stay[0] = steps
        walks = Walks(reach.neighbors, reach.within, added, np.minimum(survivable, longest_stay))
        # Allow for rounding when survivals are compared.
        least = options.minimum_survival * (1.0 - 1e-12)
        region = Region(exp(steps * log_safe), least, loss_cost, paths.rows)
        if region.safest < least:
            paths.bound = -inf
            return
        if region.safest < MIN_SURVIVAL:
            paths.bound = -loss_cost
            return
        of_r, of_r2, enough = next_cut(region, survival, ratio, total, value)
        if not len(paths.rows):
            paths.multipliers[:-2] = added[:, 1] @ [1.0, -of_r, -of_r2]
        paths.multipliers[-2:] = of_r, of_r2
        r = -log(survival)
        d = minimise(walks, steps, paths.multipliers, r, ratio * r, enough)
        paths.rows = np.vstack([paths.rows, [d, *paths.multipliers[-2:]]])
        region = region._replace(cuts=paths.rows)
        at = np.array([survival, ratio])
        paths.bound = min(paths.bound, maximum(region, value, tolerance, at))
        survival, ratio = inside(at[0]), float(at[1])
        paths.point = survival, ratio, greatest_sum(region, survival, ratio)

    stalled = 0
    for _ in range(MAX_CUTS + max_steps):
        highest = max(lengths, key=lambda paths: paths.bound)
        before = highest.bound
        if before <= value + tolerance or stalled == MAX_STALLED:
            break
        cut(highest)
        stalled = stalled + 1 if highest.bound > before - tolerance else 0
    return max([value, *(paths.bound for paths in lengths)]) + slack


def inside(survival: float) -> float:
    """Clip a survival away from 0 and 1, where the slope of the entropy is infinite."""
    return min(max(survival, 1e-9), 1.0 - 1e-9)


def visit_sums(
    belief: Belief, model: SensorModel, cells: Places, max_visits: int
) -> tuple[Floats, Places]:
    """Return W, r and r2 by visits, and the maximum survivable visits (:eq:`bound-terms`)."""
    visits = np.arange(max_visits + 1)
    hazard = belief.hazard[cells, None]
    (log_mean,), (read,) = Objective.of(belief, model).of_visits(cells, max_visits)
    log_square = log_predicted_survival(hazard, 2 * visits, model.log_survival)
    alive = log_mean > -np.inf
    log_power = times_log(visits[:, None], model.log_survival)
    p_log_p = times_log(np.exp(log_power), log_power)
    spread = (1.0 - hazard) * p_log_p[:, 0] + hazard * p_log_p[:, 1]
    w = np.divide(spread, np.exp(log_mean), out=np.zeros_like(spread), where=alive)
    added = np.stack([w + read, -log_mean, -log_square], axis=-1)
    return np.where(alive[..., None], added, 0.0), alive.sum(axis=1) - 1


def main() -> None:
    """Print the bound, the value of a plan and their gap, nats, for each frozen belief."""
    # Studies load matplotlib, which takes longer than a bound.
    from kbnitp_ros.study.benchmark import frozen, NAME
    from kbnitp_ros.study.scenario_file import read_study, scenario_file

    scenario = read_study(scenario_file(NAME)).first
    grid, options = scenario.field(), SearchOptions(max_steps=scenario.planning.max_steps)
    print('| lethality | frozen bound | bound | value | gap |\n|---|---|---|---|---|')
    for belief, model, recorded in frozen():
        found = plan(grid, belief, model, options)
        above = upper_bound(grid, belief, model, options, found.path)
        columns = (recorded, above, found.information, above - found.information)
        print(f'| {model.lethality} |', *(f'{each:.4f} |' for each in columns), flush=True)


if __name__ == '__main__':
    main()
