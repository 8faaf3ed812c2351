# SPDX-License-Identifier: Apache-2.0
"""The agents that the parameters name, and what the robots of each have of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from kbnitp_ros.configuration.table import MOST_AGENTS, OPERATOR
from kbnitp_ros.core import Grid, RobotType, SensorModel


def agents_of(values: Mapping[str, Any], grid: Grid) -> tuple[str, ...]:
    """
    Return the names of the agents, of which robots leave on this grid.

    Raises
    ------
    ValueError
        If there is none, two have one name, or there are more than `MOST_AGENTS` or than free
        cells.

    """
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
    return values.get(f'robots.{agent}.{name}', values[name])


def most_steps(values: Mapping[str, Any]) -> int:
    """Return the most steps that the path of any agent's robot may have."""
    most: int = max(value_for(values, 'max_steps', agent) for agent in values['agents'])
    return most


def robot_type_of(values: Mapping[str, Any], agent: str) -> RobotType:
    """Return what an agent's robots have of their own."""
    given = {
        **{each.name: f'sensor.{each.name}' for each in fields(SensorModel)},
        'max_steps': 'max_steps',
        'loss_cost': 'loss_cost',
    }
    return RobotType(
        **{each: values.get(f'robots.{agent}.{name}') for each, name in given.items()}
    )


def robot_types_of(values: Mapping[str, Any]) -> dict[str, RobotType]:
    """Return the types of the robots of all agents."""
    return {agent: robot_type_of(values, agent) for agent in values['agents']}
