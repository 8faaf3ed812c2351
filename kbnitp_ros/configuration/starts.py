# SPDX-License-Identifier: Apache-2.0
"""The parameters with which demo, launch files and tests start the nodes of a mission."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.configuration.known import find_parameter, node_parameters, ROS_PARAMETERS
from kbnitp_ros.configuration.table import LEARNT

# Parameters that the launch files of missions have as arguments.
OF_MISSIONS = (
    'robots', 'max_steps', 'max_distance', 'planner', 'beam_width', 'max_visits', 'allocation',
    'objective', 'loss_cost', 'rolling', 'step_period', 'silent_loss', 'return_deadline',
    'method', 'learn.numbers', 'seed', 'approval', 'keep_running', 'defaults', 'minimum_reach',
)  # fmt: skip

# Parameters that are options of demo, by their names without a group, or arguments of a launch
# file.
OPTIONS = {
    'demo': (
        'robots', 'map', 'sensor.lethality', 'max_steps', 'method', 'planner', 'allocation',
        'silent_loss', 'seed',
    ),
    'mission': OF_MISSIONS,
    'base': OF_MISSIONS,
    'robot': ('journal', 'driver', 'base_frame'),
}  # fmt: skip

# Defaults of demo and of launch files, where they differ from the table's.
DEFAULTS: dict[str, dict[str, Any]] = {
    # Robots of the demo take no time, but processes on a busy machine do.
    'demo': {'learn.numbers': LEARNT, 'return_deadline': 1.0},
    'mission': {'learn.numbers': LEARNT},
    # A real robot at 0.4 m/s needs 3.5 s for the diagonal of a cell of 1 m.
    'base': {
        'defaults': 'field',
        'step_period': 5.0,
        'return_deadline': 60.0,
    },
}

# Parameters that every demo sets itself, to be able to resume and to know the truth.
FIXED = {
    'publish_truth': True,
    'recorded': True,
    'keep_running': True,
    'await_nodes': (),
    'file': '',
    'resume': '',
    'agent': '',
}


def awaited_nodes(node: str, *, is_recorded: bool) -> list[str]:
    """Return the nodes that a node of a mission awaits, with the recorder if there is one."""
    awaits = node_parameters(node).get('await_nodes')
    return [*awaits.default, *(['recorder'] if is_recorded else [])] if awaits else []


def parameters_for(node: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given parameters that a node has."""
    return {
        name: value
        for name, value in given.items()
        if name in ROS_PARAMETERS or find_parameter(node, name)
    }
