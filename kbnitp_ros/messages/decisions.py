# SPDX-License-Identifier: Apache-2.0
"""What the message means that tells what may be relied on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kbnitp_ros.core import Decision, Grid
from kbnitp_ros.messages.deployments import path_message
from kbnitp_ros.messages.headers import header

if TYPE_CHECKING:
    from kbnitp_msgs.msg import Decision as DecisionMessage


def decision_message(
    grid: Grid, decision: Decision, deployments: int, stamp: int, mission: int
) -> DecisionMessage:
    """
    Return the message of a decision.

    Parameters
    ----------
    grid : Grid
        Where the cells' centres are.
    decision : Decision
        What may be relied on.
    deployments : int
        In the belief that it is made with.
    stamp, mission : int
        Of that belief, in nanoseconds.

    """
    from kbnitp_msgs.msg import Decision as DecisionMessage

    return DecisionMessage(
        header=header(stamp),
        deployments=deployments,
        goal=decision.goal,
        probability=decision.p_free,
        independent_draws=decision.independent_draws,
        path=path_message(grid, decision.path, stamp, mission),
        survival=decision.survival,
        hazards_mean=decision.hazards_mean,
        hazards_5=float(decision.hazards_5),
        hazards_95=float(decision.hazards_95),
        reached=decision.reached,
        reason=decision.reason,
    )
