# SPDX-License-Identifier: Apache-2.0
"""Where to go next."""

from kbnitp_ros.core.planning.allocations import ALLOCATIONS
from kbnitp_ros.core.planning.behavioral import ALPHAS, behavioral_information, OBJECTIVES
from kbnitp_ros.core.planning.found import Found
from kbnitp_ros.core.planning.information import path_information, team_information
from kbnitp_ros.core.planning.objective import Objective
from kbnitp_ros.core.planning.plan import Plan, plan
from kbnitp_ros.core.planning.planners import count_visits, PathFinder, PLANNERS, sought_by
from kbnitp_ros.core.planning.refused import kept_off
from kbnitp_ros.core.planning.regions import Regions
from kbnitp_ros.core.planning.robot import Robot
from kbnitp_ros.core.planning.team import check_team, plan_team, team_size, TeamPlan

__all__ = [
    'ALLOCATIONS',
    'ALPHAS',
    'OBJECTIVES',
    'PLANNERS',
    'Found',
    'Objective',
    'PathFinder',
    'Plan',
    'Regions',
    'Robot',
    'TeamPlan',
    'behavioral_information',
    'check_team',
    'count_visits',
    'kept_off',
    'path_information',
    'plan',
    'plan_team',
    'sought_by',
    'team_information',
    'team_size',
]
