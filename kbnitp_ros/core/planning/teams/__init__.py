# SPDX-License-Identifier: Apache-2.0
"""How robots that leave together share the work."""

from kbnitp_ros.core.planning.teams.allocations import ALLOCATIONS
from kbnitp_ros.core.planning.teams.regions import keepout_cells, Regions, without
from kbnitp_ros.core.planning.teams.team import check_team, plan_team, Team, team_size, TeamPlan
from kbnitp_ros.core.planning.teams.team_member import TeamMember

__all__ = [
    'ALLOCATIONS',
    'Regions',
    'Team',
    'TeamMember',
    'TeamPlan',
    'check_team',
    'keepout_cells',
    'plan_team',
    'team_size',
    'without',
]
