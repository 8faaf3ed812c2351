# SPDX-License-Identifier: Apache-2.0
"""Plans of rounds, asked for in one line."""

from kbnitp_ros.core import plan_team, SearchOptions, Team


def plan_round(
    grid,
    belief,
    model,
    max_steps,
    agents,
    allocation='greedy',
    planner='beam',
    *,
    types=(),
    in_flight=(),
    visited=(),
    keepout=(),
    **options,
):
    """Return the plans of robots that leave together; the rest are options of the search."""
    team, search = Team(agents, allocation, types), SearchOptions(planner, max_steps, **options)
    return plan_team(
        grid, belief, model, team, search, in_flight=in_flight, visited=visited, keepout=keepout
    )
