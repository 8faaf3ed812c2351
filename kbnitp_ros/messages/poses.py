# SPDX-License-Identifier: Apache-2.0
"""Where a robot is, for people to look at: no base knows that of a robot that is out."""

from __future__ import annotations

from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from kbnitp_ros.core import Grid
from kbnitp_ros.messages.grids import orientation_fields
from kbnitp_ros.messages.headers import header
from tf2_msgs.msg import TFMessage


def pose_message(grid: Grid, agent: str, cell: int, stamp: int) -> TFMessage:
    """Return the transform from the grid's frame to AGENT/base_link, turned as its rows."""
    ((x, y),) = grid.centers([cell]).tolist()
    transform = Transform(
        translation=Vector3(x=x, y=y), rotation=Quaternion(**vars(orientation_fields(grid.yaw)))
    )
    return TFMessage(
        transforms=[
            TransformStamped(
                header=header(stamp), child_frame_id=f'{agent}/base_link', transform=transform
            )
        ]
    )
