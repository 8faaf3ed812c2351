# SPDX-License-Identifier: Apache-2.0
"""Launch the base of a mission: planner, estimator and recorder, for robots that are elsewhere."""

from kbnitp_ros.launching import arguments_of_missions, mission_description
from launch.actions import DeclareLaunchArgument


def generate_launch_description():
    agents = DeclareLaunchArgument(
        'agents',
        default_value='',
        description='The names of the robots, with commas between them, or how many there are: '
        'scout_1 and so on; empty for those that the parameters name.',
    )
    # Of a real robot that is lost nothing is heard.
    defaults = {'keep_running': 'false', 'silent_loss': 'true'}
    # One of 0.4 m/s needs 3.5 s for the diagonal of a cell of 1 m.
    of_real_robots = {'step_period': '5.0', 'return_deadline': '60.0'}
    return mission_description(
        [agents, *arguments_of_missions(**defaults)],
        lambda mission: mission.base(**of_real_robots),
    )
