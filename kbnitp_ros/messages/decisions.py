# SPDX-License-Identifier: Apache-2.0
"""What the message means that tells what may be relied on."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import Decision, Grid
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.fields import Fields
from kbnitp_ros.messages.headers import header
import numpy as np

if TYPE_CHECKING:
    from kbnitp_msgs.msg import Decision as DecisionMessage


def decision_fields(decision: Decision, deployments: int) -> Fields:
    """Return what the message of a decision says of the hazards, which the evidence determines."""
    return Fields(
        deployments=deployments,
        goal=decision.goal,
        probability=decision.p_free,
        independent_draws=decision.independent_draws,
        survival=decision.survival,
        hazards_mean=decision.hazards_mean,
        hazards_5=float(decision.hazards_5),
        hazards_95=float(decision.hazards_95),
    )


def decision_message(
    grid: Grid, decision: Decision, deployments: int, stamp: int, mission: int
) -> DecisionMessage:
    """Return the message of a decision made with a belief: its deployments, stamp and mission."""
    from kbnitp_msgs.msg import Decision as DecisionMessage

    return DecisionMessage(
        header=header(stamp),
        path=path_message(grid, decision.path, stamp, mission),
        reached=decision.reached,
        reason=decision.reason,
        **vars(decision_fields(decision, deployments)),
    )


def check_decision(message: Any) -> None:
    """Check that a message tells a decision; raises ValueError."""
    names = ('hazards_mean', 'hazards_5', 'hazards_95', 'probability')
    if wrong := [name for name in names if not 0.0 <= getattr(message, name) < np.inf]:
        raise ValueError(f'{wrong[0]} is {getattr(message, wrong[0])}: it must be 0 or more')
    if message.probability > 1.0:
        raise ValueError(f'probability is {message.probability}: it must be in [0, 1]')
    if message.path.poses and not 0.0 <= message.survival <= 1.0:
        raise ValueError(f'survival is {message.survival}: it must be in [0, 1]')


def read_decision(grid: Grid, message: Any) -> Decision:
    """Return the decision that a message tells."""
    check_decision(message)
    at = [(each.pose.position.x, each.pose.position.y) for each in message.path.poses]
    path = grid.cells_at(at) if at else np.empty(0, dtype=np.intp)
    return Decision(
        goal=message.goal,
        p_free=message.probability,
        # Of an area the message does not tell them.
        cells=np.unique(path),
        independent_draws=message.independent_draws,
        path=path,
        survival=message.survival,
        hazards_mean=message.hazards_mean,
        hazards_5=int(message.hazards_5),
        hazards_95=int(message.hazards_95),
        reached=message.reached,
        reason=message.reason,
    )
