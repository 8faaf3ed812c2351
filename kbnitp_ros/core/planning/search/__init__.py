# SPDX-License-Identifier: Apache-2.0
"""How the path of one robot is searched for."""

from kbnitp_ros.core.planning.search.plan import Plan, plan
from kbnitp_ros.core.planning.search.planners import (
    count_visits,
    NoPathError,
    PathFinder,
    PLANNERS,
)

__all__ = ['PLANNERS', 'NoPathError', 'PathFinder', 'Plan', 'count_visits', 'plan']
