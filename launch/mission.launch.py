# SPDX-License-Identifier: Apache-2.0
"""Launch a mission of simulated robots, which is recorded by default and ends by itself."""

from kbnitp_ros.launching import description


def generate_launch_description():
    agents = (
        '1',
        'Number of agents (scout_1 and so on, whatever the parameters name), or their names, '
        'separated by commas. Each agent is a process.',
    )
    return description('mission', {'agents': agents}, nodes, keep_running='false')


def nodes(mission):
    """Return the nodes of the base and of the simulated agents."""
    return [
        *mission.base(),
        *(
            mission.node(
                'agent',
                {'agent': name},
                namespace=name,
                remappings=mission.poses,
                # The other agents of a team continue.
                ends_mission=len(mission.agents) == 1,
            )
            for name in mission.agents
        ),
    ]
