# SPDX-License-Identifier: Apache-2.0
"""The goal, the search, the prior and the estimator that the parameters describe."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from math import isclose
from types import MappingProxyType
from typing import Any

from kbnitp_ros.configuration.agents import (
    agent_names,
    cell_at,
    check_duds,
    make_clustering,
    make_dynamics,
    make_robot_type,
    make_robot_types,
    make_sensor_model,
    make_target_dynamics,
    make_unknowns,
)
from kbnitp_ros.configuration.known import node_parameters
from kbnitp_ros.configuration.table import FIELD_LEARNT, LEARNT
from kbnitp_ros.core import (
    Belief,
    Estimator,
    Goal,
    Grid,
    METHODS,
    ORDINARY,
    PathFinder,
    RobotType,
    SearchOptions,
    Stop,
)
from kbnitp_ros.core.decision.goals import GOALS
from kbnitp_ros.core.decision.rounds import check_sought
from kbnitp_ros.core.field.sensor import SENSORS
from kbnitp_ros.core.planning.plans import check_team
from kbnitp_ros.log.record import last_belief
from kbnitp_ros.log.roles import MissionLog
from kbnitp_ros.maps import read_map, read_probabilities
import numpy as np

# Minimum occupancy of a mask's pixels that belong to the goal, percent.
MARKED = 50

# The stops of a node that sends no robots.
NEVER = Stop()


def make_goal(values: Mapping[str, Any], grid: Grid) -> Goal | None:
    """Return the goal; None to map the field."""
    make = GOALS.find(values['goal.kind'])
    confidence = values['stop.confidence'] or None
    with GOALS.blamed(values['goal.kind']):
        return make(goal_cells(values, grid), confidence)


def goal_cells(values: Mapping[str, Any], grid: Grid) -> list[int]:
    """Return the cells of the goal, given by number, position or mask."""
    cells, mask = values['goal.cells'], values['goal.mask']
    if sum(map(bool, (cells, values['goal.position'], mask))) > 1:
        raise ValueError(
            'parameters goal.cells, goal.position and goal.mask all name cells: give one of them'
        )
    at = cell_at(values, 'goal.position', grid)
    if at is not None:
        return [at]
    if not mask:
        return list(cells)
    marked = read_map(mask)
    rows, columns = marked.data.shape
    if (columns, rows) != (grid.width, grid.height) or not isclose(
        marked.resolution, grid.resolution, rel_tol=1e-6
    ):
        raise ValueError(
            f'parameter goal.mask: {mask} has {columns} x {rows} pixels of {marked.resolution} m, '
            f'but the field has {grid.width} x {grid.height} cells of {grid.resolution} m: draw '
            'a pixel for each cell'
        )
    is_marked = (marked.data.ravel() >= MARKED) & grid.free
    return [int(cell) for cell in np.flatnonzero(is_marked)]


def checked_goal(
    values: Mapping[str, Any],
    grid: Grid,
    stop: Stop = NEVER,
    robots: int = 0,
    estimator: Estimator | None = None,
) -> Goal | None:
    """Return the goal; check its reach, the stops and, if known, the estimator's confidence."""
    goal = make_goal(values, grid)
    stop.check(goal, robots, estimator)
    if goal is not None:
        goal.check(grid, values['max_steps'])
    return goal


def settled_goal(values: Mapping[str, Any], grid: Grid) -> dict[str, Any]:
    """Return the parameters of the goal with its cells by number."""
    cells = goal_cells(values, grid)
    return {'goal.cells': cells, 'goal.position': (), 'goal.mask': ''}


def make_stop(values: Mapping[str, Any]) -> Stop:
    """Return the conditions that end a mission early."""
    return Stop(values['stop.gain'], values['stop.losses'])


def check_goal(values: Mapping[str, Any], grid: Grid, options: Iterable[SearchOptions]) -> None:
    """Check that the goal can be reached, and that the stops can end the mission."""
    goal = checked_goal(values, grid, make_stop(values), values['robots'])
    for search in options:
        check_sought(goal, search)


def search_options(values: Mapping[str, Any]) -> SearchOptions:
    """Return the options of the search."""
    names = {field.name: field.name for field in fields(SearchOptions) if field.name != 'keepout'}
    names['width'] = 'beam_width'
    return SearchOptions(**{option: values[name] for option, name in names.items()})


def type_to_plan(
    values: Mapping[str, Any], agent: str, grid: Grid, believed: Mapping[str, RobotType]
) -> RobotType:
    """Return the robot type of an agent, with the believed sensors."""
    sensors = believed.get(agent, ORDINARY)
    as_believed = {name: getattr(sensors, name) for name in SENSORS}
    return replace(make_robot_type(values, agent, grid), **as_believed)


def check_search(values: Mapping[str, Any], grid: Grid, believed: Mapping[str, RobotType]) -> None:
    """Check that the goal fits the search, and that the search fits in memory."""
    types = [type_to_plan(values, agent, grid, believed) for agent in agent_names(values, grid)]
    options = search_options(values)
    check_goal(values, grid, [options.of_type(each) for each in types])
    check_team(PathFinder(grid, options), types)


