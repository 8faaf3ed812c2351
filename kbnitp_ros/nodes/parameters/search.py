# SPDX-License-Identifier: Apache-2.0
"""The memory that a planner takes with the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.core import check_team, Grid, PathFinder
from kbnitp_ros.nodes.parameters.agents import agents_of, kind_of
from kbnitp_ros.nodes.parameters.models import sensor_model_of


def check_search(values: Mapping[str, Any], grid: Grid) -> None:
    """
    Check that the planner can have the memory that it takes with these parameters on this grid.

    Raises
    ------
    ValueError
        With an estimate, if not.

    """
    limits = (values[name] for name in ('planner', 'max_steps', 'beam_width', 'max_visits'))
    kinds = [kind_of(values, agent) for agent in agents_of(values, grid)]
    check_team(PathFinder(grid, *limits), sensor_model_of(values), kinds)
