# SPDX-License-Identifier: Apache-2.0
"""
Loops that bound the value of a path over all sums that its cells may have together.

A point is a survival P = exp(-r) and the ratio r2 / r, which is from 1 to 2.
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Any, NamedTuple

from kbnitp_ros.core.field import compiled
import numpy as np

# After so many boxes none is halved any more: the bound holds, and is less close.
MOST_BOXES = 20_000


class Region(NamedTuple):
    """
    What is known of the paths of so many steps.

    Attributes
    ----------
    safest : float
        q = s0^steps, the most that any of them is survived with, in (0, 1].
    least : float
        The least that they may be survived with.
    loss_cost : float
        Nats.
    cuts : ndarray, shape (cuts, 3)
        D, lambda and mu of equation :eq:`bound-cut`.

    """

    safest: float
    least: float
    loss_cost: float
    cuts: Any


@compiled
def surprisal(p: float) -> float:
    """Return -p ln p."""
    return -p * log(p) if p > 0.0 else 0.0


@compiled
def power(p: float, exponent: float) -> float:
    """Return p^exponent."""
    return exp(exponent * log(p)) if p > 0.0 else 0.0


@compiled
def greatest_sum(region: Region, survival: float, ratio: float) -> float:
    """Return the most that the cuts leave to the sum of W at a point."""
    r, least = -log(survival), inf
    for k in range(region.cuts.shape[0]):
        slope = region.cuts[k, 1] + region.cuts[k, 2] * ratio
        least = min(least, region.cuts[k, 0] + slope * r)
    return least


@compiled
def touching_point(region: Region, survival: float, square: float) -> float:
    """
    Return the p0 with which the parabola of equation :eq:`bound-parabola` is lowest.

    Equation :eq:`bound-touching`, for E[p] and E[p^2]; 0 where q is small, and away from q, where
    the coefficients would cancel.
    """
    if region.safest < 0.01 or survival >= region.safest:
        return 0.0
    p0 = (region.safest * survival - square) / (region.safest - survival)
    return min(max(p0, 0.0), 0.98 * region.safest)


@compiled
def parabola(q: float, p0: float) -> Any:
    """
    Return the coefficients of 1, p and p^2 of a parabola above (1 - p) ln(1 - p) on [0, q].

    Equation :eq:`bound-parabola`.
    """
    if p0 == 0.0 and q < 0.01:
        # The series of the curvature.
        return 0.0, -1.0, 0.5 + q * (1.0 / 6.0 + q * (1.0 / 12.0 + q * (1.0 / 20.0 + q / 29.0)))
    at, slope = -surprisal(1.0 - p0), -1.0 - log(1.0 - p0)
    curvature = -surprisal(1.0 - q) - at - slope * (q - p0)
    curvature /= (q - p0) * (q - p0)
    return at - (slope - curvature * p0) * p0, slope - 2.0 * curvature * p0, curvature


@compiled
def entropy_of(p: float) -> float:
    """Return h(p)."""
    return surprisal(p) + surprisal(1.0 - p)


@compiled
def value_at(region: Region, survival: float, ratio: float) -> float:
    """Return the right side of equation :eq:`bound-path` for the greatest sum of W at a point."""
    square = power(survival, ratio)
    c0, c1, c2 = parabola(region.safest, touching_point(region, survival, square))
    linear = greatest_sum(region, survival, ratio) + c1 + region.loss_cost
    value: float = entropy_of(survival) + survival * linear + c0 + c2 * square
    return value - region.loss_cost


@compiled
def next_cut(region: Region, survival: float, ratio: float, total: float, value: float) -> Any:
    """
    Return lambda and mu of a cut at a point with a sum of W, and the sum that has a value there.

    Equation :eq:`bound-slopes`.
    """
    square = power(survival, ratio)
    c0, c1, c2 = parabola(region.safest, touching_point(region, survival, square))
    of_r = log((1.0 - survival) / survival) + total + c1 + region.loss_cost
    of_r2 = c2 * square / survival
    rest = entropy_of(survival) + c0 + c2 * square - region.loss_cost
    return of_r, of_r2, (value - rest) / survival - c1 - region.loss_cost


@compiled
def bound_of_box(
    region: Region, low: float, high: float, least: float, most: float, enough: float
) -> float:
    """
    Return a bound of `value_at` over survivals and ratios in a box.

    Equation :eq:`bound-box`, for the cut with which it is least; any of them if it is at most
    `enough`.
    """
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
    """
    Return a bound of `value_at` over all points, by halving boxes.

    Equation :eq:`bound-maximum`.

    Parameters
    ----------
    region : Region
        With at least one cut.
    known : float
        The value of a path.
    tolerance : float
        By how much the bound may be above the maximum, or above `known`.
    at : ndarray, shape (2,)
        The survival and the ratio of the greatest value seen above `known`; unchanged if there is
        none.

    Returns
    -------
    float
        Nats.

    """
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
        if of_box <= found + tolerance or small or opened > MOST_BOXES:
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


@compiled
def worthless(region: Region, allowed: float, tolerance: float) -> float:
    """
    Return a D with which the last cut alone leaves no value above an allowed one.

    Equation :eq:`bound-walk`, to a tolerance in nats. Greater sums of W make greater values.
    """
    alone = Region(region.safest, region.least, region.loss_cost, region.cuts[-1:].copy())
    at, known, below = np.empty(2), allowed - tolerance, tolerance
    high = alone.cuts[0, 0]
    low: float = high
    while maximum(alone, known, tolerance, at) > allowed:
        if below > 1e9:
            return -inf
        high = low
        low -= below
        below *= 2.0
        alone.cuts[0, 0] = low
    for _ in range(6):
        alone.cuts[0, 0] = 0.5 * (low + high)
        if maximum(alone, known, tolerance, at) > allowed:
            high = alone.cuts[0, 0]
        else:
            low = alone.cuts[0, 0]
    return low
