# SPDX-License-Identifier: Apache-2.0
"""What a path is expected to bring, and what that is worth."""

from kbnitp_ros.core.planning.objective.candidate import Candidate
from kbnitp_ros.core.planning.objective.information import (
    behavioral_information,
    path_information,
    team_information,
)
from kbnitp_ros.core.planning.objective.joint_outcomes import JointOutcomes
from kbnitp_ros.core.planning.objective.objective import Objective
from kbnitp_ros.core.planning.objective.options import (
    ALPHAS,
    OBJECTIVES,
    PLANNERS,
    SearchOptions,
)
from kbnitp_ros.core.planning.objective.readings import Camera, positives

__all__ = [
    'ALPHAS',
    'OBJECTIVES',
    'PLANNERS',
    'Camera',
    'Candidate',
    'JointOutcomes',
    'Objective',
    'SearchOptions',
    'behavioral_information',
    'path_information',
    'positives',
    'team_information',
]
