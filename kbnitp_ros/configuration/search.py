# SPDX-License-Identifier: Apache-2.0
"""The search that the parameters describe, and whether the planner can do it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from kbnitp_ros.configuration.agents import agents_of, robot_type_of
from kbnitp_ros.configuration.goal import check_goal
from kbnitp_ros.core import (
    check_bounded,
    check_team,
    Grid,
    ORDINARY,
    PathFinder,
    RobotType,
    SearchOptions,
    SensorModel,
)


def search_options(values: Mapping[str, Any]) -> SearchOptions:
    """Return the options that these parameters describe."""
    names = {field.name: field.name for field in fields(SearchOptions)} | {'width': 'beam_width'}
    return SearchOptions(**{option: values[name] for option, name in names.items()})


def type_to_plan(
    values: Mapping[str, Any], agent: str, grid: Grid, believed: Mapping[str, RobotType]
) -> RobotType:
    """Return the type of an agent's robots: sensors as believed, the rest as parameters say."""
    sensors = believed.get(agent, ORDINARY)
    as_believed = {each.name: getattr(sensors, each.name) for each in fields(SensorModel)}
    return replace(robot_type_of(values, agent, grid), **as_believed)


def check_search(values: Mapping[str, Any], grid: Grid, believed: Mapping[str, RobotType]) -> None:
    """Check that the planner can search with these parameters in the memory there is."""
    types = [type_to_plan(values, agent, grid, believed) for agent in agents_of(values, grid)]
    options = search_options(values)
    check_goal(values, grid, [options.of_type(each) for each in types])
    check_team(PathFinder(grid, options), types)
    if values['bound']:
        for each in types:
            check_bounded(grid.at(each.base), options.of_type(each), len(types))
