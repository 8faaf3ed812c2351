# SPDX-License-Identifier: Apache-2.0
"""The parameters of all nodes: their table, how values are checked, and what these describe."""

from kbnitp_ros.configuration.agents import (
    agents_of,
    base_of,
    most_distance,
    most_steps,
    own_robot_types,
    robot_type_of,
    robot_types_of,
    value_for,
)
from kbnitp_ros.configuration.estimator import estimator_of
from kbnitp_ros.configuration.field import datum_of, grid_of
from kbnitp_ros.configuration.goal import check_goal, goal_of, stop_of
from kbnitp_ros.configuration.known import (
    check_known,
    check_own,
    parameter_of,
    parameters_of,
    ROS_PARAMETERS,
)
from kbnitp_ros.configuration.models import (
    clustering_of,
    dynamics_of,
    execution_of,
    sensor_model_of,
    true_dynamics,
    unknowns_of,
)
from kbnitp_ros.configuration.names import nearest, own_name
from kbnitp_ros.configuration.page import reference_page
from kbnitp_ros.configuration.parameter import Parameter
from kbnitp_ros.configuration.prior import prior_of
from kbnitp_ros.configuration.search import check_search, search_options, type_to_plan
from kbnitp_ros.configuration.table import (
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
    'Parameter',
    'agents_of',
    'base_of',
    'check_goal',
    'check_known',
    'check_own',
    'check_search',
    'clustering_of',
    'datum_of',
    'dynamics_of',
    'estimator_of',
    'execution_of',
    'goal_of',
    'grid_of',
    'most_distance',
    'most_steps',
    'nearest',
    'own_name',
    'own_robot_types',
    'parameter_of',
    'parameters_of',
    'prior_of',
    'reference_page',
    'robot_type_of',
    'robot_types_of',
    'search_options',
    'sensor_model_of',
    'stop_of',
    'true_dynamics',
    'type_to_plan',
    'unknowns_of',
    'value_for',
]
