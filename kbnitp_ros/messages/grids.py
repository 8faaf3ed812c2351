# SPDX-License-Identifier: Apache-2.0
"""Occupancy grids: the maps of a belief, received maps, and masks for Nav2's filters."""

from __future__ import annotations

from functools import lru_cache
from math import atan2, cos, hypot, isfinite, pi, remainder, sin, tau
from typing import Any, TYPE_CHECKING

from kbnitp_ros.core import Grid
from kbnitp_ros.messages.headers import check_frame, Fields, filled, header_fields, stamp_fields
import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from nav2_msgs.msg import CostmapFilterInfo
    from nav_msgs.msg import OccupancyGrid


UNKNOWN = -1

# Tolerance of a quaternion's length, as in tf2.
UNIT = 1e-2

# Decimals of an angle in rad: a micrometre at a thousand kilometres. A quaternion is exact to
# about 1e-16 rad.
YAW_DECIMALS = 12


def rounded_resolution(resolution: float) -> float:
    """Return a cell's side in metres, rounded as by the float32 of a message; 0.1 stays 0.1."""
    return float(str(np.float32(resolution)))


def rounded_yaw(yaw: float) -> float:
    """Return an angle in rad, in (-pi, pi], rounded to the precision of a quaternion."""
    rounded = round(remainder(yaw, tau), YAW_DECIMALS) + 0.0
    # Half turns may be rounded to more than pi; a left and a right half turn are the same angle.
    return abs(rounded) if abs(rounded) > pi else rounded


def orientation_fields(yaw: float) -> Fields:
    """Return the fields of the geometry_msgs/Quaternion of an angle about the z axis, in rad."""
    return Fields(x=0.0, y=0.0, z=sin(yaw / 2), w=cos(yaw / 2))


def metadata_fields(grid: Grid) -> Fields:
    """Return the fields of the nav_msgs/MapMetaData of `grid`."""
    x, y = grid.origin
    return Fields(
        map_load_time=stamp_fields(0),
        resolution=float(np.float32(grid.resolution)),
        width=grid.width,
        height=grid.height,
        origin=Fields(position=Fields(x=x, y=y, z=0.0), orientation=orientation_fields(grid.yaw)),
    )


# Messages of a mission share their grid, and a grid costs more than the rest of a view.
known_grid = lru_cache(maxsize=8, typed=True)(Grid)


def read_map_metadata(info: Any, **rest: Any) -> Grid:
    """Return the grid with the geometry of a nav_msgs/MapMetaData."""
    origin = info.origin
    numbers = {
        'info.resolution': info.resolution,
        'info.origin.position.x': origin.position.x,
        'info.origin.position.y': origin.position.y,
    }
    for name, value in numbers.items():
        if not isfinite(value):
            raise ValueError(f'{name} is {value}: it must be finite, in metres')
    turn = origin.orientation
    # Publishers that do not rotate the origin may leave all four numbers at 0.
    is_turned = turn.z != 0.0
    if turn.x or turn.y or (is_turned and not abs(hypot(turn.z, turn.w) - 1.0) < UNIT):
        raise ValueError(
            f'info.origin.orientation has x, y, z, w = {(turn.x, turn.y, turn.z, turn.w)}: it '
            'must be a unit quaternion with x and y 0, a turn about the z axis'
        )
    return known_grid(
        width=info.width,
        height=info.height,
        resolution=rounded_resolution(info.resolution),
        origin=(origin.position.x, origin.position.y),
        yaw=rounded_yaw(2.0 * atan2(turn.z, turn.w)) if is_turned else 0.0,
        **rest,
    )


def occupancy_fields(grid: Grid, probabilities: ArrayLike, stamp: int) -> Fields:
    """Return the fields of an occupancy map computed at a time in nanoseconds."""
    percent = np.rint(100.0 * np.asarray(probabilities, dtype=np.float64)).astype(np.int8)
    return Fields(
        header=header_fields(stamp),
        info=metadata_fields(grid),
        data=np.where(grid.free, percent, np.int8(UNKNOWN)),
    )


