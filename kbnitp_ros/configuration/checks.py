# SPDX-License-Identifier: Apache-2.0
"""Checks and warnings of a base: reach, density, timeouts, changed parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import combinations
from math import ceil, dist
from typing import Any

from kbnitp_ros.configuration import find_parameter, value_for
from kbnitp_ros.configuration.agents import most_distance, most_steps, own_base
from kbnitp_ros.configuration.field import parking_place
from kbnitp_ros.configuration.mission import check_search, with_defaults
from kbnitp_ros.configuration.table import LEARN
from kbnitp_ros.core import Grid, Ledger, RobotType
import numpy as np

# Distance up to which two places are one, metres.
SAME_PLACE = 0.01


def reach_note(grid: Grid, values: Mapping[str, Any], enough: float = 1.0) -> str:
    """Return a warning if the planner's paths reach too little of the field, else ''."""
    max_steps, max_distance = most_steps(values), most_distance(values, values['agents'])
    bases = dict.fromkeys(own_base(values, agent, grid) for agent in values['agents'])
    fields = [grid.at(base) for base in bases]
    steps = np.min([field.steps_to_base for field in fields], axis=0)
    reached, joined = (
        np.any([field.in_reach(max_steps, max_distance) for field in fields], axis=0),
        steps < grid.cells,
    )
    if reached.sum() >= enough * joined.sum():
        return ''
    rows, columns = np.divmod(np.flatnonzero(reached), grid.width)
    extent = f'{np.ptp(columns) + 1}x{np.ptp(rows) + 1} of {grid.width}x{grid.height} cells'
    most = 2 * int(steps[joined].max())
    limits, needed = f'{max_steps} steps', f'max_steps to {most}'
    if max_distance:
        distance = np.min([field.distance_to_base for field in fields], axis=0)
        metres = ceil(20.0 * distance[joined].max()) / 10.0
        limits = f'{max_steps} steps and {max_distance:.6g} m'
        needed = f'max_steps to {most} and max_distance to {metres}'
    return (
        f'paths of {limits} reach {reached.sum()} of the {joined.sum()} cells connected to the '
        f'base (a box of {extent}): to reach all, set {needed}'
    )


def check_reach(
    grid: Grid, values: Mapping[str, Any], confirm: Callable[[str], bool] = lambda _: False
) -> None:
    """Check that robots can leave their base, and reach enough cells or `confirm` few of them."""
    for agent in values['agents']:
        field = grid.at(own_base(values, agent, grid))
        why = ''
        if not (field.steps_to_base == 1).any():
            why = 'no other cell can be entered from it (map, grid.blocked and grid.corners)'
        elif value_for(values, 'max_steps', agent) < 2:
            why = 'max_steps is 1: a way to another cell and back takes 2 steps'
        if why:
            raise ValueError(
                f'robots of {agent} cannot leave their base, cell {field.base}: {why}'
            )
    # A resumed mission has sent robots already; other goals check their own cells.
    least = 0.0 if values['resume'] or values['goal.kind'] != 'map' else values['minimum_reach']
    note = reach_note(grid, values, least)
    if note and not confirm(f'{note}. Send robots all the same?'):
        raise ValueError(f'{note}, or minimum_reach to 0 for these cells only')


def check_parking(grid: Grid, values: Mapping[str, Any]) -> None:
    """Check that robots park in their bases, and those with a place of their own apart."""
    homes = {agent: parking_place(values, agent, grid)[:2] for agent in values['agents']}
    least = max(SAME_PLACE, 2.0 * values['robot_radius'])
    for pair in combinations(homes, 2):
        apart = dist(*(homes[agent] for agent in pair))
        if apart <= least and any(value_for(values, 'parking', agent) for agent in pair):
            raise ValueError(
                f'parameter parking of {" and ".join(pair)}: the places are {apart:.2f} m apart: '
                f'more than {least:g} m are needed (twice robot_radius, at least {SAME_PLACE} m)'
            )


