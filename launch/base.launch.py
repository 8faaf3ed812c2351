# SPDX-License-Identifier: Apache-2.0
"""Launch the base of a mission: planner, estimator and recorder, for robots that are elsewhere."""

from kbnitp_ros.launching import description, Launch


def generate_launch_description():
    agents = (
        '',
        'Names of the robots, separated by commas, or their number (scout_1 and so on); empty for '
        'the names in the parameters.',
    )
    # A lost real robot sends no report.
    return description(
        'base', {'agents': agents}, Launch.base, keep_running='false', silent_loss='true'
    )
