# SPDX-License-Identifier: Apache-2.0
"""How the path of one robot is searched for."""

from kbnitp_ros.core.planning.search.plan import check_bounded, Plan, plan, plan_alone
from kbnitp_ros.core.planning.search.planners import (
    check_distance,
    count_visits,
    NoPathError,
    PathFinder,
)

__all__ = [
    'NoPathError',
    'PathFinder',
    'Plan',
    'check_bounded',
    'check_distance',
    'count_visits',
    'plan',
    'plan_alone',
]