def check_periods(values: Mapping[str, Any], agents: Iterable[str]) -> None:
    """Check that silent robots do not time out before their paths end, nor rounds leave apart."""
    if values['separation'] and not values['rolling']:
        raise ValueError(
            f'separation is {values["separation"]}, and rolling is false: the robots of a round '
            'leave together; set rolling to true, or separation to 0'
        )
    for agent in agents:
        if values['silent_loss'] and value_for(values, 'step_period', agent) == 0.0:
            raise ValueError(
                f'silent_loss is true and step_period is 0 for {agent}: its robot would count as '
                f'lost {values["return_deadline"]} s after it departs (return_deadline), however '
                'long its path is; set step_period to the seconds that it needs for a step'
            )


def failure_note(values: Mapping[str, Any]) -> str:
    """Say how many robots fail without any hazard."""
    share = 1.0 - (1.0 - values['sensor.malfunction']) ** most_steps(values)
    return (
        f'without hazards {100.0 * share:.2g} % of robots fail on the longest path (parameters '
        f'sensor.malfunction and max_steps; defaults: {values["defaults"]})'
    )


def ignored_note(values: Mapping[str, Any], learnt: Iterable[str]) -> str:
    """Return a warning of given values that are not used, since they are learnt; '' without."""
    defaults = with_defaults('estimator', {'defaults': values['defaults']})
    parameters = {name: LEARN[name][0].partition(',')[0] for name in learnt}
    ignored = {
        name: f'{parameter} is {values[parameter]}'
        for name, parameter in parameters.items()
        if parameter in defaults and values[parameter] != defaults[parameter]
    }
    if not ignored:
        return ''
    priors = ' and '.join(f'learn.{name}' for name in ignored)
    return (
        f'{" and ".join(ignored.values())}, and not used, since learn.numbers has '
        f'{" and ".join(ignored)}: take it out of learn.numbers to use it as known, or set '
        f'{priors} to a prior around it'
    )


def cut_off_note(grid: Grid) -> str:
    """Return a note on free cells that no path of any length reaches; '' if there are none."""
    free = int(grid.free.sum())
    cut_off = free - int((grid.steps_to_base < grid.cells).sum())
    return f'{cut_off} of {free} free cells are cut off from the base' if cut_off else ''


# Ratio of standard deviation to mean from which a density counts as weakly known.
WEAK = 0.25


def density_note(ledger: Ledger) -> str:
    """Return a warning if the learnt density of clustered hazards is too uncertain, else ''."""
    estimator, grid = ledger.estimator, ledger.grid
    density = estimator.parameters.get('hazard_density')
    is_clustered = estimator.clustering is not None and estimator.clustering.coupling != 0.0
    if not is_clustered or density is None or density.sd < WEAK * density.mean:
        return ''
    unvisited = grid.may_be_hazardous.copy()
    for key in ledger.deployments:
        unvisited[ledger.paths[key]] = False
    cells = int(grid.may_be_hazardous.sum())
    if 2 * unvisited.sum() <= cells:
        return ''
    return (
        f'hazards cluster and their learnt density is {density.mean:.2g} ± {density.sd:.2g}; the '
        f'belief about {unvisited.sum()} of {cells} cells, which no robot visited, depends on '
        'this density: state it in prior.hazard or narrow learn.hazard_density'
    )


def check_changes(
    changes: Mapping[str, Any],
    values: Mapping[str, Any],
    grid: Grid,
    believed: Mapping[str, RobotType],
    sent: int,
) -> None:
    """Check changed parameters of the planner."""
    given = {
        name: parameter.check(value)
        for name, value in changes.items()
        if (parameter := find_parameter('planner', name))
    }
    check_search({**values, **given}, grid, believed)
    check_robots(given.get('robots', sent), sent)


def check_robots(robots: int, sent: int) -> None:
    """Check that a new number of robots is not below the number already sent."""
    if robots < sent:
        raise ValueError(
            f'parameter robots is {robots}: it must be at least {sent}, the number of robots sent '
            f'so far; robots={sent} ends the mission'
        )
