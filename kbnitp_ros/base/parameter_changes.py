# SPDX-License-Identifier: Apache-2.0
"""Which parameters of a planner may change in a mission under way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kbnitp_ros.configuration import check_search, parameter_of
from kbnitp_ros.core import Grid, RobotType


def check_changes(
    changes: Mapping[str, Any],
    values: Mapping[str, Any],
    grid: Grid,
    believed: Mapping[str, RobotType],
    sent: int,
) -> None:
    """Check new values of parameters of this package."""
    given = {
        name: parameter.check(value)
        for name, value in changes.items()
        if (parameter := parameter_of('planner', name))
    }
    check_search({**values, **given}, grid, believed)
    check_robots(given.get('robots', sent), sent)


def check_robots(robots: int, sent: int) -> None:
    """Check how many robots a mission is to have in which some were sent."""
    if robots < sent:
        raise ValueError(
            f'parameter robots is {robots}: {sent} robots were sent, and it must be at '
            f'least that; {sent} ends the mission'
        )
