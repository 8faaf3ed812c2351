# SPDX-License-Identifier: Apache-2.0
"""The parameters of all nodes: the table, its checks, and the objects built from the values."""

from kbnitp_ros.configuration.agents import agent_names, value_for
from kbnitp_ros.configuration.field import make_grid
from kbnitp_ros.configuration.known import find_parameter, node_parameters
from kbnitp_ros.configuration.mission import make_estimator, make_goal, with_defaults
from kbnitp_ros.configuration.parameter import Parameter
from kbnitp_ros.configuration.table import NODES, TABLE

__all__ = [
    'NODES',
    'TABLE',
    'Parameter',
    'agent_names',
    'find_parameter',
    'make_estimator',
    'make_goal',
    'make_grid',
    'node_parameters',
    'value_for',
    'with_defaults',
]
