# SPDX-License-Identifier: Apache-2.0
"""The science of path-based sensors: beliefs, updates, information and plans. Needs numpy only."""

# Decisions: what may be relied on.
from kbnitp_ros.core.decision.decision import Decision, safest_path
from kbnitp_ros.core.decision.goals import Area, Goal, Lane
from kbnitp_ros.core.decision.hazard_draws import HazardDraws, Mixture, targets
from kbnitp_ros.core.decision.rounds import Stop

# The field: what is, and what is known of it.
from kbnitp_ros.core.field.belief import Belief, brier_score, log_loss
from kbnitp_ros.core.field.clustering import Clustering
from kbnitp_ros.core.field.finding import Finding
from kbnitp_ros.core.field.grid import Grid
from kbnitp_ros.core.field.observation import Observation
from kbnitp_ros.core.field.sensor import ORDINARY, RobotType, SensorModel
from kbnitp_ros.core.field.unknowns import Beta, Dynamics, Unknowns
from kbnitp_ros.core.field.world import Execution, World

# How a mission may go.
from kbnitp_ros.core.forecast import forecast

# Inference: what is learnt.
from kbnitp_ros.core.inference.annotation import Annotation, AnnotationKind
from kbnitp_ros.core.inference.estimator import Estimator
from kbnitp_ros.core.inference.ledger import Ledger
from kbnitp_ros.core.inference.methods import METHODS, update
from kbnitp_ros.core.inference.one_pass import KnownModel
from kbnitp_ros.core.inference.record import (
    DeploymentKey,
    OrderState,
    Report,
    Standing,
    Verdict,
)

# A whole mission.
from kbnitp_ros.core.mission import Deployment, Learning, Mission, run_mission, Truth

# Planning: where to go next.
from kbnitp_ros.core.planning.objective import Candidate, path_information, team_information
from kbnitp_ros.core.planning.options import OBJECTIVES, PLANNERS, SearchOptions
from kbnitp_ros.core.planning.planners import NoPathError, PathFinder
from kbnitp_ros.core.planning.plans import ALLOCATIONS, Plan, plan, plan_team, Team

__all__ = [
    'ALLOCATIONS',
    'METHODS',
    'OBJECTIVES',
    'ORDINARY',
    'PLANNERS',
    'Annotation',
    'AnnotationKind',
    'Area',
    'Belief',
    'Beta',
    'Candidate',
    'Clustering',
    'Decision',
    'Deployment',
    'DeploymentKey',
    'Dynamics',
    'Estimator',
    'Execution',
    'Finding',
    'Goal',
    'Grid',
    'HazardDraws',
    'KnownModel',
    'Lane',
    'Learning',
    'Ledger',
    'Mission',
    'Mixture',
    'NoPathError',
    'Observation',
    'OrderState',
    'PathFinder',
    'Plan',
    'Report',
    'RobotType',
    'SearchOptions',
    'SensorModel',
    'Standing',
    'Stop',
    'Team',
    'Truth',
    'Unknowns',
    'Verdict',
    'World',
    'brier_score',
    'forecast',
    'log_loss',
    'path_information',
    'plan',
    'plan_team',
    'run_mission',
    'safest_path',
    'targets',
    'team_information',
    'update',
]
