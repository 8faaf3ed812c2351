# SPDX-License-Identifier: Apache-2.0
"""Where to go next."""

from kbnitp_ros.core.planning.objective import (
    ALPHAS,
    behavioral_information,
    Candidate,
    Objective,
    OBJECTIVES,
    path_information,
    SearchOptions,
    team_information,
    TOLERANCES,
)
from kbnitp_ros.core.planning.search import (
    check_bounded,
    count_visits,
    NoPathError,
    PathFinder,
    Plan,
    plan,
    PLANNERS,
)
from kbnitp_ros.core.planning.teams import (
    ALLOCATIONS,
    check_team,
    keepout_cells,
    plan_team,
    Regions,
    Team,
    team_size,
    TeamMember,
    TeamPlan,
    without,
)

__all__ = [
    'ALLOCATIONS',
    'ALPHAS',
    'OBJECTIVES',
    'PLANNERS',
    'TOLERANCES',
    'Candidate',
    'NoPathError',
    'Objective',
    'PathFinder',
    'Plan',
    'Regions',
    'SearchOptions',
    'Team',
    'TeamMember',
    'TeamPlan',
    'behavioral_information',
    'check_bounded',
    'check_team',
    'count_visits',
    'keepout_cells',
    'path_information',
    'plan',
    'plan_team',
    'team_information',
    'team_size',
    'without',
]
