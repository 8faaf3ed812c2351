# SPDX-License-Identifier: Apache-2.0
"""The parameters of all nodes: the table, its checks, and the objects built from the values."""

from kbnitp_ros.configuration.agents import agents_of, value_for
from kbnitp_ros.configuration.field import grid_of
from kbnitp_ros.configuration.known import parameter_of, parameters_of
from kbnitp_ros.configuration.mission import estimator_of, goal_of
from kbnitp_ros.configuration.parameter import Parameter
from kbnitp_ros.configuration.table import NODES, TABLE

__all__ = [
    'NODES',
    'TABLE',
    'Parameter',
    'agents_of',
    'estimator_of',
    'goal_of',
    'grid_of',
    'parameter_of',
    'parameters_of',
    'value_for',
]
