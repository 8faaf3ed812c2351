# SPDX-License-Identifier: Apache-2.0
"""Launch a mission of simulated robots, recorded unless told not to, which ends by itself."""

from kbnitp_ros.launching import arguments_of_missions, mission_description
from launch.actions import DeclareLaunchArgument


def generate_launch_description():
    agents = DeclareLaunchArgument(
        'agents',
        default_value='1',
        description='How many agents, each a process of its own: scout_1 and so on, whatever the '
        'parameters name; or their names, with commas between them.',
    )
    return mission_description([agents, *arguments_of_missions(keep_running='false')], nodes)


def nodes(mission):
    """Return the nodes of the base and of the simulated agents."""
    return [
        *mission.base(),
        *(
            mission.node(
                'agent',
                {'agent': name},
                awaits=['planner', 'estimator'],
                namespace=name,
                # The others of a team carry on.
                ends_mission=len(mission.agents) == 1,
            )
            for name in mission.agents
        ),
    ]
