# SPDX-License-Identifier: Apache-2.0
"""
What the map of hazards means to Nav2's costmap filters.

A cell of the map says percent, and to Nav2 it means ``base + multiplier * percent``. What follows
from that, and which numbers a filter takes, is in the documentation of nav2_costmap_2d.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from kbnitp_ros.messages.fields import Fields, filled
from kbnitp_ros.messages.headers import header_fields

if TYPE_CHECKING:
    from nav2_msgs.msg import CostmapFilterInfo

# The filters by the type of the message.
KEEPOUT, SPEED_PERCENT, SPEED_ABSOLUTE = range(3)


def check_filter(filter_type: int, base: float, multiplier: float) -> None:
    """Check that Nav2's filter of a type takes these numbers."""
    given = f'filter.base is {base} and filter.multiplier {multiplier}'
    if filter_type == KEEPOUT and (base, multiplier) != (0.0, 1.0):
        raise ValueError(f'{given}: with filter.type 0, a KeepoutFilter, they must be 0 and 1')
    if filter_type == KEEPOUT:
        return
    # It reads 0 percent as no limit.
    limits = [base + multiplier * percent for percent in (1, 100)]
    unit, most = ('%', 100.0) if filter_type == SPEED_PERCENT else ('m/s', float('inf'))
    if not (min(limits) >= 0.0 and max(limits) <= most):
        allowed = 'from 0 to 100 %' if filter_type == SPEED_PERCENT else 'at least 0 m/s'
        raise ValueError(
            f'{given}: with filter.type {filter_type} that is {limits[0]:.6g} {unit} at 1 % of '
            f'hazard and {limits[1]:.6g} {unit} at 100 %, which must be {allowed}, or Nav2 takes '
            'it for no limit'
        )


def filter_info(
    filter_type: int, base: float, multiplier: float, mask_topic: str, stamp: int
) -> CostmapFilterInfo:
    """Return the message that has Nav2's filters take the map of a topic for their mask."""
    from nav2_msgs.msg import CostmapFilterInfo

    fields = Fields(
        header=header_fields(stamp),
        type=filter_type,
        filter_mask_topic=mask_topic,
        base=base,
        multiplier=multiplier,
    )
    return filled(CostmapFilterInfo(), fields)
