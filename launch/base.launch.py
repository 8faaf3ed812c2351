# SPDX-License-Identifier: Apache-2.0
"""Launch the base of a mission: planner, estimator and recorder, for robots that are elsewhere."""

from kbnitp_ros.launching import arguments_of_missions, mission_description
from launch.actions import DeclareLaunchArgument


def generate_launch_description():
    agents = DeclareLaunchArgument(
        'agents',
        default_value='',
        description='Names of the robots, separated by commas, or their number (scout_1 and so '
        'on); empty for the names in the parameters.',
    )
    # A lost real robot sends no report.
    defaults = {'keep_running': 'false', 'silent_loss': 'true'}
    # A robot at 0.4 m/s needs 3.5 s for the diagonal of a cell of 1 m.
    of_real_robots = {'defaults': 'field', 'step_period': '5.0', 'return_deadline': '60.0'}
    return mission_description(
        [agents, *arguments_of_missions(**defaults)],
        lambda mission: mission.base(**of_real_robots),
    )
