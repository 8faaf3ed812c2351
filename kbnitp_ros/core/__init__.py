# SPDX-License-Identifier: Apache-2.0
"""The science of path-based sensors: beliefs, updates, information and plans. Needs numpy only."""

from kbnitp_ros.core.allocations import ALLOCATIONS
from kbnitp_ros.core.belief import Belief
from kbnitp_ros.core.estimator import Estimator, METHODS
from kbnitp_ros.core.grid import Grid
from kbnitp_ros.core.information import path_information, team_information
from kbnitp_ros.core.ledger import deployment_order, DeploymentKey, Ledger, Report
from kbnitp_ros.core.metrics import brier_score, log_loss
from kbnitp_ros.core.mission import Deployment, run_mission
from kbnitp_ros.core.observation import Observation
from kbnitp_ros.core.plan import Plan, plan
from kbnitp_ros.core.planners import PLANNERS
from kbnitp_ros.core.regions import Regions
from kbnitp_ros.core.sensor import SensorModel
from kbnitp_ros.core.team import plan_team, TeamPlan
from kbnitp_ros.core.update import update
from kbnitp_ros.core.world import World

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
    'brier_score',
    'deployment_order',
    'log_loss',
    'path_information',
    'plan',
    'plan_team',
    'run_mission',
    'team_information',
    'update',
]