def occupancy_grid(grid: Grid, probabilities: ArrayLike, stamp: int) -> OccupancyGrid:
    """Return the occupancy map with the fields of `occupancy_fields`."""
    from nav_msgs.msg import OccupancyGrid

    return filled(OccupancyGrid(), occupancy_fields(grid, probabilities, stamp))


def read_occupancy_grid(message: Any) -> NDArray[np.float64]:
    """Return the probabilities of a nav_msgs/OccupancyGrid."""
    if not message.header.frame_id:
        raise ValueError("header.frame_id is '': it must name the frame of the map")
    percent = _data(message, read_map_metadata(message.info))
    return np.where(percent == UNKNOWN, np.nan, percent / 100.0)


def read_map_message(message: Any) -> tuple[NDArray[np.int8], float, tuple[float, float], float]:
    """Return the field's map from a nav_msgs/OccupancyGrid, such as map_server's."""
    check_frame('header.frame_id', message.header.frame_id)
    pixels = read_map_metadata(message.info)
    data = _data(message, pixels).reshape(pixels.height, pixels.width)
    return data, pixels.resolution, pixels.origin, pixels.yaw


def _data(message: Any, grid: Grid) -> NDArray[np.int8]:
    """Return the values of a nav_msgs/OccupancyGrid on this grid, shape (cells,)."""
    data = np.asarray(message.data, dtype=np.int16)
    if data.size != grid.cells:
        raise ValueError(
            f'data has {data.size} values: it must have width * height = '
            f'{grid.width} * {grid.height} = {grid.cells}'
        )
    illegal = np.flatnonzero((data < UNKNOWN) | (data > 100))
    if illegal.size:
        cell = illegal[0]
        raise ValueError(f'data of cell {cell} is {data[cell]}: it must be -1 or 0 to 100')
    return data.astype(np.int8)


# Types of Nav2's costmap filters, as in nav2_msgs/CostmapFilterInfo.
KEEPOUT, SPEED_PERCENT, SPEED_ABSOLUTE = range(3)


def check_filter(grid: Grid, filter_type: int, base: float, multiplier: float) -> None:
    """Check base and multiplier of a Nav2 costmap filter of this type, and the field's turn."""
    if grid.yaw:
        raise ValueError(
            f'filter.type is {filter_type}, and the field is turned by {grid.yaw:.6g} rad: Nav2 '
            'ignores the turn of a mask; take a map that is not turned, or leave filter.type out'
        )
    given = f'filter.base is {base} and filter.multiplier is {multiplier}'
    if filter_type == KEEPOUT and (base, multiplier) != (0.0, 1.0):
        raise ValueError(f'{given}: with filter.type 0, a KeepoutFilter, they must be 0 and 1')
    if filter_type == KEEPOUT:
        return
    # At 0 percent of hazard a SpeedFilter sets no limit, so limits begin at 1 percent.
    limits = [base + multiplier * percent for percent in (1, 100)]
    unit, most = ('%', 100.0) if filter_type == SPEED_PERCENT else ('m/s', float('inf'))
    if not (min(limits) >= 0.0 and max(limits) <= most):
        allowed = 'from 0 to 100 %' if filter_type == SPEED_PERCENT else 'at least 0 m/s'
        raise ValueError(
            f'{given}: the speed limit of filter.type {filter_type} is {limits[0]:.6g} {unit} at '
            f'1 % of hazard and {limits[1]:.6g} {unit} at 100 %; it must be {allowed}, since Nav2 '
            'takes other values as no limit'
        )


def filter_info(
    filter_type: int, base: float, multiplier: float, mask_topic: str, stamp: int
) -> CostmapFilterInfo:
    """Return the message that announces a topic's map as the mask of a Nav2 costmap filter."""
    from nav2_msgs.msg import CostmapFilterInfo

    fields = Fields(
        header=header_fields(stamp),
        type=filter_type,
        filter_mask_topic=mask_topic,
        base=base,
        multiplier=multiplier,
    )
    return filled(CostmapFilterInfo(), fields)
