# SPDX-License-Identifier: Apache-2.0
"""What is learnt of the field: the belief after deployments."""

from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.inference.filtering import (
    condition,
    hazards_used_up,
    KnownModel,
    lost_likelihood,
    OnePass,
)
from kbnitp_ros.core.inference.methods import Inference, Method, METHODS, update
from kbnitp_ros.core.inference.model_check import ModelCheck
from kbnitp_ros.core.inference.record import (
    deployment_order,
    DeploymentKey,
    Ledger,
    LONGEST_WALK,
    MissionRecord,
    observation_of,
    Report,
)

__all__ = [
    'LONGEST_WALK',
    'METHODS',
    'DeploymentKey',
    'Estimator',
    'Inference',
    'KnownModel',
    'Ledger',
    'Method',
    'MissionRecord',
    'ModelCheck',
    'OnePass',
    'Report',
    'condition',
    'deployment_order',
    'hazards_used_up',
    'lost_likelihood',
    'observation_of',
    'update',
]
