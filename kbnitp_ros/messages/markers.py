# SPDX-License-Identifier: Apache-2.0
"""Views of a robot: the readings on its way, and a simulated robot's pose."""

from __future__ import annotations

from geometry_msgs.msg import Point, Pose, Quaternion, Transform, TransformStamped, Vector3
from kbnitp_ros.core import Grid, Observation
from kbnitp_ros.messages.grids import orientation_fields
from kbnitp_ros.messages.headers import header
import numpy as np
from std_msgs.msg import ColorRGBA
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

DETECTED = ColorRGBA(r=1.0, g=0.6, b=0.0, a=1.0)
NOTHING = ColorRGBA(r=0.4, g=0.5, b=0.6, a=0.6)

# Diameter of a reading in sides of a cell.
SIZE = 0.3


def readings_marker(grid: Grid, observation: Observation, stamp: int) -> Marker:
    """Return a sphere for each step with a reading, in order; none for a lost robot."""
    readings = np.empty(0) if observation.readings is None else observation.readings
    looked = np.flatnonzero(readings != -1)
    centers = grid.centers(observation.path[1:][looked])
    size = SIZE * grid.resolution
    return Marker(
        header=header(stamp),
        ns='readings',
        type=Marker.SPHERE_LIST,
        action=Marker.ADD,
        pose=Pose(orientation=Quaternion(w=1.0)),
        scale=Vector3(x=size, y=size, z=size),
        points=[Point(x=x, y=y) for x, y in centers.tolist()],
        colors=[DETECTED if detected else NOTHING for detected in readings[looked]],
    )


def pose_message(grid: Grid, agent: str, cell: int, stamp: int) -> TFMessage:
    """Return the transform from the grid's frame to AGENT/base_link, aligned with the rows."""
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
