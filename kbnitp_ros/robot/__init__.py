# SPDX-License-Identifier: Apache-2.0
"""What a real robot does and remembers of its deployments: no ROS, and one file, its journal."""

from kbnitp_ros.robot.deployment import Deployment, Step
from kbnitp_ros.robot.itinerary import Itinerary
from kbnitp_ros.robot.journal import Journal
from kbnitp_ros.robot.walk import Walk
from kbnitp_ros.robot.way import legs_of, shortest_way, steps_within, without_loops
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
