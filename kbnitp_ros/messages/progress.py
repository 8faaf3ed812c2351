# SPDX-License-Identifier: Apache-2.0
"""What the message means that tells how a mission stands."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import nan
from typing import NamedTuple, TYPE_CHECKING

from kbnitp_ros.core import (
    Belief,
    binary_entropy,
    Ledger,
    log_loss,
    path_information,
    SensorModel,
    World,
)
from kbnitp_ros.messages.headers import header

if TYPE_CHECKING:
    from kbnitp_msgs import msg


class MissionState(IntEnum):
    """How far a mission is, as in kbnitp_msgs/Progress."""

    UNKNOWN = 0
    RUNNING = 1
    PAUSED = 2
    DONE = 3
    ENDED = 4


class Standing(NamedTuple):
    """The state of a mission, and why it is in that state; empty where that is plain."""

    state: MissionState
    reason: str


NOT_KNOWN = Standing(MissionState.UNKNOWN, '')


@dataclass(frozen=True, eq=False)
class Held:
    """What was believed at one time."""

    # How many the belief holds.
    deployments: int
    # Given those.
    belief: Belief
    # What robots and sensors were believed to be like.
    model: SensorModel

    @classmethod
    def by(cls, ledger: Ledger) -> Held:
        """Return what a ledger holds now."""
        return cls(len(ledger.deployments), ledger.belief, ledger.estimator.model)


def progress_message(
    ledger: Ledger,
    before: Held | None,
    world: World | None,
    stamp: int,
    out: int,
    standing: Standing = NOT_KNOWN,
) -> msg.Progress:
    """Return the message of how a mission stands."""
    from kbnitp_msgs import msg

    belief = ledger.belief
    return msg.Progress(
        header=header(stamp),
        deployments=len(ledger.deployments),
        lost=ledger.lost,
        ordered=len(ledger.paths),
        out=out,
        hazard_entropy=float(binary_entropy(belief.hazard).sum()),
        target_entropy=float(binary_entropy(belief.target).sum()),
        joint_entropy=belief.joint_entropy(),
        information_expected=expected(ledger, before),
        information_gained=(
            before.belief.joint_entropy() - belief.joint_entropy() if before else nan
        ),
        hazard_log_loss=log_loss(belief.hazard, world.hazard) if world else nan,
        target_log_loss=log_loss(belief.target, world.target) if world else nan,
        upper_bound=nan,
        state=standing.state,
        reason=standing.reason,
    )


def expected(ledger: Ledger, before: Held | None) -> float:
    """Return what the report assimilated last was expected to bring, in nats; NaN if unknown."""
    if before is None or ledger.newest is None:
        return nan
    if len(ledger.deployments) != before.deployments + 1:
        return nan
    model = ledger.robot_type(ledger.newest).model(before.model)
    return path_information(before.belief, model, ledger.path(ledger.newest))
