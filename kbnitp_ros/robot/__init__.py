# SPDX-License-Identifier: Apache-2.0
"""What a real robot does and remembers of its deployments: no ROS, and one file, its journal."""

from kbnitp_ros.robot.journal import Deployment, Journal, Step
from kbnitp_ros.robot.way import (
    Itinerary,
    legs_of,
    shortest_way,
    steps_within,
    Walk,
    without_loops,
)
from kbnitp_ros.robot.whereabouts import Whereabouts

__all__ = [
    'Deployment',
    'Itinerary',
    'Journal',
    'Step',
    'Walk',
    'Whereabouts',
    'legs_of',
    'shortest_way',
    'steps_within',
    'without_loops',
]
