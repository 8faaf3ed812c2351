# SPDX-License-Identifier: Apache-2.0
"""
A bound on the value of every path, by a Lagrangian dual with cuts.

The derivation is in docs/mathematics: the value of a path, :eq:`bound-value`, is at most a
function of three sums over its cells, :eq:`bound-path`; Lagrangian multipliers cut off sums that
no closed walk has, :eq:`bound-cut`; the function is maximised over the remaining sums,
:eq:`bound-maximum`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, inf, log

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.sensor import log_predicted_survival, SensorModel, times_log
from kbnitp_ros.core.planning.bound_kernels import (
    greatest_sum,
    maximum,
    minimise,
    next_cut,
    Region,
    Walks,
)
from kbnitp_ros.core.planning.information import Candidate
from kbnitp_ros.core.planning.label_kernels import Floats, Places, Reach
from kbnitp_ros.core.planning.labels import find_reach, MAX_MEMORY
from kbnitp_ros.core.planning.objective import new_information, Objective, possible_readings
from kbnitp_ros.core.planning.options import SearchOptions
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


def upper_bound(grid: Grid, objective: Objective, options: SearchOptions, path: Places) -> float:
    """Return an upper bound on the value of any path, nats; the search starts at `path`."""
    loss_cost, value = objective.loss_cost, Candidate.along(path, objective).value
    tolerance = max(MIN_TOLERANCE, TOLERANCE * abs(value))
    slack = ROUNDING + ROUNDING_OF_COST * loss_cost
    log_safe = float(objective.model.log_survival[0])
    if exp(log_safe) == 0.0:
        return value + slack
    reach, max_steps = find_reach(grid, options.max_steps, options.max_distance), options.max_steps
    visits = min(options.max_visits, max_steps)
    added, survivable = visit_sums(objective.belief, objective.model, reach.cells, visits)
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
    log_mean = log_predicted_survival(hazard, visits, model.log_survival)
    log_square = log_predicted_survival(hazard, 2 * visits, model.log_survival)
    alive = log_mean > -np.inf
    log_power = times_log(visits[:, None], model.log_survival)
    p_log_p = times_log(np.exp(log_power), log_power)
    spread = (1.0 - hazard) * p_log_p[:, 0] + hazard * p_log_p[:, 1]
    w = np.divide(spread, np.exp(log_mean), out=np.zeros_like(spread), where=alive)
    readings = possible_readings(model, max_visits, ())
    nothing_read = np.ones((cells.size, 1))
    w[:, 1:] += new_information(readings, belief.joint[cells], nothing_read)
    added = np.stack([w, -log_mean, -log_square], axis=-1)
    return np.where(alive[..., None], added, 0.0), alive.sum(axis=1) - 1


def check_bound(reach: Reach, options: SearchOptions, robots: int) -> None:
    """Check that a bound can be computed, within `MAX_MEMORY`."""
    if robots > 1:
        raise ValueError(
            f'there are {robots} robots, but only plans of a single robot have a bound: send one '
            'at a time, or plan without a bound'
        )
    if options.objective != 'information':
        raise ValueError(
            f'objective is {options.objective}, which has no bound: choose the objective '
            'information, or plan without a bound'
        )
    number, cells = 8, reach.cells.size
    max_steps, max_visits = options.max_steps, options.max_visits
    visits = 1 + min(max_visits, max_steps)
    of_walks = cells * (max_steps + 1) + number * cells * (9 + 2)
    of_visits = number * cells * visits * (3 * 3 + 4 + 1)
    of_multipliers = number * (cells + 2) * max_steps
    estimate = of_walks + of_visits + of_multipliers
    if estimate > MAX_MEMORY:
        raise ValueError(
            f'a bound for max_steps = {max_steps}, max_visits = {max_visits} and {cells} cells '
            f'within reach takes about {estimate / 1e9:.1f} GB, and {MAX_MEMORY / 1e9:.1f} GB '
            'are allowed: lower max_steps, or plan without a bound'
        )
