# SPDX-License-Identifier: Apache-2.0
"""What is learnt of the field: the belief after deployments."""

from kbnitp_ros.core.inference.estimator import Estimator, METHODS
from kbnitp_ros.core.inference.evidence import condition
from kbnitp_ros.core.inference.exact import lost_likelihood
from kbnitp_ros.core.inference.ledger import Ledger
from kbnitp_ros.core.inference.methods import versions
from kbnitp_ros.core.inference.register import (
    check_report,
    deployment_order,
    DeploymentKey,
    Register,
    Report,
)
from kbnitp_ros.core.inference.unknowns import ALL_KNOWN, Beta, Learnt, Unknowns
from kbnitp_ros.core.inference.update import update

__all__ = [
    'ALL_KNOWN',
    'METHODS',
    'Beta',
    'DeploymentKey',
    'Estimator',
    'Learnt',
    'Ledger',
    'Register',
    'Report',
    'Unknowns',
    'check_report',
    'condition',
    'deployment_order',
    'lost_likelihood',
    'update',
    'versions',
]
