# SPDX-License-Identifier: Apache-2.0
"""The science of path-based sensors: beliefs, updates, information and plans. Needs numpy only."""

from kbnitp_ros.core.field import (
    Belief,
    binary_entropy,
    brier_score,
    Grid,
    log_loss,
    Observation,
    SensorModel,
    World,
)
from kbnitp_ros.core.inference import (
    check_report,
    deployment_order,
    DeploymentKey,
    Estimator,
    Ledger,
    METHODS,
    Report,
    update,
    versions,
)
from kbnitp_ros.core.mission import Deployment, run_mission
from kbnitp_ros.core.planning import (
    ALLOCATIONS,
    path_information,
    Plan,
    plan,
    plan_team,
    PLANNERS,
    Regions,
    team_information,
    team_size,
    TeamPlan,
)

__all__ = [
    'ALLOCATIONS',
    'METHODS',
    'PLANNERS',
    'Belief',
    'Deployment',
    'DeploymentKey',
    'Estimator',
    'Grid',
    'Ledger',
    'Observation',
    'Plan',
    'Regions',
    'Report',
    'SensorModel',
    'TeamPlan',
    'World',
    'binary_entropy',
    'brier_score',
    'check_report',
    'deployment_order',
    'log_loss',
    'path_information',
    'plan',
    'plan_team',
    'run_mission',
    'team_information',
    'team_size',
    'update',
    'versions',
]
