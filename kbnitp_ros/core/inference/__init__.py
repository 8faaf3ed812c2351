# SPDX-License-Identifier: Apache-2.0
"""What is learnt of the field: the belief after deployments."""

from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.inference.evidence import condition
from kbnitp_ros.core.inference.exact import lost_likelihood
from kbnitp_ros.core.inference.ledger import Ledger
from kbnitp_ros.core.inference.methods import Inference, Method, METHODS, versions
from kbnitp_ros.core.inference.one_pass import OnePass
from kbnitp_ros.core.inference.register import (
    deployment_order,
    DeploymentKey,
    Ending,
    LONGEST_WALK,
    observation_of,
    Outcome,
    Register,
    Report,
)
from kbnitp_ros.core.inference.told import Told
from kbnitp_ros.core.inference.unknowns import ALL_KNOWN, Beta, Learnt, Unknowns
from kbnitp_ros.core.inference.update import update

__all__ = [
    'ALL_KNOWN',
    'LONGEST_WALK',
    'METHODS',
    'Beta',
    'DeploymentKey',
    'Ending',
    'Estimator',
    'Inference',
    'Learnt',
    'Ledger',
    'Method',
    'OnePass',
    'Outcome',
    'Register',
    'Report',
    'Told',
    'Unknowns',
    'condition',
    'deployment_order',
    'lost_likelihood',
    'observation_of',
    'update',
    'versions',
]
