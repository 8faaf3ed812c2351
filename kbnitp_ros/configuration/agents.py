# SPDX-License-Identifier: Apache-2.0
"""The agents that the parameters name, and what the robots of each have of their own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from kbnitp_ros.configuration.table import MOST_AGENTS, OPERATOR
from kbnitp_ros.core import Grid, RobotType, SensorModel


def agents_of(values: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """Return the names of the agents, of which robots leave on this grid."""
    agents: tuple[str, ...] = values['agents']
    if not agents or len(set(agents)) < len(agents):
        raise ValueError(
            f'parameter agents is {list(agents)}: it must be one or more names, no two alike'
        )
    if OPERATOR in agents:
        raise ValueError(
            f'parameter agents is {list(agents)}: {OPERATOR} is no name for an agent, since a '
            'topic of the planner is called so'
        )
    if len(agents) > MOST_AGENTS:
        raise ValueError(
            f'parameter agents has {len(agents)} names: there can be at most {MOST_AGENTS}'
        )
    free = int(grid.free.sum())
    if len(agents) > free:
        raise ValueError(
            f'parameter agents has {len(agents)} names: there can be at most one for each of the '
            f'{free} free cells'
        )
    return agents


def value_for(values: Mapping[str, Any], name: str, agent: str) -> Any:
    """Return the value of a parameter for one agent: its own, or else that of all."""
    return values.get(f'team.{agent}.{name}', values[name])


def most_steps(values: Mapping[str, Any]) -> int:
    """Return the most steps that the path of any agent's robot may have."""
    most: int = max(value_for(values, 'max_steps', agent) for agent in values['agents'])
    return most


def most_distance(values: Mapping[str, Any], agents: Iterable[str]) -> float:
    """Return how long the path of any of these agents' robots may be, metres; 0: no limit."""
    distances = [value_for(values, 'max_distance', agent) for agent in agents]
    return max(distances) if all(distances) else 0.0


def base_of(values: Mapping[str, Any], agent: str, grid: Grid) -> int | None:
    """Return the base that an agent has of its own; None if it has that of all."""
    name = f'team.{agent}.base'
    cell, position = values.get(name), values.get(f'{name}_position')
    if cell is not None and position:
        raise ValueError(f'parameters {name} and {name}_position name the same: give one of them')
    if not position:
        return cell
    if len(position) != 2:
        raise ValueError(f'parameter {name}_position is {list(position)}: it must be x and y')
    try:
        return int(grid.cells_at([position])[0])
    except ValueError as error:
        raise ValueError(f'parameter {name}_position: {error}') from error


def robot_type_of(values: Mapping[str, Any], agent: str, grid: Grid) -> RobotType:
    """Return what an agent's robots have of their own."""
    given = {
        **{each.name: f'sensor.{each.name}' for each in fields(SensorModel)},
        'max_steps': 'max_steps',
        'max_distance': 'max_distance',
        'loss_cost': 'loss_cost',
    }
    return RobotType(
        base=base_of(values, agent, grid),
        **{each: values.get(f'team.{agent}.{name}') for each, name in given.items()},
    )


def robot_types_of(values: Mapping[str, Any], grid: Grid) -> dict[str, RobotType]:
    """Return the types of the robots of all agents, on the grid of these parameters."""
    return {agent: robot_type_of(values, agent, grid) for agent in values['agents']}


def own_robot_types(values: Mapping[str, Any], grid: Grid) -> dict[str, RobotType]:
    """Return `robot_types_of` for the agents whose robots are not like all others."""
    types = robot_types_of(values, grid)
    return {agent: robot_type for agent, robot_type in types.items() if robot_type.own}
