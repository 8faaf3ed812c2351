# SPDX-License-Identifier: Apache-2.0
"""The parameters of all nodes: their table, how values are checked, and what these describe."""

from kbnitp_ros.nodes.parameters.agents import agents_of, kind_of, kinds_of, most_steps, value_for
from kbnitp_ros.nodes.parameters.declared import check_own, declare
from kbnitp_ros.nodes.parameters.estimator import estimator_of
from kbnitp_ros.nodes.parameters.field import grid_of
from kbnitp_ros.nodes.parameters.known import (
    check_known,
    parameter_of,
    parameters_of,
    ROS_PARAMETERS,
)
from kbnitp_ros.nodes.parameters.models import conduct_of, sensor_model_of, unknowns_of
from kbnitp_ros.nodes.parameters.names import nearest, own_name
from kbnitp_ros.nodes.parameters.page import reference_page
from kbnitp_ros.nodes.parameters.prior import prior_of
from kbnitp_ros.nodes.parameters.search import check_search
from kbnitp_ros.nodes.parameters.table import (
    LEARN,
    MOST_AGENTS,
    MOST_CELLS,
    MOST_ROBOTS,
    MOST_STEPS,
    NODES,
    TABLE,
)

__all__ = [
    'LEARN',
    'MOST_AGENTS',
    'MOST_CELLS',
    'MOST_ROBOTS',
    'MOST_STEPS',
    'NODES',
    'ROS_PARAMETERS',
    'TABLE',
    'agents_of',
    'check_known',
    'check_own',
    'check_search',
    'conduct_of',
    'declare',
    'estimator_of',
    'grid_of',
    'kind_of',
    'kinds_of',
    'most_steps',
    'nearest',
    'own_name',
    'parameter_of',
    'parameters_of',
    'prior_of',
    'reference_page',
    'sensor_model_of',
    'unknowns_of',
    'value_for',
]