MAPS = ('hazard', 'target', 'kappa')

# Maximum number of cells of a field in which all of `FIELD_LEARNT` are learnt.
MAX_LEARNT = 30_000

# Properties that a field must share with the field of the mission that gives its prior.
SAME = ('width', 'height', 'resolution', 'origin', 'yaw', 'blocked')


def make_prior(values: Mapping[str, Any], grid: Grid) -> Belief:
    """Return the prior of the estimator."""
    files = {name: values[f'prior.{name}_map'] for name in MAPS}
    log = values['prior.log']
    if log:
        if any(files.values()):
            raise ValueError(
                'parameter prior.log is given with a map of the prior: give one of them'
            )
        return earlier_belief(log, grid)
    numbers = {name: values[f'prior.{name}'] for name in MAPS}
    maps = {
        name: read_probabilities(file, grid, numbers[name], values['prior.resample'])
        for name, file in files.items()
        if file
    }
    prior = numbers | maps
    if 'hazard' in maps and 'target' not in maps and numbers['hazard'] < 1.0:
        # The probability of a target without a hazard follows from the numbers, not from maps.
        background = numbers['target'] - numbers['kappa'] * numbers['hazard']
        background = min(max(background / (1.0 - numbers['hazard']), 0.0), 1.0)
        prior['target'] = prior['kappa'] * maps['hazard'] + background * (1.0 - maps['hazard'])
    return Belief.prior(grid, **prior)


def earlier_belief(log: str, grid: Grid) -> Belief:
    """Read the final belief of another mission in the same field."""
    known = last_belief(MissionLog(log))
    if known is None:
        raise ValueError(f'{log} has no belief on record')
    for name in SAME:
        if getattr(known.grid, name) != getattr(grid, name):
            raise ValueError(
                f'{log} is of a mission on {known.grid}, but the parameters set {grid}'
            )
    return known.belief.on(grid)


def with_defaults(
    node: str, given: Mapping[str, Any], own: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """Return a node's values: those given, a command's own defaults, or else the table's."""
    table, kind = node_parameters(node), given.get('defaults', 'auto')
    if kind == 'auto':
        kind = 'field' if given.get('map') or given.get('map_topic') else 'paper'
    values = {
        name: each.default if kind == 'paper' or each.in_field is None else each.in_field
        for name, each in table.items()
    } | {name: value for name, value in own.items() if name in table}
    if values.get('learn.numbers'):
        learnt = learnt_by_default({**values, **given, 'defaults': kind})
        values |= {'learn.numbers': ()} if 'learn.numbers' in given else learnt
    return {**values, **given, **({'defaults': kind} if 'defaults' in table else {})}


def learnt_by_default(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers that are learnt by default, and the dynamics of targets."""
    method = METHODS.find(values['method'])
    if not getattr(method, 'learns', False):
        return {'learn.numbers': ()}
    if values['defaults'] != 'field' or not getattr(method, 'reaches', False):
        return {'learn.numbers': LEARNT}
    # Numbers that every agent has of its own cannot be learnt.
    own = {
        name
        for name in FIELD_LEARNT
        if all(f'team.{agent}.sensor.{name}' in values for agent in values['agents'])
    }
    if values['hazards.dynamics'] in ('used_up', 'learn'):
        own.add('reach')
    learnt = tuple(name for name in FIELD_LEARNT if name not in own)
    # The rates of the detector are learnt with the targets, which are static where duds are.
    if {'true_positive', 'false_positive'} <= {*learnt} and not values['sensor.duds']:
        return {'learn.numbers': learnt, 'targets.dynamics': 'learn'}
    return {'learn.numbers': learnt}


def make_estimator(values: Mapping[str, Any], grid: Grid) -> Estimator:
    """Return the estimator before the first deployment."""
    if grid.cells > MAX_LEARNT and tuple(values['learn.numbers']) == FIELD_LEARNT:
        # The particles of more than three numbers would be too few.
        values = {**values, 'learn.numbers': LEARNT, 'targets.dynamics': 'static'}
    check_duds(values)
    unknowns = make_unknowns(values)
    rates = values['sensor.true_positive'], values['sensor.false_positive']
    if rates[0] < rates[1] and not {'true_positive', 'false_positive'} & unknowns.priors.keys():
        raise ValueError(
            f'parameter sensor.true_positive is {rates[0]}, below sensor.false_positive, '
            f'{rates[1]}: a detection would speak against a target; are they swapped?'
        )
    for name in unknowns.priors:
        if all(
            getattr(robot_type, name, None) is not None
            for robot_type in make_robot_types(values, grid).values()
        ):
            raise ValueError(
                f'parameter learn.numbers has {name}, and every agent has a value of its own: no '
                'robot has the number that would be learnt'
            )
    return Estimator(
        make_prior(values, grid),
        make_sensor_model(values),
        values['method'],
        unknowns,
        values['seed'],
        dynamics=make_dynamics(values),
        clustering=make_clustering(values, grid),
        target_dynamics=make_target_dynamics(values),
    )
