# SPDX-License-Identifier: Apache-2.0
"""Whether a planner can search with the parameters, and the memory that it takes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.core import check_team, Grid, PathFinder, sought_by
from kbnitp_ros.nodes.parameters.agents import agents_of, kind_of
from kbnitp_ros.nodes.parameters.models import sensor_model_of


def check_search(values: Mapping[str, Any], grid: Grid) -> None:
    """
    Check that the planner can search with these parameters, and have the memory that it takes.

    Raises
    ------
    ValueError
        If it does not seek the objective; with an estimate, if it takes too much.

    """
    limits = (values[name] for name in ('planner', 'max_steps', 'beam_width', 'max_visits'))
    kinds = [kind_of(values, agent) for agent in agents_of(values, grid)]
    alpha = sought_by(values['planner'], values['objective'], values['alpha'])
    check_team(PathFinder(grid, *limits), sensor_model_of(values), kinds, alpha)
