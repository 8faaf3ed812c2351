# SPDX-License-Identifier: Apache-2.0
"""What may be relied on, where robots go for it, and when to stop."""

from kbnitp_ros.core.decision.area import Area
from kbnitp_ros.core.decision.decision import (
    Decision,
    FEWEST_LEFT_OUT,
    safest_path,
    SafestPath,
    there_and_back,
)
from kbnitp_ros.core.decision.flights import Flight, Situation
from kbnitp_ros.core.decision.goals import Goal, GOALS
from kbnitp_ros.core.decision.hazard_draws import DRAWS, HazardDraws, Target, targets
from kbnitp_ros.core.decision.lane import Lane
from kbnitp_ros.core.decision.rounds import check_sought, plan_round, Round
from kbnitp_ros.core.decision.stopping import Stop

__all__ = [
    'DRAWS',
    'FEWEST_LEFT_OUT',
    'GOALS',
    'Area',
    'Decision',
    'Flight',
    'Goal',
    'HazardDraws',
    'Lane',
    'Round',
    'SafestPath',
    'Situation',
    'Stop',
    'Target',
    'check_sought',
    'plan_round',
    'safest_path',
    'targets',
    'there_and_back',
]
